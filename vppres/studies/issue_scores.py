"""Scores of one issue of a backtest: a forecast and its references against what came.

Axes: M paths, W steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.forecasts.interface import ForecastMethod, LoadAndPV
from vppres.forecasts.references import Climatology, WeeklyNaive
from vppres.forecasts.scores import crps, energy_score, holds, interval, pit
from vppres.scenario.history import History

QUANTITIES = ("load", "pv", "net")
SHARES = (0.5, 0.8, 0.9)
"""Nominal coverage of central intervals."""
ENERGY_H = (6, 12, 24)
FORECAST = "forecast"
REFERENCES: dict[str, ForecastMethod] = {"climatology": Climatology(), "weekly": WeeklyNaive()}
DAYLIGHT = 0.02
"""Share of the largest power from which on an hour counts as day: at night PV is known."""


@dataclass(frozen=True, eq=False)
class Issued:
    """One quantity of an issue."""

    paths: Mapping[str, Floats]  #: of the forecast and of each reference, in kW, (M, W)
    came: Floats  #: what came, in kW, (W,); NaN where it is not known
    counts: Flags  #: steps at which something had to be forecast, (W,): PV at night has not
    dt_h: float  #: length of a step

    def scores(self) -> Iterator[tuple[str, Any]]:
        """Names and values of its scores, (W,) unless they are of an energy or of whole paths."""
        own = self.paths[FORECAST]
        own_crps = crps(own, self.came)
        known = ~np.isnan(own_crps)
        yield "crps", own_crps
        for words in REFERENCES:
            yield words, _where(known, crps(self.paths[words], self.came))
        yield "pit", _where(self.counts & known, pit(own, self.came))
        yield from self._intervals(self.counts & known)
        yield from self._energies(known)
        yield "paths", [energy_score(self.paths[w], self.came) for w in (FORECAST, "climatology")]

    def _intervals(self, there: Flags) -> Iterator[tuple[str, Floats]]:
        """Whether central intervals held, and how wide they were."""
        for share in SHARES:
            ends = interval(self.paths[FORECAST], share)
            yield f"held {share}", _where(there, holds(ends, self.came))
            yield f"width {share}", _where(there, ends[1] - ends[0])

    def _energies(self, known: Flags) -> Iterator[tuple[str, float]]:
        """Whether intervals of the energy of the first hours held; NaN where it is not known."""
        for hours in ENERGY_H:
            if hours > len(self.came) * self.dt_h:
                continue
            first = slice(round(hours / self.dt_h))
            energies = self.paths[FORECAST][:, first].sum(axis=1)
            there = bool(self.counts[first].any()) and bool(known[first].all())
            for share in SHARES:
                held = holds(interval(energies, share), self.came[first].sum())
                yield f"energy {hours} {share}", float(held) if there else np.nan


def scores_of_issue(
    history: History, found: Mapping[str, LoadAndPV], row: int
) -> dict[tuple[str, str], Any]:
    """All scores of one issue, by name and quantity.

    ``found`` has the forecast and the references', which begin with a ``row`` of the history.
    """
    own = found[FORECAST]
    steps = own.load_kw.shape[1]
    came = came_in(history, row, steps)
    totals = {words: totals_of(one) for words, one in found.items()}
    counts = dict.fromkeys(QUANTITIES, np.ones(steps, dtype=bool))
    counts["pv"] = _daylight(found["climatology"].pv_kw, history.pv_kw[:row])
    scores: dict[tuple[str, str], Any] = {}
    for quantity in QUANTITIES:
        paths = {words: total[quantity] for words, total in totals.items()}
        issued = Issued(paths, came[quantity], counts[quantity], history.dt_h)
        scores |= {(name, quantity): value for name, value in issued.scores()}
    rows = slice(row, row + steps)
    scores["each", "load"] = crps(own.load_kw, history.load_kw[rows]).sum(axis=1)
    scores["each", "pv"] = crps(own.pv_kw, history.pv_kw[rows]).sum(axis=1)
    return scores


def came_in(history: History, row: int, steps: int) -> dict[str, Floats]:
    """Values of each quantity in some steps from a row on, (W,)."""
    rows = slice(row, row + steps)
    load, pv = history.load_kw[rows].sum(axis=1), history.pv_kw[rows].sum(axis=1)
    return {"load": load, "pv": pv, "net": load - pv}


def totals_of(forecast: LoadAndPV) -> dict[str, Floats]:
    """Paths of the feeder's totals, (M, W)."""
    return {
        "load": forecast.load_kw.sum(axis=2),
        "pv": forecast.pv_kw.sum(axis=2),
        "net": forecast.net_kw,
    }


def _daylight(past_days: Floats, before: Floats) -> Flags:
    """Whether there was sun at the time of a step on any of the last days, (W,)."""
    if not past_days.size:
        return np.zeros(past_days.shape[1], dtype=bool)
    total = np.nansum(past_days, axis=2).max(axis=0)
    return np.asarray(total > DAYLIGHT * np.nansum(before, axis=1).max())


def _where(there: Flags, values: Any) -> Floats:
    """Numbers, NaN elsewhere."""
    return np.where(there, np.asarray(values, dtype=float), np.nan)
