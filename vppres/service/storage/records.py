"""Rows of a site's storage; times are whole seconds of UTC."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd
from pydantic import TypeAdapter

from vppres.core.errors import VppresError
from vppres.scenario.history import History
from vppres.service import payloads

_EVENT: TypeAdapter[Any] = TypeAdapter(payloads.Event)

DECIDED = ("ok", "fallback")
"""Outcomes of steps in which the controller decided."""


def seconds(time: pd.Timestamp) -> int:
    """Whole seconds of UTC, as times are stored.

    >>> seconds(pd.Timestamp("1970-01-01T01:00:01+01:00"))
    1
    """
    return int(time.timestamp())


def moment(stored: int) -> pd.Timestamp:
    """The time of stored seconds."""
    return pd.Timestamp(stored, unit="s", tz="UTC")


def versions(plan: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Versions of a step, the earliest first."""
    return [*plan.get("before", []), plan]


def asks(setpoint: Mapping[str, Any]) -> bool:
    """Whether a device that rejects a set-point cannot be used: it was to be on, in full.

    One that rejects to be off, or less on, stays as it is.
    """
    if setpoint["kind"] == "customers":
        return bool(setpoint["served"] and setpoint.get("share", 1.0) == 1.0)
    return bool(setpoint["kind"] == "batteries" or setpoint.get("running"))


def dims(setpoint: Mapping[str, Any]) -> bool:
    """Whether a customer is to get another share of its demand than all or nothing."""
    return setpoint["kind"] == "customers" and setpoint.get("share", 1.0) not in (0.0, 1.0)


@dataclass(frozen=True)
class Reading:
    """One reading; ``value`` is NaN where it is known to be missing."""

    asset: str
    quantity: str
    time: int
    source: str
    resolution_s: int
    value: float

    @property
    def known(self) -> bool:
        """Whether it has a value."""
        return not math.isnan(self.value)


@dataclass(frozen=True)
class Written:
    """Result of storing a batch of readings."""

    accepted: int
    duplicates: int


@dataclass(frozen=True)
class Event:
    """A version of an event: number from 1, body, empty if withdrawn, and when it was written.

    ``since`` is when the first version was, after it was withdrawn last; of one that was just
    written it is ``new`` if none held before it.
    """

    version: int
    body: dict[str, Any]
    made_at: int
    since: int
    new: bool = False

    @cached_property
    def said(self) -> payloads.Event | None:
        """The body as its kind; None if it was withdrawn."""
        found: payloads.Event | None = _EVENT.validate_python(self.body) if self.body else None
        return found


@dataclass(frozen=True)
class Lost:
    """Since when a customer cannot be supplied, or dimmed, and why."""

    at: int
    reason: str


@dataclass(frozen=True)
class Condition:
    """Something that is wrong.

    Its ``subject`` is an asset or source, empty if it is the site. An acknowledgement is about its
    ``items``, for example the customers that are off; it may be due later.
    """

    kind: str
    subject: str
    priority: str
    text: str
    items: tuple[str, ...] = ()
    due_at: int | None = None

    @property
    def due(self) -> pd.Timestamp | None:
        """When it is due, if it is later than now."""
        return moment(self.due_at) if self.due_at else None

    @property
    def key(self) -> tuple[str, str]:
        """Identity of the alarm: two conditions with the same key are one alarm."""
        return self.kind, self.subject


@dataclass(frozen=True)
class AlarmRow(Condition):
    """An alarm as it is kept; its number is 0 before."""

    number: int = 0
    raised_at: int = 0
    acknowledged_at: int | None = None
    acknowledged_by: str = ""
    cleared_at: int | None = None
    shelved_until: int | None = None
    shelved_by: str = ""

    @property
    def stands(self) -> bool:
        """Whether it was not cleared."""
        return not self.cleared_at


@dataclass(frozen=True)
class After:
    """A controller's state as JSON after a step, and what its forecaster learned, if one does."""

    state: str
    measured: History | None = None


@dataclass(frozen=True)
class Asked:
    """Author and time of a request."""

    actor: str
    at: pd.Timestamp


@dataclass(frozen=True)
class Token:
    """Token: role, expiry in seconds, and the hash of its secret."""

    name: str
    sha256: str
    scopes: str
    expires: int | None = None


class ChangedError(VppresError):
    """It is no longer the version that its sender saw."""


class UnknownError(VppresError):
    """There is no such thing."""
