"""What every request passes before it reaches a route, and what every answer tells a browser."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from fastapi import Response

from vppres.service.answers import problem_answer

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]

MOST_STEPS_ASKED = 4
"""Requests for a step that wait at the same time: each holds a thread while it is decided."""

SAFE = ("GET", "HEAD", "OPTIONS")
ANYWHERE = "*"

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
ENCRYPTED = {"Strict-Transport-Security": "max-age=31536000"}


class Perimeter:
    """Lets requests pass that call the service by its name, and are not sent by a page of others.

    A browser sends whatever a page of a stranger asks it to, to this machine too. It names the
    host that the page believes to ask and, where something may change, the page's origin.

    Parameters
    ----------
    app : ASGI application
        The routes.
    hosts : iterable of str
        Names of the service, ``*`` for any.
    encrypted : bool
        Whether it listens with TLS itself.
    """

    def __init__(self, app: Any, hosts: Iterable[str], encrypted: bool = False) -> None:
        self.app = app
        self.hosts = frozenset(host.strip("[]").lower() for host in hosts)
        self.headers = HEADERS | (ENCRYPTED if encrypted else {})
        self._steps_asked = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name.lower() for name, _ in message["headers"]}
                message["headers"] = [*message["headers"]] + [
                    (name.lower().encode(), value.encode())
                    for name, value in self.headers.items()
                    if name.lower().encode() not in given
                ]
            await send(message)

        answer = self._refusal(scope)
        if answer is not None:
            await answer(scope, receive, send_with_headers)
        elif (scope["method"], scope["path"]) == ("POST", "/v1/steps"):
            await self._ask_for_step(scope, receive, send_with_headers)
        else:
            await self.app(scope, receive, send_with_headers)

    async def _ask_for_step(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a few wait for a step, and send the others away."""
        if self._steps_asked >= MOST_STEPS_ASKED:
            answer = problem_answer(429, "Others wait for the step already.")
            answer.headers["Retry-After"] = "1"
            await answer(scope, receive, send)
            return
        self._steps_asked += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._steps_asked -= 1

    def _refusal(self, scope: Scope) -> Response | None:
        """What is said to who calls another name, or sends what another page made up."""
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        if not self._is_ours(headers.get(b"host", "")):
            return problem_answer(400, "The service has another name. Give it with --name.")
        origin = headers.get(b"origin")
        if scope["method"] in SAFE or origin is None:
            return None
        if not self._is_ours(urlsplit_host(origin)):
            return problem_answer(403, "The request was made up by a page from elsewhere.")
        return None

    def _is_ours(self, host: str) -> bool:
        name = host_name(host)
        return ANYWHERE in self.hosts or (name is not None and name in self.hosts)


def host_name(host: str) -> str | None:
    """The name in a ``Host`` header, without port; None where there is none.

    >>> host_name("[::1]:8420"), host_name("VPP.example:443"), host_name("a b"), host_name("")
    ('::1', 'vpp.example', None, None)
    """
    try:
        parts = urlsplit(f"//{host}")
        port = parts.port
    except ValueError:
        return None
    plain = parts.netloc == host and not host.endswith(":") and "@" not in host
    return parts.hostname if plain and (port is None or port > 0) and " " not in host else None


def urlsplit_host(origin: str) -> str:
    """Host and port of an origin; nothing for ``null``.

    >>> urlsplit_host("https://vpp.example:8420"), urlsplit_host("null")
    ('vpp.example:8420', '')
    """
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""
