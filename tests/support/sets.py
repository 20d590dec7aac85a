"""Generating sets with usual figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.scenario.gensets import Gensets


def gensets(count: int = 1, **more: Any) -> Gensets:
    """Sets of 100 kW with the usual line of fuel and 200 l, at bus 2."""
    values: dict[str, Any] = {
        "id": [f"g{i}" for i in range(count)],
        "bus": [2] * count,
        "p_max_kw": 100.0,
        "p_min_kw": 30.0,
        "ramp_up_kw_per_h": np.inf,
        "ramp_down_kw_per_h": np.inf,
        "min_on_h": 0.0,
        "min_off_h": 0.0,
        "on_before_h": -24.0,
        "start_cost_gbp": 0.0,
        "fuel_price_gbp_per_litre": 1.5,
        "litres_per_kwh": 0.246,
        "litres_per_h_idle": 8.415,
        "tank_litres": 200.0,
        "fuel_level_litres": 200.0,
        "only_in_outage": True,
    } | more
    return Gensets(**{k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()})
