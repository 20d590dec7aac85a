"""Whether a fleet could serve everyone, judged by arithmetic before anything is solved."""

from __future__ import annotations

import numpy as np

from vppres.model.data import WindowData
from vppres.model.site import Site

ROUNDING = 1e-9
"""Share of demand that may be missing: rounding of sums."""

LEAST_EFFICIENCY = 0.01
"""Of a fleet without batteries, which has no power either; no battery has less."""


def everyone_in_reach(site: Site, data: WindowData) -> bool:
    """Whether one battery with the best of all efficiencies could carry everyone's demand.

    It charges whenever there is power to spare: more energy never hurts. What it cannot carry, no
    fleet can, network or not; what it can, the fleet may still be unable to.
    """
    b = site.batteries
    power_kw = b.active_max_kw.sum()
    least_kwh = b.energy_kwh @ b.soc_min
    most_kwh = b.energy_kwh @ b.soc_max
    stored_kwh = b.energy_kwh @ data.soc
    per_charged = data.eta_charge.max(initial=LEAST_EFFICIENCY) * site.dt_h
    per_discharged = site.dt_h / data.eta_discharge.max(initial=LEAST_EFFICIENCY)
    demand_kw = data.load_kw.sum(axis=1) + data.network_kw
    spare_kw = data.pv_kw.sum(axis=1) + np.maximum(data.grid_limit_kw, 0.0) - demand_kw
    for spare, demand in zip(spare_kw, demand_kw, strict=True):
        missing = -spare - ROUNDING * abs(demand)
        if missing > power_kw or missing * per_discharged > stored_kwh - least_kwh + ROUNDING:
            return False
        flow_kwh = min(spare, power_kw) * (per_charged if spare > 0.0 else per_discharged)
        stored_kwh = min(stored_kwh + flow_kwh, max(stored_kwh, most_kwh))
    return True
