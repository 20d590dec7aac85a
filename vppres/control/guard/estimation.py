"""What is measured, judged against what is expected; what is missing or frozen is estimated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats, Names, Wholes
from vppres.model.site import Site

SOC_TOLERANCE = 1e-3
"""A reading that stands still is frozen if the balance of energy moved by more than this."""

FROZEN_CHANGE = 0.05
"""Demand or PV power that stands still is frozen if the forecast's total moved by this share."""

SOC_MARGIN = 0.05
"""A state of charge further outside the battery's limits than this is no measurement."""

RESPONSE_SHARE = 0.02
SILENT_SHARE = 1e-3
"""A battery asked for more than the first share of its rating that gives less than the second is
out."""

RETRY_STEPS = 3
"""Steps after which a battery that did not respond is tried again."""


@dataclass(frozen=True, eq=False)
class Known:
    """What is taken for true at a step.

    Parameters
    ----------
    observation : Observation
        Every measurement finite and plausible.
    online : array of bool, shape (B,)
        Batteries that can be used.
    estimated : str
        What was not measured, in words; empty if everything was.
    """

    observation: Observation
    online: Flags
    estimated: str


class Estimator:
    """Keeps what is needed to judge the next measurements: the last ones, and what was commanded.

    Parameters
    ----------
    site : Site
        Fixed data.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self._last: Known | None = None
        self._before: Known | None = None
        self._raw: Observation | None = None
        self._frozen_series: set[str] = set()
        self._command_kw: Floats = np.zeros(len(site.batteries))
        self._out_until: Wholes = np.zeros(len(site.batteries), dtype=np.int64)

    def known(self, seen: Observation) -> Known:
        """The observation with estimates in place of what cannot be trusted."""
        power = self._power(seen)
        online = self._online(seen, power)
        soc, soc_words = self._soc(seen, power)
        load, load_words = self._series("load_kw", seen, self.site.customers.id)
        pv, pv_words = self._series("pv_kw", seen, self.site.pv.id)
        out = self.site.batteries.id[~online]
        words = [*soc_words, *load_words, *pv_words, *(f"battery {name} is out" for name in out)]
        forecast = replace(seen.forecast, load_kw=load, pv_kw=pv) if load_words or pv_words \
            else seen.forecast
        known = Known(replace(seen, forecast=forecast, soc=soc), online, "; ".join(words))
        self._before = self._last
        self._last = known
        self._raw = seen
        return known

    def commanded(self, charge_kw: Floats, discharge_kw: Floats) -> None:
        """Keep what the batteries were told, for dead reckoning."""
        self._command_kw = charge_kw - discharge_kw

    def _power(self, seen: Observation) -> Floats:
        """Net charging power of the last step: measured where it is, otherwise commanded."""
        if seen.battery_kw is None:
            return self._command_kw
        return np.where(np.isfinite(seen.battery_kw), seen.battery_kw, self._command_kw)

    def _online(self, seen: Observation, power_kw: Floats) -> Flags:
        """Batteries that report to be there and did what they were told."""
        told = np.ones(len(self.site.batteries), bool) if seen.online is None else seen.online
        rating = self.site.batteries.p_max_kw
        silent = ((np.abs(self._command_kw) > RESPONSE_SHARE * rating)
                  & (np.abs(power_kw) < SILENT_SHARE * rating))
        self._out_until = np.where(silent, seen.t0 + RETRY_STEPS, self._out_until)
        return told & (self._out_until <= seen.t0)

    def _soc(self, seen: Observation, power_kw: Floats) -> tuple[Floats, list[str]]:
        """State of charge: dead reckoning where the reading is missing, absurd or frozen."""
        b = self.site.batteries
        expected = self._expected_soc(power_kw)
        plausible = (np.isfinite(seen.soc) & (seen.soc >= b.soc_min - SOC_MARGIN)
                     & (seen.soc <= b.soc_max + SOC_MARGIN))
        frozen = np.zeros(len(b), dtype=bool)
        if self._raw is not None:
            frozen = (seen.soc == self._raw.soc) & (np.abs(seen.soc - expected) > SOC_TOLERANCE)
        # A reading just outside would leave a window without any feasible dispatch.
        soc = np.where(plausible & ~frozen, np.clip(seen.soc, b.soc_min, b.soc_max), expected)
        words = [f"soc {b.id[i]} {soc[i]:.4f} ({'frozen' if plausible[i] else 'missing'})"
                 for i in np.flatnonzero(~plausible | frozen)]
        return soc, words

    def _expected_soc(self, power_kw: Floats) -> Floats:
        """Last trusted state of charge and what was stored since."""
        b = self.site.batteries
        if self._last is None:
            return b.soc_initial
        o = self._last.observation
        stored = (o.eta_charge * np.maximum(power_kw, 0.0)
                  - np.maximum(-power_kw, 0.0) / o.eta_discharge)
        return np.clip(o.soc + stored * self.site.dt_h / b.energy_kwh, b.soc_min, b.soc_max)

    def _series(self, name: str, seen: Observation,
                ids: Names) -> tuple[Floats, list[str]]:
        """Demand or PV power of the window, its first step estimated where it must be."""
        values: Floats = getattr(seen.forecast, name)
        now = values[0]
        missing = ~(np.isfinite(now) & (now >= 0.0))
        frozen = self._frozen(name, seen)
        if not (frozen or missing.any()):
            return values, []
        wrong = np.ones(len(now), dtype=bool) if frozen else missing
        estimate = np.where(wrong, self._expected(name, seen), now)
        words = name.removesuffix("_kw")
        if wrong.all():
            text = [f"{words} of all {len(ids)}, {estimate.sum():.1f} kW "
                    f"({'frozen' if frozen else 'missing'})"]
        else:
            text = [f"{words} {ids[i]} {estimate[i]:.2f} kW (missing)"
                    for i in np.flatnonzero(wrong)]
        return np.vstack([estimate, values[1:]]), text

    def _frozen(self, name: str, seen: Observation) -> bool:
        """Whether not one reading moved although the forecasts of the two steps differ.

        Both totals are forecast one step ahead, so that a bias cancels. What is frozen stays so
        until a reading moves.
        """
        if self._raw is None:
            return False
        now = getattr(seen.forecast, name)[0]
        before = getattr(self._raw.forecast, name)[0]
        same = bool(np.array_equal(now, before) and now.any())
        older, newer = (_total_ahead(known, name) for known in (self._before, self._last))
        moved = abs(newer - older) > FROZEN_CHANGE * max(older, newer)  # NaN: not known to have
        frozen = same and (moved or name in self._frozen_series)
        (self._frozen_series.add if frozen else self._frozen_series.discard)(name)
        return frozen

    def _expected(self, name: str, seen: Observation) -> Floats:
        """What the last step's forecast said of this one; failing that, the last known values."""
        ahead: Floats = getattr(seen.forecast, name)
        if self._last is None:
            return ahead[1] if len(ahead) > 1 else np.zeros(ahead.shape[1])
        before: Floats = getattr(self._last.observation.forecast, name)
        last: Floats = before[1 if len(before) > 1 else 0]
        return last


def _total_ahead(known: Known | None, name: str) -> float:
    """Total that was forecast one step ahead, NaN if there was none."""
    rows: Floats = np.zeros((0, 0)) if known is None else getattr(known.observation.forecast, name)
    return float(rows[1].sum()) if len(rows) > 1 else float("nan")
