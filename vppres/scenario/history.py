"""Demand and available PV power that were measured before a day, by step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, freeze_arrays
from vppres.core.errors import InputError
from vppres.core.units import minutes_to_h
from vppres.scenario.timegrid import UTC

HISTORY = "history"


@dataclass(frozen=True, eq=False)
class History:
    """Measured series of ``n`` equal steps, NaN where nothing is known; ``n`` may be 0.

    Examples
    --------
    >>> day = pd.Timestamp("2022-07-18", tz="UTC")
    >>> history = History(day, 60, np.ones((24, 2)), np.zeros((24, 1)))
    >>> history.end.isoformat(), history.before(day + pd.Timedelta(hours=5)).n_steps
    ('2022-07-19T00:00:00+00:00', 5)
    """

    start: pd.Timestamp  #: beginning of the first step, with time zone
    step_minutes: float  #: step length in minutes
    load_kw: Floats  #: demand of each customer, (n, C)
    pv_kw: Floats  #: available power of each PV system, (n, P)
    zone: str = UTC  #: time zone of the clocks that people live by

    def __post_init__(self) -> None:
        freeze_arrays(self)
        if self.load_kw.ndim != 2 or self.pv_kw.ndim != 2 or len(self.load_kw) != len(self.pv_kw):
            raise InputError.of(
                HISTORY,
                f"has demand of shape {self.load_kw.shape} and PV power of shape "
                f"{self.pv_kw.shape}",
                "Give one row for each step and one column for each item in both.",
            )

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.load_kw)

    @property
    def n_days(self) -> float:
        """Days of 24 h."""
        return self.n_steps * self.dt_h / 24.0

    @property
    def step(self) -> pd.Timedelta:
        """Step length."""
        return pd.Timedelta(minutes=self.step_minutes)

    @property
    def dt_h(self) -> float:
        """Step length in h."""
        return minutes_to_h(self.step_minutes)

    @property
    def end(self) -> pd.Timestamp:
        """End of the last step."""
        return self.start + self.n_steps * self.step

    @property
    def times(self) -> pd.DatetimeIndex:
        """Beginning of every step."""
        return self.times_of(range(self.n_steps))

    def times_of(self, rows: range) -> pd.DatetimeIndex:
        """Beginnings of consecutive rows, of those after the last one too."""
        return pd.date_range(
            self.start + rows.start * self.step, periods=len(rows), freq=self.step, name="time"
        )

    def row_of(self, time: pd.Timestamp) -> int:
        """Row of the step that begins at a time, or of the first one after it."""
        return int(np.ceil((time - self.start) / self.step))

    def rows(self, first: int, last: int) -> History:
        """The steps ``first`` up to but without ``last``, as far as there are any."""
        first = min(max(first, 0), self.n_steps)
        last = min(max(last, first), self.n_steps)
        return replace(
            self,
            start=self.start + first * self.step,
            load_kw=self.load_kw[first:last],
            pv_kw=self.pv_kw[first:last],
        )

    def before(self, time: pd.Timestamp) -> History:
        """Steps that were over at a time."""
        return self.rows(0, int((time - self.start) // self.step))

    def last_days(self, days: float) -> History:
        """The latest days alone."""
        return self.rows(self.n_steps - round(days * 1440 / self.step_minutes), self.n_steps)

    def followed_by(self, start: pd.Timestamp, load_kw: Floats, pv_kw: Floats) -> History:
        """The history with further steps from ``start`` on, (m, C) and (m, P).

        Steps in between are not known, older ones are replaced.
        """
        kept = self.before(start)
        if not kept.n_steps:
            kept = replace(kept, start=start)
        missing = round((start - kept.end) / self.step)
        return replace(
            kept,
            load_kw=np.vstack([kept.load_kw, _unknown(missing, load_kw), load_kw]),
            pv_kw=np.vstack([kept.pv_kw, _unknown(missing, pv_kw), pv_kw]),
        )

    def in_steps_of(self, step_minutes: float) -> History:
        """Resample to other steps: means of shorter ones, or each longer one repeated.

        Steps of which neither length is a multiple of the other are repeated minute by minute in
        between. What does not fill a whole step at the beginning is left out.
        """
        if step_minutes == self.step_minutes:
            return self
        fine = np.gcd(round(self.step_minutes), round(step_minutes))
        repeated = round(self.step_minutes / fine)
        averaged = round(step_minutes / fine)
        loose = (self.n_steps * repeated) % averaged
        return replace(
            self,
            start=self.start + pd.Timedelta(minutes=float(loose * fine)),
            step_minutes=step_minutes,
            load_kw=_resampled(self.load_kw, repeated, averaged, loose),
            pv_kw=_resampled(self.pv_kw, repeated, averaged, loose),
        )


def _unknown(rows: int, like: Floats) -> Floats:
    """Steps of which nothing is known."""
    return np.full((max(rows, 0), like.shape[1]), np.nan)


def _resampled(values: Floats, repeated: int, averaged: int, loose: int) -> Floats:
    """Rows repeated, then averaged in groups that end with the last."""
    fine = np.repeat(values, repeated, axis=0)[loose:]
    return np.asarray(fine.reshape(-1, averaged, values.shape[1]).mean(axis=1))
