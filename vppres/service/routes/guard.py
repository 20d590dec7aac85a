"""Dependencies of routes that let a scope pass and name who asks."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Header, Request

from vppres.service.access import Access, Denied
from vppres.service.limits import Limits


class Guard:
    """Lets those pass who may, and not too often.

    Parameters
    ----------
    access : Access
        Who may ask.
    limits : Limits, optional
        How often.
    """

    def __init__(self, access: Access, limits: Limits | None = None) -> None:
        self.access = access
        self.limits = limits or Limits()

    def __call__(self, scope: str) -> Any:
        """The name of who asks, in a route for a scope."""

        # Not in a thread: it waits for nothing.
        async def actor(
            request: Request, authorization: Annotated[str | None, Header()] = None
        ) -> str:
            try:
                found = self.access.actor(authorization, scope)
            except Denied:
                address = request.client.host if request.client else ""
                self._count(address, "denied")
                raise
            self._count(found, scope)
            return found

        return Depends(actor)

    def _count(self, who: str, kind: str) -> None:
        wait_s = self.limits.wait_s(who, kind)
        if wait_s > 0.0:
            raise Denied(429, "Too many requests: slow down.", wait_s)
