"""Connections that ask for nothing: closed in time, and the oldest of them where there are many.

uvicorn gives a head as long as it likes, and its limit of connections refuses all.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_AT_ONCE = 500
"""Connections; where all others ask for something, the next one is closed."""

SILENT_S = 10.0
"""What a connection may take for a whole head, from its beginning or from its last answer."""


class Connection(H11Protocol):
    """A connection that has some time to ask for something."""

    _due: asyncio.TimerHandle | None = None
    silent_since: float = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Count it, and close one that was silent for longer if there are too many."""
        super().connection_made(transport)
        self._wait()
        if len(self.connections) >= MOST_AT_ONCE:
            silent = [one for one in self.connections if isinstance(one, Connection) and one.silent]
            oldest = min(silent, key=lambda one: one.silent_since)
            self.connections.discard(oldest)
            oldest.transport.abort()

    @property
    def silent(self) -> bool:
        """Whether it asks for nothing that is not answered yet."""
        return self.cycle is None or self.cycle.response_complete

    def on_response_complete(self) -> None:
        """Wait for the next head."""
        super().on_response_complete()
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is due any more."""
        super().connection_lost(exc)
        if self._due is not None:
            self._due.cancel()

    def _wait(self) -> None:
        """From now on it is silent."""
        if self._due is not None:
            self._due.cancel()
        self.silent_since = self.loop.time()
        self._due = self.loop.call_later(SILENT_S, self._end_if_silent)

    def _end_if_silent(self) -> None:
        if self.silent:
            self.transport.abort()
