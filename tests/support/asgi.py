"""Asks a web application in this process, without a network in between."""

from __future__ import annotations

import asyncio
import json
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote, urlsplit


@dataclass(frozen=True)
class Answer:
    """Status, headers in small letters, and content of an answer."""

    status: int
    headers: dict[str, str]
    content: bytes

    def json(self) -> Any:
        """The content, read."""
        return json.loads(self.content)


class Caller:
    """Sends requests to an ASGI application."""

    def __init__(self, app: Any) -> None:
        self.app = app

    def get(self, path: str, **headers: str) -> Answer:
        """Ask for something."""
        return self.ask("GET", path, None, headers)

    def post(self, path: str, body: Any = None, **headers: str) -> Answer:
        """Send something."""
        return self.ask("POST", path, body, headers)

    def put(self, path: str, body: Any, **headers: str) -> Answer:
        """Put something in its place."""
        return self.ask("PUT", path, body, headers)

    def delete(self, path: str, **headers: str) -> Answer:
        """Take something away."""
        return self.ask("DELETE", path, None, headers)

    def ask(self, method: str, path: str, body: Any, headers: dict[str, str]) -> Answer:
        """One request; a body is sent as JSON, or as it is if it is bytes."""
        content = body if isinstance(body, bytes) else b""
        if body is not None and not isinstance(body, bytes):
            content = json.dumps(body).encode()
        sent = {"host": "localhost", "content-type": "application/json"}
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        return asyncio.run(self._ask(method, path, content, sent))

    async def _ask(self, method: str, path: str, content: bytes, headers: dict[str, str]) -> Answer:
        parts = urlsplit(path)
        scope = {
            "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method,
            "scheme": "http", "path": unquote(parts.path), "raw_path": parts.path.encode(),
            "query_string": parts.query.encode(),
            "headers": [(k.encode(), v.encode()) for k, v in headers.items()],
            "client": ("127.0.0.1", 5000), "server": ("127.0.0.1", 8420),
        }  # fmt: skip
        messages: list[dict[str, Any]] = []

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": content, "more_body": False}

        async def send(message: dict[str, Any]) -> None:
            messages.append(message)

        await self.app(scope, receive, send)
        start = messages[0]
        found = {k.decode(): v.decode() for k, v in start["headers"]}
        return Answer(start["status"], found, b"".join(m.get("body", b"") for m in messages[1:]))
