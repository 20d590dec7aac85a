"""Sequences of a service as data: the clock, a request, its status and parts of its answer.

A request is a method, a path below ``/v1``, and headers as ``name=value``. In these ``{etag}`` is the
last tag that was answered, ``{big}`` the last set-point of an asset and ``{old_big}`` the one before. Words stand for

- ``hear``: readings of this moment by quantity and asset,
- ``decide``: the step, with this state of charge of both batteries,
- ``anew``: the rest of the step, if there is a reason (else status 204),
- ``look``: the alarms, after the time that has gone by.

A part is found by its path: keys, or in a list the asset, the kind, the subject or the place of an
element, ``*`` for all that have the rest. An expected part is a value, or what says whether the part
is as it must be.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import pandas as pd

from tests.support.asgi import Answer
from tests.support.live_service import NOON, Running, heard, readings

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


def one(**fields: Any) -> Callable[[list[dict[str, Any]]], bool]:
    """A list that has an element with these fields."""
    return lambda found: any(fields.items() <= each.items() for each in found)


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
    (one,) = (one for one in value if key in map(one.get, ("asset", "kind", "subject", "source")))
    return _at(one, rest)


class Player:
    """A service that is asked row by row."""

    def __init__(self, running: Running) -> None:
        self.http, self.clock, self.runner = running
        self.known = {"etag": ""}

    def play(self, rows: Sequence[Row]) -> None:
        """Ask, and compare the answers."""
        for row in rows:
            time, request, body, status, parts = row
            day, _, hour = time.rpartition("+")
            hour += ":00" * (hour.count(":") == 1)
            now = NOON.normalize() + pd.Timedelta(days=int(day or 0)) + pd.Timedelta(hour)
            answer = self.ask(now, request, body)
            assert answer.status == status, (row, answer)
            self.note(answer)
            for name, expected in parts.items():
                found = part(answer, name)
                right = expected(found) if callable(expected) else found == expected
                assert right, (row, name, found)

    def ask(self, now: pd.Timestamp, request: str, body: Any) -> Answer:
        """One request at a time."""
        if request == "look":
            self.runner.set_clock(now)
            self.runner.watch.check_alarms()
            return self.http.get("/v1/alarms")
        self.clock.set(now)
        if request == "anew":
            plan = self.runner.anew()
            return Answer(200 if plan else 204, {}, json.dumps(plan).encode())
        if request == "hear":
            series = [
                one for quantity, values in body.items() for one in readings(now, quantity, values)
            ]
            return self.http.post("/v1/telemetry", {"series": series})
        if request == "decide":
            assert self.http.post("/v1/telemetry", heard(now, body)).status == 200
            return self.http.post("/v1/steps")
        method, path, *headers = request.split()
        for name, value in self.known.items():
            path = path.replace(f"{{{name}}}", value)
        sent = dict(
            header.replace("{etag}", self.known["etag"]).split("=", 1) for header in headers
        )
        return self.http.ask(method, path if path[0] == "/" else f"/v1/{path}", body, sent)

    def note(self, answer: Answer) -> None:
        """Keep what later rows name."""
        self.known["etag"] = answer.headers.get("etag", self.known["etag"])
        found = answer.json() if answer.content[:1] == b"{" else {}
        points = found.get("setpoints")
        for point in points if isinstance(points, list) else ():
            name, number = point["asset"], point.get("id")
            if number and self.known.get(name) != number:
                self.known["old_" + name] = self.known.get(name, "")
                self.known[name] = number
