"""Forecasts from the same weekdays, the last days and the last errors; spread by past days' errors.

The method (``docs/forecasts.md`` has what it scores):

- **Load** on the clocks of the feeder: the mean of the last four same weekdays and the last three
  days that are known, plus the error of the last two hours, which dies out with .8 per hour, and
  part of that of the last day, which dies out slowly.
- **PV** on the sun's clock: the clear-sky index times the clear sky. The clear sky is what the last
  three weeks gave at the same time at most, the index what they gave in the mean, and it too keeps
  its latest deviation for a while.
- **Paths**: what this very method would have been wrong by on each of the last six weeks, issued at
  the same time of day: whole courses of load and PV together. As they are the errors of real days,
  sums over steps and items are spread as they really are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import InputError, Problem
from vppres.forecasts.clock import ClockTable, on_clock
from vppres.forecasts.interface import Basis, Fitted, LoadAndPV
from vppres.scenario.history import History
from vppres.scenario.timegrid import UTC

HOURS_PER_DAY = 24.0
LEAST_SUN_H = 0.1
"""Hours of full sun that a clear sky must have had for its index to say anything."""
LEAST_KNOWN = 0.5
"""Share of a day's values that must be known for its errors to count."""
FEWEST_PATHS = 7
"""Errors of fewer days say next to nothing of the spread: then past days themselves are paths."""


@dataclass(frozen=True)
class LastErrors:
    """How the latest errors of a rule go on.

    Parameters
    ----------
    recent_h : float
        Hours of which the recent error is the mean.
    recent_decay_per_h : float
        What is left of it after an hour.
    day_share : float
        Share of the last day's mean error that goes on.
    day_decay_per_h : float
        What is left of that after an hour.
    """

    recent_h: float = 2.0
    recent_decay_per_h: float = 0.8
    day_share: float = 0.6
    day_decay_per_h: float = 0.98

    def course(self, recent: Floats, day: Floats, leads_h: Floats) -> Floats:
        """Errors to come, (..., W, items), from the last ones, (..., items), by lead in h, (W,).

        The day's error comes in as the recent one goes out.
        """
        fresh = (self.recent_decay_per_h**leads_h)[:, np.newaxis]
        slow = self.day_share * (self.day_decay_per_h**leads_h)[:, np.newaxis] * (1.0 - fresh)
        return np.asarray(
            fresh * recent[..., np.newaxis, :] + slow * day[..., np.newaxis, :], dtype=float
        )


@dataclass(frozen=True)
class Seasonal:
    """The seasonal forecaster and its constants.

    They were chosen on eight months of the 17 homes of ``data/homes``, and are held on to the last
    four.

    Parameters
    ----------
    weekdays, days : int
        Same weekdays and last days whose mean the load is.
    load_errors, pv_errors : LastErrors
        How the latest errors go on.
    envelope_days : int
        Days whose largest power at a time is the clear sky.
    residual_days : int
        Past days whose errors are looked at.
    least_sun : float
        Share of the largest power below which the clear sky counts as none for its index.
    """

    weekdays: int = 4
    days: int = 3
    load_errors: LastErrors = LastErrors()
    pv_errors: LastErrors = LastErrors(2.0, 0.85, 0.5, 0.97)
    envelope_days: int = 21
    residual_days: int = 42
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

    def fit(self, history: History) -> Fitted:
        """Take a history; there is nothing to learn beforehand."""
        return FittedSeasonal(self, history)


