"""Sequences of a service as data: the clock, a request, its status and parts of its answer.

A request is a method, a path below ``/v1``, and headers as ``name=value``, where ``{etag}`` is the last
tag that was answered; ``decide`` sends the state of
charge of both batteries and asks for the step. A part is found by its path: keys, or in a list the
asset, the kind or the place of an element, ``*`` for all that have the rest. An expected part is a
value, or what says whether the part is as it must be.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import pandas as pd

from tests.support.asgi import Answer, Caller
from tests.support.live_service import NOON, heard
from vppres.service.clock import SetClock

Row = tuple[str, str, Any, int, dict[str, Any]]
"""Time of the day (a day ahead with ``+``), request, body, status, parts of the answer."""


def above(least: float) -> Callable[[float], bool]:
    """More than a number."""
    return lambda value: value > least


def below(most: float) -> Callable[[float], bool]:
    """Less than a number."""
    return lambda value: value < most


def has(*words: str) -> Callable[[Any], bool]:
    """A text, or a list, with these words in this order."""

    def holds(value: Any) -> bool:
        text, place = str(value), 0
        for word in words:
            place = text.find(word, place)
            if place < 0:
                return False
        return True

    return holds


def some_not(values: list[bool]) -> bool:
    """Not all of them."""
    return not all(values)


def part(answer: Answer, path: str) -> Any:
    """A part of an answer."""
    if path.startswith("headers."):
        return answer.headers[path.removeprefix("headers.")]
    if path == "text":
        return answer.content.decode()
    return _at(answer.json(), path.split(".") if path else [])


def _at(value: Any, keys: list[str]) -> Any:
    if not keys:
        return value
    key, rest = keys[0], keys[1:]
    if not isinstance(value, list):
        return _at(value[key], rest)
    if key == "*":
        return [_at(one, rest) for one in value if not rest or rest[0] in one]
    if key.isdecimal():
        return _at(value[int(key)], rest)
    (one,) = (one for one in value if key in (one.get("asset"), one.get("kind")))
    return _at(one, rest)


def play(http: Caller, clock: SetClock, rows: Sequence[Row]) -> None:
    """Ask a service row by row, and compare its answers."""
    tag = ""
    for row in rows:
        time, request, body, status, parts = row
        day, _, hour = time.rpartition("+")
        clock.set(NOON.normalize() + pd.Timedelta(days=int(day or 0)) + pd.Timedelta(f"{hour}:00"))
        if request == "decide":
            assert http.post("/v1/telemetry", heard(clock.now(), body)).status == 200, row
            request, body = "POST steps", None
        method, path, *headers = request.split()
        sent = dict(header.replace("{etag}", tag).split("=", 1) for header in headers)
        place = path if path.startswith("/") else f"/v1/{path}"
        answer = http.ask(method, place, body, sent)
        assert answer.status == status, (row, answer)
        tag = answer.headers.get("etag", tag)
        for name, expected in parts.items():
            found = part(answer, name)
            right = expected(found) if callable(expected) else found == expected
            assert right, (row, name, json.dumps(found) if name != "text" else found)
