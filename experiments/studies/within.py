"""A web application in this process, asked without a network in between."""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

from vppres.service.http.client import Answer, Client


@dataclass(frozen=True)
class Request:
    """One request, as it stands on the wire."""

    method: str
    target: str
    headers: dict[str, str]
    body: bytes = b""

    def __str__(self) -> str:
        return f"{self.method} {self.target[:120]} {self.headers} {self.body[:200]!r}"


JSON = {"host": "localhost", "content-type": "application/json"}


async def ask(app: Any, request: Request) -> tuple[int, dict[str, str], bytes]:
    """One request to an application: status, headers and content of the answer."""
    path, _, query = request.target.partition("?")
    scope = {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "method": request.method,
        "scheme": "http",
        "path": unquote(path),
        "raw_path": path.encode("latin-1", "replace"),
        "query_string": query.encode("latin-1", "replace"),
        "headers": [
            (name.encode(), value.encode("latin-1", "replace"))
            for name, value in request.headers.items()
        ],
        "client": ("127.0.0.1", 5000),
        "server": ("127.0.0.1", 8420),
    }
    messages: list[Any] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": request.body, "more_body": False}

    async def send(message: Any) -> None:
        messages.append(message)

    await app(scope, receive, send)
    headers = {k.decode("latin-1"): v.decode("latin-1") for k, v in messages[0]["headers"]}
    return messages[0]["status"], headers, b"".join(m.get("body", b"") for m in messages[1:])


class Within(Client):
    """A client of an application in this process.

    Parameters
    ----------
    app : Any
        The application.
    """

    def __init__(self, app: Any) -> None:
        self.app = app
        self.url = "this process"
        self._loop = asyncio.Runner()

    def close(self) -> None:
        """End the event loop."""
        self._loop.close()

    def ask(self, method: str, path: str, body: Any = None) -> Answer:
        """One request; its time is the processor's, that of threads and not of other processes."""
        content = b"" if body is None else json.dumps(body).encode()
        begin = time.process_time()
        status, _, text = self._loop.run(ask(self.app, Request(method, path, JSON, content)))
        used_s = time.process_time() - begin
        return Answer(status, json.loads(text) if text else None, used_s)
