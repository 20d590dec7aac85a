"""Sources of time: the machine's clock, or one that is set."""

from __future__ import annotations

from typing import Protocol

import pandas as pd

from vppres.core.text import iso


class TimeSource(Protocol):
    """Source of the present time."""

    def now(self) -> pd.Timestamp:
        """The time, in UTC."""
        ...


class SystemClock:
    """The machine's clock."""

    def now(self) -> pd.Timestamp:
        """The time, in UTC."""
        return pd.Timestamp.now(tz="UTC")


class SetClock:
    """A clock that shows what it was set to, for rehearsals.

    Examples
    --------
    >>> clock = SetClock(pd.Timestamp("2026-11-21T20:00Z"))
    >>> clock.set(pd.Timestamp("2026-11-21T22:00+01:00"))
    >>> clock.now().isoformat()
    '2026-11-21T21:00:00+00:00'
    """

    def __init__(self, time: pd.Timestamp) -> None:
        self.set(time)

    def now(self) -> pd.Timestamp:
        """The time, in UTC."""
        return self._time

    def set(self, time: pd.Timestamp) -> None:
        """Show another time."""
        self._time = time.tz_convert("UTC")


def written(time: pd.Timestamp) -> str:
    """A time as answers have it.

    >>> written(pd.Timestamp("2026-11-21T20:00+01:00"))
    '2026-11-21T19:00:00Z'
    """
    return iso(time.tz_convert("UTC"))
