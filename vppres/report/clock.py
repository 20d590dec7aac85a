"""Times of a report, as the clocks on the site show them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property

import pandas as pd

from vppres.day.trajectory import Trajectory
from vppres.scenario.timegrid import UTC, TimeGrid

_DATE = len("19 Jul ")


@dataclass(frozen=True)
class Clock:
    """Times in words.

    Examples
    --------
    >>> noon = pd.Timestamp("2022-07-19T12:00:00Z")
    >>> Clock(TimeGrid(noon, 60, 24)).words(noon)
    '19 Jul 12:00'
    >>> Clock(TimeGrid(noon, 60, 24, "Europe/London")).full(noon)
    '19 Jul 13:00 BST'
    """

    grid: TimeGrid  #: its zone is that of the clocks on the site; UTC where the scenario names none

    @classmethod
    def of(cls, run: Trajectory) -> Clock:
        """The clock of a run."""
        return cls(run.scenario.grid)

    def words(self, time: pd.Timestamp) -> str:
        """A time on the site's clocks; with its offset in words on days that change it."""
        return self.grid.in_words(time)

    def full(self, time: pd.Timestamp) -> str:
        """A time that says which clock shows it."""
        return f"{self.grid.local(time):%d %b %H:%M %Z}"

    def at(self, t: int) -> str:
        """Beginning of step ``t``, or the end of the last."""
        return self.words(self.grid.start + t * self.grid.step)

    def span(self, first: int, last: int, dated: bool = True) -> str:
        """From the beginning of a step to that of another; the date once, or not at all."""
        start, end = (self.grid.local(self.grid.start + t * self.grid.step) for t in (first, last))
        begins = self.at(first) if dated else self.at(first)[_DATE:]
        ends = self.at(last)[_DATE:] if start.date() == end.date() else self.at(last)
        return f"from {begins} to {ends}"

    @property
    def one_day(self) -> bool:
        """Whether all steps are of one day on the site's clocks."""
        last = self.grid.local(self.grid.end - pd.Timedelta(1, "ns"))
        return bool(last.date() == self.grid.local(self.grid.start).date())

    @property
    def heading(self) -> str:
        """Heading of a column of times."""
        return f"Time ({self.grid.zone})"

    @property
    def note(self) -> str:
        """Which times these are, as a sentence."""
        if self.grid.zone == UTC:
            return "Times are UTC."
        return f"Times are those of {self.grid.zone}: {', '.join(self._offsets)}."

    @cached_property
    def _offsets(self) -> list[str]:
        """How far local time is ahead of UTC, and from when where clocks are changed."""
        return list(self._each_offset())

    def _each_offset(self) -> Iterator[str]:
        before = None
        for time in [*self.grid.times, self.grid.end]:
            offset = self.grid.local(time).utcoffset()
            if offset != before:
                hours = (offset or timedelta()).total_seconds() / 3600
                since = "" if before is None else f" from {self.grid.local(time):%d %b %H:%M}"
                yield f"UTC{hours:+g} h{since}"
            before = offset
