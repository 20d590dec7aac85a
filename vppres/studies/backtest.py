"""A forecaster against what came: every few hours of a history a forecast, scored by lead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, mean_of_known
from vppres.core.errors import InputError
from vppres.core.plain import json_safe
from vppres.day.forecasting import history_before
from vppres.forecasts.interface import ForecastMethod, LoadAndPV
from vppres.forecasts.quantile_file import read_quantiles
from vppres.forecasts.seasonal import Seasonal
from vppres.io.find import is_scenario, load_scenario
from vppres.io.history import read_history
from vppres.scenario.history import History
from vppres.scenario.timegrid import UTC, is_zone
from vppres.studies.issue_scores import (
    ENERGY_H,
    FORECAST,
    QUANTITIES,
    REFERENCES,
    SHARES,
    scores_of_issue,
)

RECENT_DAYS = 30
LEAD_RANGES = ((0, 6), (6, 24), (24, 48))
"""Leads in h that tables hold together: after the first, up to the last."""
LEARNING_DAYS = 78
"""Days of history that the first forecast has before it, where there is enough."""
FEWEST_DAYS = 14

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Plan:
    """Choice of the forecasts that are made.

    One that is issued at times that do not divide 24 h has every lead at every hour. Issues are
    from ``first`` to ``last``, as far as there is enough history before them and behind.
    """

    horizon_h: float = 48.0
    every_h: float = 7.0
    first: pd.Timestamp | None = None
    last: pd.Timestamp | None = None

    def issues(self, history: History) -> pd.DatetimeIndex:
        """Times at which forecasts are issued."""
        learning = pd.Timedelta(days=min(LEARNING_DAYS, FEWEST_DAYS + history.n_days / 4.0))
        horizon = pd.Timedelta(hours=self.horizon_h)
        earliest = (history.start + learning).ceil(history.step)
        first = max(earliest, self.first or earliest)
        last = history.end - horizon
        last = min(last, self.last or last)
        row = history.row_of(first)
        every = max(round(self.every_h / history.dt_h), 1)
        rows = range(row, history.row_of(last) + 1, every)
        if not len(rows):
            raise InputError.of(
                "backtest",
                f"there is no issue of a forecast between {first.isoformat()} and "
                f"{last.isoformat()}",
                f"Give at least {FEWEST_DAYS} days of history before the first issue and "
                f"{self.horizon_h:g} h behind the last.",
                field="history",
                value=f"{history.start.isoformat()} to {history.end.isoformat()}",
            )
        return history.times[rows.start : rows.stop : rows.step]


@dataclass(frozen=True, eq=False)
class Backtest:
    """Scores of all forecasts: N issues, W steps."""

    history: History
    plan: Plan
    forecaster: str
    issues: pd.DatetimeIndex
    #: ``crps``, ``climatology`` and ``weekly`` (the references' CRPS), ``each`` (mean CRPS of the
    #: single items), ``pit``, ``width 0.8`` and ``held 0.8`` of each interval, (N, W); ``energy 6
    #: 0.8``, whether the interval of the energy of the first hours held, and ``paths``, the energy
    #: scores of forecast and climatology, (N,) and (N, 2). NaN where something is not known, or PV
    #: at night.
    scores: dict[tuple[str, str], Floats]
    bases: list[str]  #: what each forecast rested on
    last: LoadAndPV

    @cached_property
    def leads_h(self) -> Floats:
        """Hours from the issue to the end of each step, (W,)."""
        steps = round(self.plan.horizon_h / self.history.dt_h)
        return np.asarray(np.arange(1, steps + 1) * self.history.dt_h, dtype=float)

    @cached_property
    def quantities(self) -> list[str]:
        """Quantities that were forecast: a history without PV power has no more than load."""
        there = QUANTITIES if self.history.pv_kw.shape[1] else QUANTITIES[:1]
        return [name for name in there if not np.isnan(self.scores["crps", name]).all()]

    @property
    def recent(self) -> Flags:
        """Which issues are of the last days, (N,)."""
        return np.asarray(self.issues > self.issues[-1] - pd.Timedelta(days=RECENT_DAYS))

    def mean(self, name: str, quantity: str, where: Any = slice(None)) -> Floats:
        """Mean of a score over the issues, by lead or not; NaN where there is nothing."""
        return mean_of_known(self.scores[name, quantity][where])

    def by_lead(self) -> pd.DataFrame:
        """All scores by lead, one row for each quantity and lead; powers in kW."""
        columns = {
            "crps_kw": "crps",
            "crps_climatology_kw": "climatology",
            "crps_weekly_kw": "weekly",
            **{f"held_{share:.0%}": f"held {share}" for share in SHARES},
            **{f"width_{share:.0%}_kw": f"width {share}" for share in SHARES},
        }
        tables = []
        for quantity in self.quantities:
            scores = {column: self.mean(name, quantity) for column, name in columns.items()}
            tables.append(pd.DataFrame({"quantity": quantity, "lead_h": self.leads_h, **scores}))
        return pd.concat(tables, ignore_index=True)

    def _errors(
        self, quantity: str, leads: Any = slice(None), where: Any = slice(None)
    ) -> dict[str, float]:
        """CRPS of some leads and issues: in kW, and relative to the references."""
        own, climatology, weekly = (
            float(mean_of_known(self.mean(name, quantity, where)[leads]))
            for name in ("crps", "climatology", "weekly")
        )
        to = {"to_climatology": _relative(own, climatology), "to_weekly": _relative(own, weekly)}
        return {"crps_kw": own, **to}

    def ranges(self) -> pd.DataFrame:
        """CRPS over ranges of leads: in kW, and relative to the references."""
        rows = []
        for quantity in self.quantities:
            for after, until in LEAD_RANGES:
                leads = (self.leads_h > after) & (self.leads_h <= until)
                if leads.any():
                    place = {"quantity": quantity, "after_h": after, "until_h": until}
                    rows.append(place | self._errors(quantity, leads))
        return pd.DataFrame(rows)

    def energy(self) -> pd.DataFrame:
        """How often intervals of the energy of the first hours held."""
        rows = [
            {
                "quantity": quantity,
                "hours": hours,
                **{
                    f"held_{share:.0%}": float(self.mean(f"energy {hours} {share}", quantity))
                    for share in SHARES
                },
            }
            for quantity in self.quantities
            for hours in ENERGY_H
            if hours <= self.plan.horizon_h
        ]
        return pd.DataFrame(rows)

    def drift(self) -> pd.DataFrame:
        """The last days beside all: CRPS to climatology, and what the 80 % interval held."""
        rows = []
        for quantity in self.quantities:
            row: dict[str, Any] = {"quantity": quantity}
            for words, where in (("all", slice(None)), ("recent", self.recent)):
                errors = self._errors(quantity, where=where)
                row[f"to_climatology_{words}"] = errors["to_climatology"]
                row[f"held_80%_{words}"] = float(
                    mean_of_known(self.mean("held 0.8", quantity, where))
                )
            rows.append(row)
        return pd.DataFrame(rows)

    def by_month(self) -> pd.DataFrame:
        """Coverage of the 80 % interval in each month, one column for each quantity."""
        month = self.issues.strftime("%Y-%m")
        names = pd.Index(dict.fromkeys(month), name="month")
        held = {
            quantity: [
                float(mean_of_known(self.mean("held 0.8", quantity, month == name)))
                for name in names
            ]
            for quantity in self.quantities
        }
        return pd.DataFrame(held, index=names)

    def summary(self) -> dict[str, Any]:
        """All tables as JSON can hold them."""
        found = {
            "forecaster": self.forecaster,
            "issues": len(self.issues),
            "first_issue": self.issues[0].isoformat(),
            "last_issue": self.issues[-1].isoformat(),
            "horizon_h": self.plan.horizon_h,
            "every_h": self.plan.every_h,
            "basis": pd.Series(self.bases).value_counts().to_dict(),
            "mean_kw": {
                "load": float(np.nansum(np.nanmean(self.history.load_kw, axis=0))),
                "pv": float(np.nansum(np.nanmean(self.history.pv_kw, axis=0)))
                if self.history.pv_kw.shape[1]
                else 0.0,
            },
            "crps": self.ranges().to_dict("records"),
            "energy": self.energy().to_dict("records"),
            "drift": self.drift().to_dict("records"),
            "each_to_total": {
                quantity: 1.0
                + _relative(
                    float(np.nanmean(self.mean("each", quantity))),
                    float(np.nanmean(self.mean("crps", quantity))),
                )
                for quantity in self.quantities
                if quantity != "net"
            },
            "energy_score_to_climatology": {
                quantity: _relative(*self.mean("paths", quantity)) for quantity in self.quantities
            },
        }
        safe: dict[str, Any] = json_safe(found)
        return safe


def _relative(error: float, reference: float) -> float:
    """An error relative to a reference's: NaN where the reference has none, as of PV at night."""
    return float(error / reference - 1.0) if reference else float("nan")


