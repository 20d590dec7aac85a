"""Checks that every request passes before its route, and headers of every response."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException

from vppres.service.access import Denied
from vppres.service.answers import denied_answer, problem_answer
from vppres.service.routes.guard import Guard

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]

MOST_STEPS_ASKED = 4
"""Requests for a step that wait at the same time: each holds a thread while it is decided."""

MOST_BYTES = 8_000_000
"""Of a request: a batch of telemetry of a thousand assets and a day of minutes."""

MOST_PASSED_OVER = 4 * MOST_BYTES
"""Bytes that are read of a refused body before it is answered."""

TOO_LARGE = f"The request has more than {MOST_BYTES} bytes. Send it in parts."

MOST_PARTS = 200_000
"""Fields, lists and objects of a request, ten for each reading of the largest batch. JSON is read
in one piece, and nothing else is answered meanwhile: a million of them take a second."""

TOO_MANY = f"The request has more than {MOST_PARTS} fields, lists and objects. Send it in parts."
GUARDED = "/v1/"
SAFE = ("GET", "HEAD", "OPTIONS")
ANYWHERE = "*"
PORTS = {"http": 80, "https": 443}

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
ENCRYPTED = {"Strict-Transport-Security": "max-age=31536000"}


class Perimeter:
    """Lets requests pass that call the service by its name, from known senders, not too large.

    A browser sends whatever a page of a stranger asks it to, to this machine too. It names the
    host that the page believes to ask and, where something may change, the page's origin.

    The guard knows the senders; what they may, the routes ask. ``hosts`` are names of the service,
    ``*`` for any, and ``encrypted`` says that it listens with TLS itself.
    """

    def __init__(
        self, app: Any, guard: Guard, hosts: Iterable[str], encrypted: bool = False
    ) -> None:
        self.app = app
        self.guard = guard
        self.hosts = frozenset(host.strip("[]").lower() for host in hosts)
        self.headers = HEADERS | (ENCRYPTED if encrypted else {})
        self._steps_asked = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        send = _with_headers(send, self.headers)
        try:
            self._check(scope)
        except HTTPException as error:
            if error.status_code == 413:
                await _pass_over(receive)
            await problem_answer(error.status_code, error.detail)(scope, receive, send)
        except Denied as error:
            await denied_answer(error)(scope, receive, send)
        else:
            await self._pass(scope, _with_limits(receive), send)

    async def _pass(self, scope: Scope, receive: Receive, send: Send) -> None:
        """On to the routes; a few may wait for a step, others are sent away."""
        if (scope["method"], scope["path"]) != ("POST", "/v1/steps"):
            await self.app(scope, receive, send)
            return
        if self._steps_asked >= MOST_STEPS_ASKED:
            busy = Denied(429, "Others wait for the step already.", 1.0)
            await denied_answer(busy)(scope, receive, send)
            return
        self._steps_asked += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._steps_asked -= 1

    def _check(self, scope: Scope) -> None:
        """Whether a request may go on, by its head alone."""
        headers = {name: value.decode("latin-1") for name, value in scope["headers"]}
        host = headers.get(b"host", "")
        if not self._is_ours(host):
            raise HTTPException(400, "The service has another name. Give it with --name.")
        origin = headers.get(b"origin")
        changes = scope["method"] not in SAFE
        if changes and origin is not None and not same_place(origin, host):
            raise HTTPException(403, "The request was made up by a page from elsewhere.")
        length = headers.get(b"content-length", "0")
        if length.isdecimal() and (len(length) > 20 or int(length) > MOST_BYTES):
            raise HTTPException(413, TOO_LARGE)
        if scope["path"].startswith(GUARDED):
            self.guard.check(headers.get(b"authorization"))

    def _is_ours(self, host: str) -> bool:
        name = host_name(host)
        return ANYWHERE in self.hosts or (name is not None and name in self.hosts)


def _with_headers(send: Send, headers: Mapping[str, str]) -> Send:
    """Answers with these headers, where they have no others of the name."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = MutableHeaders(scope=message)
            for name, value in headers.items():
                own.setdefault(name, value)
        await send(message)

    return sending


def _with_limits(receive: Receive) -> Receive:
    """A body that is cut off where it becomes too large, whatever its head says."""
    read = parts = 0

    async def receiving() -> Message:
        nonlocal read, parts
        message = await receive()
        body = message.get("body", b"")
        read += len(body)
        # Those in texts count too: a time of day has a colon or three.
        parts += sum(body.count(sign) for sign in (b":", b"[", b"{"))
        if read > MOST_BYTES or parts > MOST_PARTS:
            await _pass_over(receive)
            raise HTTPException(413, TOO_LARGE if read > MOST_BYTES else TOO_MANY)
        return message

    return receiving


async def _pass_over(receive: Receive) -> None:
    """Let a body come to its end, if that is near: who is cut off while sending sees no answer."""
    read = 0
    while read <= MOST_PASSED_OVER:
        message = await receive()
        read += len(message.get("body", b""))
        if not message.get("more_body"):
            return


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


def same_place(origin: str, host: str) -> bool:
    """Whether a page's origin is the host and port that it asks.

    >>> same_place("https://vpp.example", "VPP.example:443"), same_place("null", "vpp.example")
    (True, False)
    >>> same_place("http://localhost:3000", "localhost:8420")
    False
    """
    try:
        page, asked = urlsplit(origin), urlsplit(f"//{host}")
        port = PORTS.get(page.scheme)
        same_port = port is not None and (page.port or port) == (asked.port or port)
    except ValueError:
        return False
    return same_port and page.hostname is not None and page.hostname == asked.hostname
