"""No request is read that is larger than any honest one."""

from __future__ import annotations

import json
from typing import Any

MOST_BYTES = 8_000_000
"""A batch of telemetry of a thousand assets and a day of minutes."""

_TOO_LARGE = {
    "type": "about:blank",
    "title": "The request is too large",
    "status": 413,
    "detail": f"Give at most {MOST_BYTES} bytes at once.",
    "problems": [],
}


class BodyLimit:
    """Reads the body of a request up to a limit, before anybody else does.

    Parameters
    ----------
    app : ASGI application
        Who answers what is small enough.
    """

    def __init__(self, app: Any) -> None:
        self.app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        body = bytearray()
        more = True
        while more:
            message = await receive()
            if message["type"] != "http.request":
                return
            body += message.get("body", b"")
            more = message.get("more_body", False)
            if len(body) > MOST_BYTES:
                await _refuse(send)
                return
        whole: list[Any] = [{"type": "http.request", "body": bytes(body), "more_body": False}]

        async def again() -> Any:
            return whole.pop() if whole else await receive()

        await self.app(scope, again, send)


async def _refuse(send: Any) -> None:
    """Say that it is too large."""
    content = json.dumps(_TOO_LARGE).encode()
    headers = [(b"content-type", b"application/problem+json"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": 413, "headers": headers})
    await send({"type": "http.response.body", "body": content})
