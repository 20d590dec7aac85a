"""Measurements at a forecast's issue, and the same times of past days beside the steps to come."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import InputError
from vppres.forecasts.clock import ClockTable, on_clock
from vppres.forecasts.interface import Basis, LoadAndPV
from vppres.scenario.history import History
from vppres.scenario.timegrid import UTC

HOURS_PER_DAY = 24.0
MOST_SHARE = 1.2
"""Largest multiple of the errors that a rule supposes to go on."""
LEAST_KNOWN = 0.5
"""Share of a day's values that must be known for the day to count."""


@dataclass(frozen=True)
class LastErrors:
    """Rule by which the latest errors of a forecast go on."""

    recent_h: float  #: hours of which the recent error is the mean
    recent_decay_per_h: float  #: what is left of it after an hour
    day_share: float  #: share of the last day's mean error that goes on
    day_decay_per_h: float  #: what is left of that after an hour

    def courses(self, recent: Floats, day: Floats, leads_h: Floats) -> tuple[Floats, Floats]:
        """How the recent and the last day's error go on, (..., W, items) each.

        The day's error comes in as the recent one goes out.

        Parameters
        ----------
        recent, day : array, shape (..., items)
            The last errors.
        leads_h : array, shape (W,)
            Leads in h.
        """
        fresh = (self.recent_decay_per_h**leads_h)[:, np.newaxis]
        slow = self.day_share * (self.day_decay_per_h**leads_h)[:, np.newaxis] * (1.0 - fresh)
        return fresh * recent[..., np.newaxis, :], slow * day[..., np.newaxis, :]


