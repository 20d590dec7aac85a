"""Refused lines of a script, and words of them that are shown."""

from __future__ import annotations

SHOWN = 40  # characters of a refused word: enough to find it


class RefusedLine(Exception):
    """Why a line is refused, and the cure."""

    def __init__(self, message: str, cure: str) -> None:
        super().__init__(message)
        self.message = message
        self.cure = cure


def cut(text: str) -> str:
    """A word of a stranger as far as it is needed to find it, without control characters."""
    shown = "".join(c if c.isprintable() else "?" for c in text)
    return shown if len(shown) <= SHOWN else f"{shown[:SHOWN]}..."
