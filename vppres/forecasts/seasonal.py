"""Forecasts from the same weekdays, the last days and the last errors; spread by past days' errors.

The method (``docs/forecasts.md`` has what it scores):

- **Load** on the clocks of the feeder: the mean of the last four same weekdays and the last three
  days that are known, plus the error of the last two hours, which dies out with .8 per hour, and
  part of that of the last day, which dies out slowly; less of them where past days show that such
  errors did not go on.
- **PV** on the solar clock: the clear-sky index times the clear sky. The clear sky is what the last
  three weeks gave at the same time at most, the index what they gave in the mean, and it too keeps
  its latest deviation for a while.
- **Paths**: what this very method would have been wrong by on each of the last six weeks, issued at
  the same time of day: whole courses of load and PV together. As they are the errors of real days,
  sums over steps and items are spread as they really are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.forecasts.interface import LoadAndPV
from vppres.forecasts.window import (
    HOURS_PER_DAY,
    ClockWindow,
    LastErrors,
    PastMeasurements,
    like_days_before,
)
from vppres.scenario.history import History

LEAST_SUN_H = 0.1
"""Hours of full sun that a clear sky must have had for its index to say anything."""
FEWEST_PATHS = 7
"""Errors of fewer days say next to nothing of the spread: then past days themselves are paths."""


OF_LOAD = LastErrors(recent_h=2.0, recent_decay_per_h=0.8, day_share=0.6, day_decay_per_h=0.98)
OF_INDEX = LastErrors(recent_h=2.0, recent_decay_per_h=0.85, day_share=0.5, day_decay_per_h=0.97)


@dataclass(frozen=True)
class Seasonal:
    """The seasonal forecaster and its constants.

    They were chosen on eight months of the 17 homes of ``data/homes``, and are held on to the last
    four.
    """

    #: Same weekdays and last days whose mean the load is.
    weekdays: int = 4
    days: int = 3
    #: How the latest errors go on.
    load_errors: LastErrors = OF_LOAD
    pv_errors: LastErrors = OF_INDEX
    envelope_days: int = 21  #: days whose largest power at a time is the clear sky
    #: Share of a change of the mean index that past days are moved by, far ahead.
    moved_mean: float = 0.3
    residual_days: int = 42  #: past days whose errors are looked at
    #: Share of the largest power below which the clear sky counts as none for its index.
    least_sun: float = 0.01

    def days_at(self, early: int) -> list[int]:
        """Days before a step whose mean is its load, if that is forecast whole days early."""
        weeks = early // 7
        same = [7 * (weeks + week) for week in range(1, self.weekdays + 1)]
        return same + [early + day for day in range(1, self.days + 1)]

    @property
    def memory_days(self) -> int:
        """Days of history that a forecast of two days looks at; what is older changes nothing."""
        return self.residual_days + max(7 * self.weekdays, self.envelope_days) + 4

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """The steps from ``issued_at`` on, from what was over by then.

        With less history it rests on less, and says so:

        1. *model*: the errors of at least seven past days;
        2. *past days*: the courses of the days that there are;
        3. *recent values*: less than a day is known, and its mean goes on;
        4. *nothing*: values are NaN.

        Gaps are filled with what the item does at that time of day in the mean, and an item of
        which nothing is known is NaN.

        Raises
        ------
        InputError
            If steps do not fill a day, or ``issued_at`` is not the beginning of one.
        """
        known = PastMeasurements.at(history, issued_at, steps, self.memory_days)
        days = known.days_with_errors(self.residual_days)
        if len(days) >= FEWEST_PATHS:
            w = known.window(known.load, days)
            load_kw = like_days_before(w, self.days_at, self.load_errors)
            return known.forecast(load_kw, self._pv_paths(known.window(known.sun, days)), "model")
        days = known.past_days(self.residual_days)
        if len(days):
            return known.of_past_days(days)
        return known.of_the_mean()

    def _pv_paths(self, w: ClockWindow) -> Floats:
        """PV power of each path, (M, W, P)."""
        sun = w.table
        before = range(1, self.envelope_days + 1)
        whole_days = range(int(w.early.max()) + 1)
        # Seen from a day earlier, the clear sky is that of the step a day before.
        reach = range(w.span.start - sun.per_day * whole_days[-1], w.span.stop)
        rows = (
            np.arange(len(w.span)) + sun.per_day * (whole_days[-1] - np.array(whole_days))[:, None]
        )
        clear = sun.largest_before(reach, before)[rows]
        mean = sun.mean_before(reach, before)[rows]
        peak = sun.largest
        sunny = clear > self.least_sun * peak
        index = np.divide(mean, clear, out=np.zeros_like(mean), where=sunny)
        missed = w.past(sun.filled) - mean[0]

        def deviation(hours: float) -> Floats:
            """Deviation of the index in the last hours, none where there was no sun."""
            possible = w.mean_of_last(clear[0], hours)
            enough = possible * hours > LEAST_SUN_H * peak
            lacking = w.mean_of_last(missed, hours)
            return np.divide(lacking, possible, out=np.zeros_like(possible), where=enough)

        errors = self.pv_errors
        usual = w.seen_from_origins(index)
        recent, day = w.courses(errors, deviation(errors.recent_h), deviation(HOURS_PER_DAY))
        expected = np.clip(usual + recent + day, 0.0, 1.0)
        clear_at = w.seen_from_origins(clear)
        happened = np.divide(
            w.happened(sun.filled),
            clear_at[1:],
            out=expected[1:].copy(),
            where=w.seen_from_origins(sunny)[1:],
        )
        deviates = expected - usual
        moved = deviates[0] - deviates[1:] + self._moved_mean(w) * (usual[0] - usual[1:])
        # Where the clear sky of a past day was next to nothing, its index says nothing.
        possible = np.minimum((happened + moved) * clear_at[0], peak)
        return np.asarray(np.where(np.isnan(peak), np.nan, possible))

    def _moved_mean(self, w: ClockWindow) -> Floats:
        """Share of a change of the mean index that past days are moved by, (W, 1).

        At once all of it: the last hours count from the mean. Further ahead less: the mean of three
        weeks strays by chance, and what strays is no change of the weather.
        """
        fresh = self.pv_errors.recent_decay_per_h**w.leads_h
        return np.asarray(fresh + (1.0 - fresh) * self.moved_mean)[:, np.newaxis]