@dataclass(frozen=True, eq=False)
class PastMeasurements:
    """Load and PV power as measured when a forecast is issued, and nothing later."""

    issued_at: pd.Timestamp  #: beginning of the first step to come
    #: Step length.
    step_minutes: float
    dt_h: float
    #: Demand on the clocks of the feeder, PV power on the solar clock.
    load: ClockTable
    sun: ClockTable

    @classmethod
    def at(
        cls, history: History, issued_at: pd.Timestamp, steps: int, memory_days: int
    ) -> PastMeasurements:
        """Measurements of the steps that were over at a time, no older than they matter.

        Parameters
        ----------
        history : History
            It may go on afterwards.
        issued_at : pandas.Timestamp
            Beginning of a step.
        steps : int
            Steps to come.
        memory_days : int
            Days before the first day to come that matter.

        Raises
        ------
        InputError
            If steps do not fill a day, or ``issued_at`` is not the beginning of one.
        """
        if (issued_at - history.start) % history.step != pd.Timedelta(0):
            raise InputError.of(
                "forecast",
                "is not the beginning of a step of the history",
                f"Steps last {history.step_minutes:g} min from {history.start.isoformat()}.",
                field="issued_at",
                value=issued_at,
            )
        over = history.followed_by(issued_at, history.load_kw[:0], history.pv_kw[:0])
        ahead_days = int(np.ceil(steps * history.dt_h / HOURS_PER_DAY))
        past = over.last_days(memory_days + ahead_days)
        return cls(
            issued_at,
            past.step_minutes,
            past.dt_h,
            on_clock(past, past.load_kw, past.zone, steps),
            on_clock(past, past.pv_kw, UTC, steps),
        )

    @property
    def ahead(self) -> int:
        """Rows of the clocks to come."""
        return int(max(self.load.ahead[-1], self.sun.ahead[-1])) + 1

    def window(self, table: ClockTable, days: Wholes) -> ClockWindow:
        """The rows to come of a table, and those of past days."""
        return ClockWindow(table, days, self.ahead, self.dt_h)

    def days_with_errors(self, most: int, rule_days: int = 1) -> Wholes:
        """Past days whose errors can be looked at: over, known, and with days before them."""
        per_day = self.load.per_day
        first = -(-self.ahead // per_day)
        whole = min(self.load.days, self.sun.days) - rule_days
        days = np.arange(first, min(whole, first + most - 1) + 1)
        return days[known_share(self.load, self.sun, days, self.ahead) >= LEAST_KNOWN]

    def past_days(self, most: int) -> Wholes:
        """Past days that are known."""
        days = np.arange(1, min(self.load.days, self.sun.days, most) + 1)
        return days[known_share(self.load, self.sun, days, self.load.per_day) >= LEAST_KNOWN]

    def of_past_days(self, days: Wholes) -> LoadAndPV:
        """The courses of past days; each is repeated where there is more than a day to come."""
        step = np.arange(self.ahead) % self.load.per_day

        def courses(table: ClockTable) -> Floats:
            rows = table.now - table.per_day * days[:, np.newaxis] + step
            return np.asarray(table.filled[rows])

        return self.forecast(courses(self.load), courses(self.sun), "past days")

    def of_the_mean(self) -> LoadAndPV:
        """The mean of what is known, as one path; NaN of nothing."""
        load, sun = (
            np.broadcast_to(table.mean, (1, self.ahead, len(table.mean)))
            for table in (self.load, self.sun)
        )
        known = self.load.any_known or self.sun.any_known
        return self.forecast(load, sun, "recent values" if known else "nothing")

    def forecast(self, load_kw: Floats, pv_kw: Floats, basis: Basis) -> LoadAndPV:
        """Paths by row of the clocks, (M, rows, items), as a forecast by step."""
        return LoadAndPV(
            self.issued_at,
            self.step_minutes,
            not_negative(load_kw[:, self.load.ahead]),
            not_negative(pv_kw[:, self.sun.ahead]),
            basis,
        )


@dataclass(frozen=True, eq=False)
class ClockWindow:
    """The steps to come and the same times of past days, on the rows of a clock."""

    table: ClockTable  #: the values
    #: How many days before the present one the forecasts were issued whose errors are looked at,
    #: (M,).
    days: Wholes
    ahead: int  #: rows to come, W
    dt_h: float  #: step length in h

    @property
    def leads_h(self) -> Floats:
        """Hours from the issue to the end of each row to come, (W,)."""
        return np.asarray(np.arange(1.0, self.ahead + 1.0) * self.dt_h)

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
        """Values for each forecast and step, from (days early, span, items).

        Returns
        -------
        array, shape (1 + M, W, items)
        """
        rows = self.origins[:, np.newaxis] + np.arange(self.ahead) - self.span.start
        return by_early[self.early, rows]

    def happened(self, values: Floats) -> Floats:
        """Values that came after each past origin, (M, W, items)."""
        return np.asarray(values[self.origins[1:, np.newaxis] + np.arange(self.ahead)])

    def mean_of_last(self, values: Floats, hours: float) -> Floats:
        """Means of the last hours before each origin, (1 + M, items), of values of the span."""
        rows = max(round(hours / self.dt_h), 1)
        back = self.origins[:, np.newaxis] - self.span.start - np.arange(1, rows + 1)
        return np.asarray(values[back].mean(axis=1))

    def courses(self, errors: LastErrors, recent: Floats, day: Floats) -> tuple[Floats, Floats]:
        """How the last errors go on, (1 + M, W, items) each."""
        return errors.courses(recent, day, self.leads_h)


def like_days_before(
    w: ClockWindow, days_at: Callable[[int], Iterable[int]], errors: LastErrors | None = None
) -> Floats:
    """Paths of what is the mean of some days before, with the errors of that rule, (M, W, items).

    Parameters
    ----------
    w : ClockWindow
        The steps to come and past days.
    days_at : callable
        Days before a step whose mean it is, by the whole days early that it is forecast.
    errors : LastErrors, optional
        How the latest errors go on; not at all if not given.
    """
    table = w.table
    usual = np.array(
        [table.mean_before(w.span, days_at(early)) for early in range(int(w.early.max()) + 1)]
    )
    expected = w.seen_from_origins(usual)
    happened = w.happened(table.filled)
    if errors is not None:
        error = w.past(table.filled) - usual[0]
        recent, day = w.courses(
            errors,
            w.mean_of_last(error, errors.recent_h),
            w.mean_of_last(error, HOURS_PER_DAY),
        )
        shares = learnt_shares(recent[1:], day[1:], happened - expected[1:])
        expected = expected + shares[0] * recent + shares[1] * day
    return np.asarray(expected[0] + happened - expected[1:])


def learnt_shares(recent: Floats, day: Floats, came: Floats) -> Floats:
    """Multiples of two courses of errors that past days speak for, (2,).

    Least squares of the feeder's totals, in which 1 has as much weight as the days: what a rule
    supposes of errors that go on is halved where the days show none.

    Parameters
    ----------
    recent, day, came : array, shape (M, W, items)
        The courses supposed, and the errors that came.

    Examples
    --------
    >>> ones = np.ones((4, 3, 1))
    >>> [float(share) for share in learnt_shares(ones, 0.0 * ones, 0.5 * ones)]
    [0.75, 1.0]
    """
    supposed = np.stack([np.nansum(course, axis=2).ravel() for course in (recent, day)])
    true = np.nansum(came, axis=2).ravel()
    products = supposed @ supposed.T
    weight = np.diag(np.where(np.diag(products) > 0.0, np.diag(products), 1.0))
    found = np.linalg.solve(products + weight, supposed @ true + weight.sum(axis=1))
    return np.asarray(np.clip(found, 0.0, MOST_SHARE))


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


def known_share(load: ClockTable, sun: ClockTable, days: Wholes, ahead: int) -> Floats:
    """Share of values that are known of the rows from the same time of past days on, (M,)."""
    rows = np.arange(ahead)
    known = [
        ~np.isnan(t.values[t.now - t.per_day * days[:, np.newaxis] + rows]) for t in (load, sun)
    ]
    both = np.concatenate(known, axis=2)
    return np.asarray(both.mean(axis=(1, 2))) if both.size else np.zeros(len(days))
