"""Asks a service over HTTP, one request after another over one connection."""

from __future__ import annotations

import http.client
import json
import time
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from vppres.core.errors import InputError

TIMEOUT_S = 120.0
TOO_MANY = 429
TOO_MANY_S = 0.2
ATTEMPTS = 2
"""An idle connection may have been closed; requests that do no harm twice are sent again."""

KINDS = {"http": http.client.HTTPConnection, "https": http.client.HTTPSConnection}


@dataclass(frozen=True)
class Answer:
    """Status and body of an answer, and how long it took in s."""

    status: int
    body: Any
    seconds: float


class Client:
    """A caller of a service."""

    def __init__(self, url: str, token: str | None = None) -> None:
        parts = urlsplit(url)
        if parts.scheme not in KINDS or parts.hostname is None:
            raise InputError.of(
                "options",
                "is no address of a service",
                "Write it as http://127.0.0.1:8420.",
                field="url",
                value=url,
            )
        self.url = url
        self._connection = KINDS[parts.scheme](parts.hostname, parts.port, timeout=TIMEOUT_S)
        self._headers = {"Content-Type": "application/json"}
        if token is not None:
            self._headers["Authorization"] = f"Bearer {token}"

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def ask(self, method: str, path: str, body: Any = None) -> Answer:
        """One request.

        Raises
        ------
        OSError
            If nothing answers, or no service does.
        """
        content = None if body is None else json.dumps(body).encode()
        begin = time.perf_counter()
        for attempt in range(ATTEMPTS):
            try:
                self._connection.request(method, path, content, self._headers)
                answer = self._connection.getresponse()
                text = answer.read()
                break
            except (http.client.HTTPException, ConnectionError) as error:
                self._connection.close()
                if attempt + 1 == ATTEMPTS:
                    raise OSError(f"{self.url} does not answer: {error}") from error
        seconds = time.perf_counter() - begin
        try:
            return Answer(answer.status, json.loads(text) if text else None, seconds)
        except ValueError as error:
            raise OSError(f"{self.url} answers {answer.status} without JSON") from error

    def wanted(self, method: str, path: str, body: Any = None) -> Answer:
        """One request that must be granted.

        Raises
        ------
        InputError
            With what the service says against it.
        OSError
            If it does not work.
        """
        answer = self.ask(method, path, body)
        while answer.status == TOO_MANY:
            time.sleep(TOO_MANY_S)
            answer = self.ask(method, path, body)
        if answer.status >= 400:
            said = answer.body.get("detail") if isinstance(answer.body, dict) else answer.body
            kind = InputError if answer.status < 500 else OSError
            raise kind(f"{method} {path} at {self.url}: {answer.status}, {said}")
        return answer
