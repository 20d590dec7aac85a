"""Access: every user of this machine while there is no token, else the holders of one."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vppres.core.errors import InputError
from vppres.service.storage.records import Token

SCOPES = ("read", "telemetry", "events", "operator")
DAY_S = 86_400.0
LOOPBACK = ("127.0.0.1", "localhost", "::1")


class Denied(Exception):
    """A request that may not do what it asks.

    Its status is 401 where the sender is not known, 403 where it is known and not enough, and 429
    where it is too often: then it may be asked again after ``wait_s``.
    """

    def __init__(self, status: int, message: str, wait_s: float = 0.0) -> None:
        super().__init__(message)
        self.status = status
        self.wait_s = wait_s


@dataclass(frozen=True)
class Access:
    """Tokens of a service."""

    #: Who may come in; if there are none every sender may do everything.
    tokens: Sequence[Token] = ()
    #: Seconds of UTC; the machine's clock, whatever the site's shows.
    now: Callable[[], float] = time.time

    def known(self, authorization: str | None) -> Token | None:
        """The sender's token; none where none is needed.

        Raises
        ------
        Denied
            If it is no token of ours, or has expired.
        """
        if not self.tokens:
            return None
        kind, _, secret = (authorization or "").partition(" ")
        given = digest(secret)
        found = None
        for token in self.tokens:  # all of them, so that the time says nothing
            if hmac.compare_digest(token.sha256, given):
                found = token
        if found is None or kind.lower() != "bearer":
            raise Denied(401, "Give a token: Authorization: Bearer TOKEN.")
        if found.expires is not None and self.now() >= found.expires:
            raise Denied(401, f"The token of {found.name} has expired. Ask for another one.")
        return found

    def actor(self, authorization: str | None, scope: str) -> str:
        """The sender's name.

        Raises
        ------
        Denied
            If it may not.
        """
        found = self.known(authorization)
        if found is None:
            return "anybody here"
        if scope not in found.scopes.split():
            raise Denied(403, f"The token of {found.name} has no scope {scope}.")
        return found.name


def digest(secret: str) -> str:
    """Hash of a token, which alone is stored; 32 random bytes need no salt.

    >>> digest("x")[:8]
    '2d711642'
    """
    return hashlib.sha256(secret.encode()).hexdigest()


def new_token(text: str, days: float | None = None) -> tuple[str, Token]:
    """A secret, and what is kept of it, for ``NAME:SCOPE,SCOPE``; for some days or for good.

    Raises
    ------
    InputError
        If there is no name, or a scope that is none.

    Examples
    --------
    >>> new_token("scada:read,telemetry")[1].scopes
    'read telemetry'
    """
    name, _, wanted = text.partition(":")
    scopes = [scope.strip() for scope in wanted.split(",") if scope.strip()]
    unknown = [scope for scope in scopes if scope not in SCOPES]
    if not name.strip() or not scopes or unknown:
        raise InputError.of(
            "options",
            "is not a name with scopes",
            f"Write NAME:SCOPE,SCOPE, for example scada:read,telemetry. Scopes: "
            f"{', '.join(SCOPES)}.",
            field="add-token",
            value=text,
        )
    secret = secrets.token_urlsafe(32)
    expires = None if days is None else int(time.time() + days * DAY_S)
    return secret, Token(name.strip(), digest(secret), " ".join(scopes), expires)
