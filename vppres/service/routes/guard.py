"""Dependencies of routes that let a scope pass, and name who asks and the service that is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Header, Request

from vppres.service.access import Access, Denied
from vppres.service.limits import DENIED, RateLimits
from vppres.service.operation.runner import Runner


class Guard:
    """Lets those pass who may, and not too often."""

    def __init__(self, access: Access, limits: RateLimits | None = None) -> None:
        self.access = access
        self.limits = limits or RateLimits()

    def actor(self, authorization: str | None, scope: str) -> str:
        """The name of who asks for something of a scope.

        Raises
        ------
        Denied
            If it may not.
        """
        found = self.access.actor(authorization, scope)
        self.limits.check(found, scope)
        return found

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


@dataclass(frozen=True)
class Sender:
    """Sender of a request that it may send."""

    runner: Runner  #: of the service that it asks
    actor: str  #: its name


def _with(scope: str) -> Any:
    """The sender of a request, who needs a scope."""

    # Not in a thread: it waits for nothing.
    async def sender(
        request: Request, authorization: Annotated[str | None, Header()] = None
    ) -> Sender:
        service = request.app.state
        return Sender(service.runner, service.guard.actor(authorization, scope))

    return Depends(sender)


Reader = Annotated[Sender, _with("read")]
Source = Annotated[Sender, _with("telemetry")]
Announcer = Annotated[Sender, _with("events")]
Operator = Annotated[Sender, _with("operator")]
