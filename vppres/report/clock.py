"""Times of a report: UTC, and beside it what the clocks on the feeder show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta

import pandas as pd

from vppres.day.trajectory import Trajectory
from vppres.scenario.timegrid import UTC, TimeGrid


@dataclass(frozen=True)
class Clock:
    """Times in words.

    Parameters
    ----------
    grid : TimeGrid
        Its zone is that of the clocks on the feeder.

    Examples
    --------
    >>> noon = pd.Timestamp("2022-07-19T12:00:00Z")
    >>> Clock(TimeGrid(noon, 60, 24)).words(noon)
    '19 Jul 12:00'
    >>> Clock(TimeGrid(noon, 60, 24, "Europe/London")).words(noon)
    '19 Jul 12:00 (13:00 BST)'
    """

    grid: TimeGrid

    @classmethod
    def of(cls, run: Trajectory) -> Clock:
        """The clock of a run."""
        return cls(run.scenario.grid)

    @property
    def has_local(self) -> bool:
        """Whether the feeder has clocks of its own."""
        return self.grid.zone != UTC

    def words(self, time: pd.Timestamp) -> str:
        """A time in UTC, and on the feeder's clocks where the scenario names their zone."""
        utc = time.tz_convert(UTC)
        return f"{utc:%d %b %H:%M}{self._local(utc)}"

    def full(self, time: pd.Timestamp) -> str:
        """A time as :meth:`words` has it, that says that it is UTC."""
        utc = time.tz_convert(UTC)
        return f"{utc:%d %b %H:%M} UTC{self._local(utc)}"

    def at(self, t: int) -> str:
        """Beginning of step ``t``, or the end of the last."""
        return self.words(self.grid.start + t * self.grid.step)

    @property
    def heading(self) -> str:
        """What stands above a column of times."""
        return "Time (UTC, local in brackets)" if self.has_local else "Time (UTC)"

    @property
    def note(self) -> str:
        """Which times these are, as a sentence."""
        if not self.has_local:
            return "Times are UTC."
        changes = ", ".join(self._offsets())
        return f"Times are UTC, in brackets local: {self.grid.zone}, {changes}."

    def _local(self, utc: pd.Timestamp) -> str:
        """What a clock on the feeder shows, if it has its own; with a date that is another one."""
        if not self.has_local:
            return ""
        local = self.grid.local(utc)
        date = "" if local.date() == utc.date() else f"{local:%d %b} "
        return f" ({date}{local:%H:%M %Z})"

    def _offsets(self) -> Iterator[str]:
        """How far local time is ahead of UTC, and from when where clocks are changed."""
        times = [*self.grid.times, self.grid.end]
        before = None
        for time in times:
            offset = self.grid.local(time).utcoffset()
            if offset != before:
                hours = (offset or timedelta()).total_seconds() / 3600
                since = "" if before is None else f" from {time.tz_convert(UTC):%d %b %H:%M}"
                yield f"UTC{hours:+g} h{since}"
            before = offset
