"""Forecasts that others have to beat."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from vppres.forecasts.interface import LoadAndPV
from vppres.forecasts.window import PastMeasurements, like_days_before
from vppres.scenario.history import History


@dataclass(frozen=True)
class Climatology:
    """Values at the same time of day on each of the last days: the honest reference."""

    days: int = 42  #: number of days, each a path

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """See :class:`vppres.forecasts.interface.ForecastMethod`."""
        known = PastMeasurements.at(history, issued_at, steps, self.days)
        days = known.past_days(self.days)
        return known.of_past_days(days) if len(days) else known.of_the_mean()


@dataclass(frozen=True)
class WeeklyNaive:
    """Values of a week before, with that rule's errors: the weak reference that many quote."""

    residual_days: int = 42  #: past days whose errors are looked at

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """See :class:`vppres.forecasts.interface.ForecastMethod`."""
        known = PastMeasurements.at(history, issued_at, steps, self.residual_days + 9)
        days = known.days_with_errors(self.residual_days, rule_days=7)
        if not len(days):
            return Climatology().forecast(history, issued_at, steps)
        load_kw, pv_kw = (
            like_days_before(known.window(table, days), a_week_before)
            for table in (known.load, known.sun)
        )
        return known.forecast(load_kw, pv_kw, "model")


def a_week_before(early: int) -> list[int]:
    """The days before a step that a rule of whole weeks looks at, known that many days early."""
    return [7 * (early // 7 + 1)]
