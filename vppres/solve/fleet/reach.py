"""Reach of one battery with all energies and powers: no fleet carries more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING
from vppres.model.site import Site
from vppres.solve.programs import SOLVED

LEAST_EFFICIENCY = 0.01
"""Of a fleet without batteries, which has no power either; no battery has less."""


@dataclass(frozen=True, eq=False)
class OneBattery:
    """A battery of the whole fleet with the best of all efficiencies.

    It charges whenever there is power to spare: more energy never hurts. What it lacks of power or
    energy is forgiven as a solver forgives it in its rows, or it would bound what these reach.

    Attributes
    ----------
    stored_kwh, most_kwh : float
        Energy before the window, and the most that it may charge to.
    least_kwh, power_kw : array, shape (W,)
        Least energy at the end of each step, and power, less what physical mode keeps free.
    given_kw : array, shape (W,)
        PV power and the most import, less what the network takes.
    per_charged, per_discharged : float
        Energy for a kW of a step.
    """

    stored_kwh: float
    most_kwh: float
    least_kwh: Floats
    power_kw: Floats
    given_kw: Floats
    per_charged: float
    per_discharged: float

    @classmethod
    def of(cls, site: Site, data: WindowData) -> OneBattery:
        """The battery of a window."""
        b = site.batteries
        return cls(
            stored_kwh=float(b.energy_kwh @ data.soc),
            most_kwh=float(b.energy_kwh @ b.soc_max),
            least_kwh=data.soc_min(b) @ b.energy_kwh,
            power_kw=data.active_max_kw(b).sum(axis=1),
            given_kw=data.pv_kw.sum(axis=1) + np.maximum(data.grid_limit_kw, 0.0) - data.network_kw,
            per_charged=data.eta_charge.max(initial=LEAST_EFFICIENCY) * site.dt_h,
            per_discharged=site.dt_h / data.eta_discharge.max(initial=LEAST_EFFICIENCY),
        )

    def after(self, t: int, stored_kwh: Floats, demand_kw: float) -> Floats:
        """Energies after a step with a demand, from some before it; -inf where it has too little.

        >>> one = OneBattery(5.0, 9.0, np.zeros(1), np.array([3.0]), np.array([2.0]), 0.9, 1.25)
        >>> one.after(0, np.array([2.0, 5.0, 8.5]), 0.0).tolist()
        [3.8, 6.8, 9.0]
        >>> one.after(0, np.array([2.0, 5.0]), 4.0).tolist()
        [-inf, 2.5]
        >>> one.after(0, np.array([8.0]), 5.5).tolist()
        [-inf]
        """
        spare = float(self.given_kw[t]) - demand_kw
        missing = -spare - max(SOLVED, ROUNDING * (1.0 + abs(demand_kw)))
        if missing > self.power_kw[t]:
            return np.full(len(stored_kwh), -np.inf)
        per_kw = self.per_charged if spare > 0.0 else self.per_discharged
        flow_kwh = min(spare, float(self.power_kw[t])) * per_kw
        after = np.minimum(stored_kwh + flow_kwh, np.maximum(stored_kwh, self.most_kwh))
        if missing <= 0.0:
            return after
        enough = stored_kwh - missing * self.per_discharged >= self.least_kwh[t] - SOLVED
        return np.where(enough, after, -np.inf)

    def carries(self, demand_kw: Floats) -> bool:
        """Whether it carries a demand in all steps, (W,)."""
        stored_kwh = np.array([self.stored_kwh])
        for t, kw in enumerate(demand_kw):
            stored_kwh = self.after(t, stored_kwh, float(kw))
        return bool(np.isfinite(stored_kwh[0]))


def everyone_in_reach(site: Site, data: WindowData) -> bool:
    """Whether one battery with the best of all efficiencies could carry all demand.

    What it cannot carry, no fleet can, network or not; what it can, the fleet may be unable to.
    """
    return OneBattery.of(site, data).carries(data.load_kw.sum(axis=1))
