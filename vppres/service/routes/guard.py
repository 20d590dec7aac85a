"""Dependencies of routes that let a scope pass and name who asks."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Header

from vppres.service.access import Access


class Guard:
    """Lets those pass who may.

    Parameters
    ----------
    access : Access
        Who may ask.
    """

    def __init__(self, access: Access) -> None:
        self.access = access

    def __call__(self, scope: str) -> Any:
        """The name of who asks, in a route for a scope."""

        def actor(authorization: Annotated[str | None, Header()] = None) -> str:
            return self.access.actor(authorization, scope)

        return Depends(actor)
