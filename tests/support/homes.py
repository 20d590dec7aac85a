"""Homes that are cooled, of which the temperatures follow by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.small_windows import two_buses
from vppres.scenario.scenario import Scenario
from vppres.scenario.thermal_loads import ThermalLoads


def homes(*customers: str, **more: Any) -> ThermalLoads:
    """Homes of 5 K/kW and 8 kWh/K with a gain of 0.5 kW, cooled by 2 kW with a COP of 3.5."""
    count = len(customers)
    values: dict[str, Any] = {
        "id": [f"h{i}" for i in range(count)],
        "customer": list(customers),
        "heats": False,
        "p_max_kw": 2.0,
        "cop": 3.5,
        "cop_at_c": 35.0,
        "cop_per_c": 0.0,
        "r_c_per_kw": 5.0,
        "c_kwh_per_c": 8.0,
        "t_min_c": 20.0,
        "t_max_c": 26.0,
        "t_initial_c": 24.0,
        "gain_kw": 0.5,
        "around_c": np.nan,
    } | more
    return ThermalLoads(**{k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()})


def hot(limits_kw: list[float], load_kw: float = 1.0, **more: Any) -> Scenario:
    """One customer with such a home at 34 °C outside."""
    steps = len(limits_kw)
    day = two_buses([[load_kw]] * steps, [1.0], limits_kw)
    return replace(day, temperature_c=np.full(steps, 34.0), thermal_loads=homes("c0", **more))
