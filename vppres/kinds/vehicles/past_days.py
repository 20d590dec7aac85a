"""Sessions of vehicles that are not announced, drawn for the days of a run from days before it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from vppres.core.arrays import Wholes
from vppres.kinds.vehicles.data import Sessions
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid


@dataclass(frozen=True, eq=False)
class PastDays:
    """Calendar days before a run, with the sessions that began on each of them.

    A day with a session that goes on in the run is none, nor is the one on which the run begins.
    Between the first and the last, a day without a session is one on which no vehicle came.
    """

    sessions: Sessions  #: those that ended before the first step of the run
    begun: Wholes  #: day on which each began, counted as :meth:`datetime.date.toordinal` does
    days: Wholes  #: the past days, counted alike
    seed: int  #: of the run

    @classmethod
    def of(cls, scenario: Scenario, seed: int) -> Self | None:
        """The past days of a scenario, None without any."""
        grid, sessions = scenario.grid, scenario.sessions
        over = sessions.over(grid.start)
        if not over.any():
            return None
        begun = np.array([grid.local(time).toordinal() for time in sessions.plug_in])
        shown = np.arange(begun[over].min(), begun[over].max() + 1)
        of_run = np.append(begun[~over], grid.local(grid.start).toordinal())
        days = np.setdiff1d(shown, of_run)
        return cls(sessions.rows(over), begun[over], days, seed) if len(days) else None

    def drawn_for(self, day: int) -> int:
        """The past day that a day is expected to be like: the same for a seed."""
        rng = np.random.default_rng([self.seed, day])
        return int(self.days[rng.integers(len(self.days))])

    def expected(self, grid: TimeGrid, steps: range) -> Sessions:
        """Sessions of the days of some steps, moved there by whole days."""
        ends = (grid.local(grid.start + t * grid.step) for t in (steps.start, steps.stop - 1))
        first, last = (time.toordinal() for time in ends)
        days = np.arange(first, last + 1)
        drawn = np.array([self.drawn_for(int(day)) for day in days])
        of_day, rows = np.nonzero(self.begun == drawn[:, None])
        later = (days - drawn)[of_day]
        moved = np.array([pd.Timedelta(days=int(each)) for each in later], dtype=object)
        found = self.sessions.rows(rows)
        return replace(found, plug_in=found.plug_in + moved, plug_out=found.plug_out + moved)