@dataclass(frozen=True, eq=False)
class FittedSeasonal:
    """The seasonal forecaster with a history.

    Parameters
    ----------
    model : Seasonal
        The constants.
    history : History
        Measured series; it may go on after a forecast is issued, which changes nothing.
    """

    model: Seasonal
    history: History

    def forecast(self, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
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
        past = self._known(issued_at, steps)
        load = on_clock(past, past.load_kw, past.zone, steps)
        sun = on_clock(past, past.pv_kw, UTC, steps)
        ahead = int(max(load.ahead[-1], sun.ahead[-1])) + 1
        basis, days = self._basis(load, sun, ahead)
        if basis == "model":
            load_kw = self._load_paths(load, days, ahead, past.dt_h)
            pv_kw = self._pv_paths(sun, days, ahead, past.dt_h)
        elif basis == "past days":
            load_kw, pv_kw = (past_days(table, days, ahead) for table in (load, sun))
        else:
            load_kw, pv_kw = (constant(table, ahead) for table in (load, sun))
        return LoadAndPV(
            issued_at,
            past.step_minutes,
            not_negative(load_kw[:, load.ahead]),
            not_negative(pv_kw[:, sun.ahead]),
            basis,
        )

    def _known(self, issued_at: pd.Timestamp, steps: int) -> History:
        """What was over, no older than it matters, up to the step before."""
        history = self.history
        if (issued_at - history.start) % history.step != pd.Timedelta(0):
            raise InputError(
                Problem(
                    "forecast",
                    "is not the beginning of a step of the history",
                    f"Steps last {history.step_minutes:g} min from {history.start.isoformat()}.",
                    field="issued_at",
                    value=issued_at,
                )
            )
        known = history.followed_by(issued_at, history.load_kw[:0], history.pv_kw[:0])
        ahead_days = int(np.ceil(steps * history.dt_h / HOURS_PER_DAY))
        return known.last_days(self.model.memory_days + ahead_days)

    def _basis(self, load: ClockTable, sun: ClockTable, ahead: int) -> tuple[Basis, Wholes]:
        """What the forecast rests on, and which days before make its paths."""
        first = -(-ahead // load.per_day)
        most = self.model.residual_days
        days = np.arange(first, min(min(load.days, sun.days) - 1, first + most - 1) + 1)
        days = days[_known_share(load, sun, days, ahead) >= LEAST_KNOWN]
        if len(days) >= FEWEST_PATHS:
            return "model", days
        days = np.arange(1, min(load.days, sun.days, most) + 1)
        days = days[_known_share(load, sun, days, load.per_day) >= LEAST_KNOWN]
        if len(days):
            return "past days", days
        return ("recent values" if load.any_known or sun.any_known else "nothing"), days

    def _load_paths(self, load: ClockTable, days: Wholes, ahead: int, dt_h: float) -> Floats:
        """Load of each path, (M, W, C)."""
        model = self.model
        w = _Window(load, days, ahead, dt_h)
        usual = np.array(
            [
                load.mean_before(w.span, model.days_at(early))
                for early in range(int(w.early.max()) + 1)
            ]
        )
        error = w.past(load.filled) - usual[0]
        expected = w.seen_from_origins(usual) + w.course(
            model.load_errors,
            w.mean_of_last(error, model.load_errors.recent_h),
            w.mean_of_last(error, HOURS_PER_DAY),
        )
        return np.asarray(expected[0] + w.happened(load.filled) - expected[1:])

    def _pv_paths(self, sun: ClockTable, days: Wholes, ahead: int, dt_h: float) -> Floats:
        """PV power of each path, (M, W, P)."""
        model = self.model
        w = _Window(sun, days, ahead, dt_h)
        before = range(1, model.envelope_days + 1)
        whole_days = range(int(w.early.max()) + 1)
        # Seen from a day earlier, the clear sky is that of the step a day before.
        reach = range(w.span.start - sun.per_day * whole_days[-1], w.span.stop)
        rows = (
            np.arange(len(w.span)) + sun.per_day * (whole_days[-1] - np.array(whole_days))[:, None]
        )
        clear = sun.largest_before(reach, before)[rows]
        mean = sun.mean_before(reach, before)[rows]
        peak = sun.largest
        sunny = clear > model.least_sun * peak
        index = np.divide(mean, clear, out=np.zeros_like(mean), where=sunny)
        missed = w.past(sun.filled) - mean[0]

        def deviation(hours: float) -> Floats:
            """Deviation of the index in the last hours, none where there was no sun."""
            possible = w.mean_of_last(clear[0], hours)
            enough = possible * hours > LEAST_SUN_H * peak
            lacking = w.mean_of_last(missed, hours)
            return np.divide(lacking, possible, out=np.zeros_like(possible), where=enough)

        errors = model.pv_errors
        expected = np.clip(
            w.seen_from_origins(index)
            + w.course(errors, deviation(errors.recent_h), deviation(HOURS_PER_DAY)),
            0.0,
            1.0,
        )
        clear_at = w.seen_from_origins(clear)
        happened = np.divide(
            w.happened(sun.filled),
            clear_at[1:],
            out=expected[1:].copy(),
            where=w.seen_from_origins(sunny)[1:],
        )
        paths = (expected[0] + happened - expected[1:]) * clear_at[0]
        return np.asarray(np.where(np.isnan(peak), np.nan, paths))


@dataclass(frozen=True, eq=False)
class _Window:
    """The steps to come and the same times of past days, on the rows of a clock.

    Parameters
    ----------
    table : ClockTable
        The values.
    days : array, shape (M,)
        How many days before the present one the forecasts were issued whose errors are looked at.
    ahead : int
        Rows to come, W.
    dt_h : float
        Step length in h.
    """

    table: ClockTable
    days: Wholes
    ahead: int
    dt_h: float

    @property
    def origins(self) -> Wholes:
        """First rows of the present forecast and of those of the past, (1 + M,)."""
        return self.table.now - self.table.per_day * np.append(0, self.days)

    @property
    def span(self) -> range:
        """All rows that matter: from a day before the earliest origin on."""
        return range(int(self.origins.min()) - self.table.per_day, self.table.now + self.ahead)

    @property
    def early(self) -> Wholes:
        """Whole days before each row to come at which the forecast is issued, (W,)."""
        return np.asarray(np.arange(self.ahead) // self.table.per_day)

    def past(self, values: Floats) -> Floats:
        """Values of the rows that matter; NaN of those to come."""
        held = values[self.span.start : self.table.now]
        return np.vstack([held, np.full((self.ahead, values.shape[1]), np.nan)])

    def seen_from_origins(self, by_early: Any) -> Any:
        """What holds for each forecast and step, from (days early, span, items).

        Returns
        -------
        array, shape (1 + M, W, items)
        """
        rows = self.origins[:, np.newaxis] + np.arange(self.ahead) - self.span.start
        return by_early[self.early, rows]

    def happened(self, values: Floats) -> Floats:
        """What came in the past, (M, W, items)."""
        return np.asarray(values[self.origins[1:, np.newaxis] + np.arange(self.ahead)])

    def mean_of_last(self, values: Floats, hours: float) -> Floats:
        """Means of the last hours before each origin, (1 + M, items), of values of the span."""
        rows = max(round(hours / self.dt_h), 1)
        back = self.origins[:, np.newaxis] - self.span.start - np.arange(1, rows + 1)
        return np.asarray(values[back].mean(axis=1))

    def course(self, errors: LastErrors, recent: Floats, day: Floats) -> Floats:
        """How the last errors go on, (1 + M, W, items)."""
        leads_h = np.arange(1.0, self.ahead + 1.0) * self.dt_h
        return errors.course(recent, day, leads_h)


def past_days(table: ClockTable, days: Wholes, ahead: int) -> Floats:
    """The courses of past days, (M, W, items); each day is repeated where W is more than a day."""
    step = np.arange(ahead) % table.per_day
    rows = table.now - table.per_day * days[:, np.newaxis] + step
    return np.asarray(table.filled[rows])


def not_negative(paths: Floats) -> Floats:
    """Paths without negative values, with the same totals, (M, W, items).

    What an item is lifted to zero by, the others of the step give: dropped, it would narrow the
    spread of the total, whose errors were real.
    """
    lifted = np.maximum(paths, 0.0)
    total = np.nansum(lifted, axis=2)
    meant = np.maximum(np.nansum(paths, axis=2), 0.0)
    factor = np.divide(meant, total, out=np.ones_like(total), where=total > 0.0)
    return np.asarray(lifted * factor[:, :, np.newaxis])


def constant(table: ClockTable, ahead: int) -> Floats:
    """The mean of what is known, or NaN, as one path, (1, W, items)."""
    return np.broadcast_to(table.mean, (1, ahead, len(table.mean)))


def _known_share(load: ClockTable, sun: ClockTable, days: Wholes, ahead: int) -> Floats:
    """Share of values that are known of the rows from the same time of past days on, (M,)."""
    rows = np.arange(ahead)
    known = [
        ~np.isnan(t.values[t.now - t.per_day * days[:, np.newaxis] + rows]) for t in (load, sun)
    ]
    both = np.concatenate(known, axis=2)
    return np.asarray(both.mean(axis=(1, 2))) if both.size else np.zeros(len(days))
