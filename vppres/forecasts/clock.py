"""Series on a clock on which every day has the same number of rows.

People live by the clocks of their zone, whose days have 23 or 25 hours twice a year. On the rows of
:class:`ClockTable` the same time of another day is a whole number of days away, always.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes, mean_of_known
from vppres.core.errors import InputError
from vppres.scenario.history import History
from vppres.scenario.timegrid import UTC

MINUTES_PER_DAY = 1440


@dataclass(frozen=True, eq=False)
class ClockTable:
    """Values by row of the clock."""

    per_day: int  #: rows of a day
    values: Floats  #: the values, (rows, items); NaN where nothing is known
    #: Row of each step of the history and of the steps to come, (n,). An hour that clocks leave out
    #: has rows that no step has, and they hold what was last before; of an hour that comes twice
    #: the second time counts.
    row: Wholes
    known: int  #: steps that are over

    @property
    def now(self) -> int:
        """Row of the first step that is not over."""
        return int(self.row[self.known])

    @property
    def ahead(self) -> Wholes:
        """Rows of the steps to come, counted from that of the first."""
        return self.row[self.known :] - self.now

    @property
    def days(self) -> int:
        """Whole days that are known, before the first step to come."""
        return (self.now - int(self.row[0])) // self.per_day if self.known else 0

    @property
    def any_known(self) -> bool:
        """Whether there is any value."""
        return bool((~np.isnan(self.values)).any())

    @cached_property
    def mean(self) -> Floats:
        """Mean of each item, NaN where nothing is known, (items,)."""
        return mean_of_known(self.values)

    @cached_property
    def largest(self) -> Floats:
        """Largest value of each item, NaN where nothing is known, (items,)."""
        return np.asarray(np.fmax.reduce(self.values, axis=0, initial=np.nan))

    @cached_property
    def usual(self) -> Floats:
        """Mean at each time of day, of the item where a time is not known, (per_day, items)."""
        usual = np.tile(self.mean, (self.per_day, 1))
        for time in range(min(self.per_day, len(self.values))):
            mean = mean_of_known(self.values[time :: self.per_day])
            usual[time] = np.where(np.isnan(mean), usual[time], mean)
        return usual

    @cached_property
    def filled(self) -> Floats:
        """The values, with what is usual at the time where they are not known."""
        rows = np.arange(len(self.values)) % self.per_day
        gaps = np.isnan(self.values)
        return np.where(gaps, self.usual[rows], self.values) if gaps.any() else self.values

    def mean_before(self, rows: range, days: Iterable[int]) -> Floats:
        """Mean over whole days before, (rows, items); what is usual before there are any."""
        total = np.zeros((len(rows), self.values.shape[1]))
        count = np.zeros((len(rows), 1))
        for day in days:
            there, found = self._shifted(rows, day)
            total[there] += found
            count[there] += 1.0
        usual = self.usual[np.arange(rows.start, rows.stop) % self.per_day]
        return np.where(count > 0, total / np.maximum(count, 1.0), usual)

    def largest_before(self, rows: range, days: Iterable[int]) -> Floats:
        """Largest value over whole days before, (rows, items); the largest of all without any."""
        largest = np.full((len(rows), self.values.shape[1]), -np.inf)
        for day in days:
            there, found = self._shifted(rows, day)
            np.maximum(largest[there], found, out=largest[there])
        return np.where(np.isneginf(largest), self.largest, largest)

    def _shifted(self, rows: range, day: int) -> tuple[slice, Floats]:
        """Rows that have a row so many days before in the table, and the values of those.

        Values behind the present row are never among them: they are not known.
        """
        first = rows.start - day * self.per_day
        last = min(rows.stop - day * self.per_day, self.now)
        begin = max(first, 0)
        return slice(begin - first, max(last, begin) - first), self.filled[begin : max(last, begin)]


def rows_per_day(step_minutes: float) -> int:
    """Steps of a day.

    Raises
    ------
    InputError
        If they do not fill a day.
    """
    per_day = round(MINUTES_PER_DAY / step_minutes)
    if per_day * step_minutes != MINUTES_PER_DAY:
        raise InputError.of(
            "forecaster",
            "a day is no whole number of these steps",
            "Take steps such as 15, 30 or 60 minutes, or the forecaster paper.",
            field="step_minutes",
            value=step_minutes,
        )
    return per_day


def on_clock(history: History, values: Floats, zone: str, ahead: int) -> ClockTable:
    """Values of a history, (n, items), on the rows of a zone's clock.

    Parameters
    ----------
    history : History
        Whose steps they are; all of them are over.
    values : array, shape (n, items)
        One of its series.
    zone : str
        The clock; that of PV power is UTC, which has no summer time.
    ahead : int
        Steps to come.
    """
    per_day = rows_per_day(history.step_minutes)
    n = history.n_steps
    row = np.arange(n + ahead) + _shifts(history, zone, n + ahead)
    table = np.full((int(row.max(initial=0)) + 1, values.shape[1]), np.nan)
    left_out = np.ones(len(table), dtype=bool)
    left_out[row] = False
    table[row[:n]] = values
    for gap in np.flatnonzero(left_out):
        if 0 < gap < row[n]:
            table[gap] = table[gap - 1]
    return ClockTable(per_day, table, row, n)


def _shifts(history: History, zone: str, steps: int) -> Wholes:
    """Rows by which the clock runs ahead of the steps; never negative."""
    if zone == UTC:
        return np.zeros(steps, dtype=np.int64)
    times = history.times_of(range(steps)).tz_convert(UTC).tz_localize(None)
    clock = times.tz_localize(UTC).tz_convert(zone).tz_localize(None)
    offset = (clock - times) / history.step
    whole = np.floor(np.asarray(offset - pd.Index(offset).min(), dtype=float) + 1e-9)
    return np.asarray(whole, dtype=np.int64)