def backtest(
    history: History,
    plan: Plan | None = None,
    forecaster: ForecastMethod | None = None,
    name: str = "seasonal",
    progress: Progress | None = None,
) -> Backtest:
    """Score a forecaster, the seasonal one if none is given, on a history; ``name`` is its name.

    ``progress`` is called as ``progress(forecasts done, forecasts in all)``.
    """
    plan = plan or Plan()
    issues = plan.issues(history)
    steps = round(plan.horizon_h / history.dt_h)
    tried = {FORECAST: forecaster or Seasonal(), **REFERENCES}
    collected: list[dict[tuple[str, str], Any]] = []
    bases = []
    for done, issued_at in enumerate(issues, start=1):
        found = {words: one.forecast(history, issued_at, steps) for words, one in tried.items()}
        collected.append(scores_of_issue(history, found, history.row_of(issued_at)))
        bases.append(str(found[FORECAST].basis))
        if progress:
            progress(done, len(issues))
    scores = {key: np.array([one[key] for one in collected]) for key in collected[0]}
    return Backtest(history, plan, name, issues, scores, bases, found[FORECAST])


def measured_in(name_or_path: str, zone: str | None = None) -> History:
    """The history of a scenario with its own days, or of a folder or file of series.

    The series are what :func:`vppres.io.history.read_history` takes; ``zone`` is that of the
    clocks, the scenario's or UTC if not given.
    """
    if zone is not None and not is_zone(zone):
        raise InputError.of(
            "options",
            "is not the name of a time zone",
            "Give one such as Europe/London.",
            field="zone",
            value=zone,
        )
    if not is_scenario(name_or_path):
        return read_history(Path(name_or_path), zone=zone or UTC)
    day = load_scenario(name_or_path)
    history = history_before(day).followed_by(day.grid.start, day.load_kw, day.pv_kw)
    return history if zone is None else replace(history, zone=zone)


def forecasts_in(file: str | Path, history: History) -> ForecastMethod:
    """A provider's quantiles of the totals ``load`` and ``pv``, to be scored on a history."""
    load_ids, pv_ids = (
        np.array([f"{words} {i}" for i in range(values.shape[1])], dtype=object)
        for words, values in (("customer", history.load_kw), ("system", history.pv_kw))
    )
    return read_quantiles(file, load_ids, pv_ids)
