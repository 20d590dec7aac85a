"""The time grid: start, step and number of steps. The only owner of the step length."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from zoneinfo import ZoneInfo

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.core.units import minutes_to_h

UTC = "UTC"


def is_zone(name: str) -> bool:
    """Whether a name is that of a time zone.

    >>> is_zone("Europe/London"), is_zone("Atlantis")
    (True, False)
    """
    try:
        ZoneInfo(name)
    except (KeyError, ValueError, OSError):  # unknown, no name of a file, a folder
        return False
    return True


@dataclass(frozen=True)
class TimeGrid:
    """Equidistant steps; step ``t`` covers ``[start + t step, start + (t + 1) step)``.

    Examples
    --------
    >>> grid = TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60, 24)
    >>> grid.dt_h, list(grid.window(21, horizon_h=5))
    (1.0, [21, 22, 23])
    """

    start: pd.Timestamp  #: beginning of step 0, with time zone
    step_minutes: float  #: step length in minutes
    n_steps: int  #: number of steps
    #: Name of the time zone in which people on the feeder read their clocks, for example
    #: ``Europe/London``. Steps are equally long in it too: a day may have 23 or 25 hours.
    zone: str = UTC

    def __post_init__(self) -> None:
        problems: list[Problem] = []

        def check(sound: bool, field: str, value: object, message: str, cure: str) -> None:
            if not sound:
                problems.append(Problem("time", message, cure, field=field, value=value))

        cure = "Write it with an offset, for example 2022-07-19T00:00:00Z."
        check(self.start.tzinfo is not None, "start", self.start, "has no time zone", cure)
        cure = "Give minutes, for example 60."
        check(self.step_minutes > 0, "step_minutes", self.step_minutes, "must be positive", cure)
        cure = "Give the number of steps."
        check(self.n_steps >= 1, "steps", self.n_steps, "must be at least 1", cure)
        cure = "Give one such as Europe/London, or UTC."
        check(is_zone(self.zone), "zone", self.zone, "is not the name of a time zone", cure)
        if problems:
            raise InputError(problems)

    @property
    def dt_h(self) -> float:
        """Step length in h."""
        return minutes_to_h(self.step_minutes)

    @property
    def step(self) -> pd.Timedelta:
        """Step length."""
        return pd.Timedelta(minutes=self.step_minutes)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Beginning of every step, length ``n_steps``."""
        return pd.date_range(self.start, periods=self.n_steps, name="time", freq=self.step)

    @property
    def end(self) -> pd.Timestamp:
        """End of the last step."""
        return self.start + self.n_steps * self.step

    def begun(self, time: pd.Timestamp) -> pd.Timestamp:
        """Beginning of the step that covers a time; steps go on beyond both ends."""
        return self.start + ((time - self.start) // self.step) * self.step

    def local(self, time: pd.Timestamp) -> pd.Timestamp:
        """A time as the clocks on the feeder show it.

        >>> grid = TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60, 24, "Europe/London")
        >>> grid.local(grid.start).isoformat()
        '2022-07-19T01:00:00+01:00'
        """
        return time.tz_convert(self.zone)

    @cached_property
    def changes_clocks(self) -> bool:
        """Whether the clocks on the feeder are put forward or back between start and end."""
        local = pd.DatetimeIndex([*self.times, self.end]).tz_convert(self.zone)
        return bool((local.tz_localize(None) - local.tz_convert(None)).nunique() > 1)

    def in_words(self, time: pd.Timestamp) -> str:
        """A time on the feeder's clocks in words; with its offset where these change.

        >>> grid = TimeGrid(pd.Timestamp("2022-07-19", tz="UTC"), 60, 24, "Europe/London")
        >>> grid.in_words(grid.start)
        '19 Jul 01:00'
        """
        offset = " %Z" if self.changes_clocks else ""
        return self.local(time).strftime(f"%d %b %H:%M{offset}")

    def steps_in_horizon(self, horizon_h: float) -> int:
        """Steps of a window ``t0 .. t0 + H``, both ends included: ``H = 0`` is one step."""
        return round(horizon_h / self.dt_h) + 1

    def window(self, t0: int, horizon_h: float) -> range:
        """Steps of the window that starts at step ``t0``, cut at the end of the grid."""
        return range(t0, min(t0 + self.steps_in_horizon(horizon_h), self.n_steps))
