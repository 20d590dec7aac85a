"""Dependencies of routes that let a scope pass and name who asks."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Header

from vppres.service.access import Access, Denied
from vppres.service.limits import DENIED, RateLimits


class Guard:
    """Lets those pass who may, and not too often."""

    def __init__(self, access: Access, limits: RateLimits | None = None) -> None:
        self.access = access
        self.limits = limits or RateLimits()

    def __call__(self, scope: str) -> Any:
        """The name of who asks, in a route for a scope."""

        # Not in a thread: it waits for nothing.
        async def actor(authorization: Annotated[str | None, Header()] = None) -> str:
            found = self.access.actor(authorization, scope)
            self.limits.check(found, scope)
            return found

        return Depends(actor)

    def check(self, authorization: str | None) -> None:
        """Whether a token is known, before anything else of the request is read.

        Raises
        ------
        Denied
            If not; 429 where there are many of these.
        """
        try:
            self.access.known(authorization)
        except Denied:
            self.limits.check("", DENIED)
            raise
