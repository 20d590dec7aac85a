"""Homes that are cooled, of which the temperatures follow by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.small_windows import two_buses
from vppres.kinds.cooling import ThermalLoads
from vppres.scenario.scenario import Scenario


def homes(*customers: str, **more: Any) -> ThermalLoads:
    """Homes of 5 K/kW and 8 kWh/K with a gain of 0.5 kW, cooled by 2 kW with a COP of 3.5."""
    count = len(customers)
    values: dict[str, Any] = {
        "id": [f"h{i}" for i in range(count)], "customer": list(customers), "heats": False,
        "p_max_kw": 2.0, "cop": 3.5, "cop_at_c": 35.0, "cop_per_c": 0.0, "r_c_per_kw": 5.0,
        "c_kwh_per_c": 8.0, "t_min_c": 20.0, "t_max_c": 26.0, "t_initial_c": 24.0, "gain_kw": 0.5,
        "around_c": np.nan,
    } | more  # fmt: skip
    return ThermalLoads(**{k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()})


def hot(limits_kw: list[float], load_kw: float = 1.0, **more: Any) -> Scenario:
    """One customer with such a home at 34 °C outside."""
    steps = len(limits_kw)
    day = two_buses([[load_kw]] * steps, [1.0], limits_kw)
    return replace(day, temperature_c=np.full(steps, 34.0), thermal_loads=homes("c0", **more))


def with_random_homes(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """The day with up to seven rooms and tanks, in any weather."""
    count = int(rng.integers(1, 8))
    loads = homes(
        *rng.choice(scenario.customers.id, count),
        heats=rng.random(count) < 0.3,
        p_max_kw=rng.uniform(0.5, 6.0, count),
        r_c_per_kw=rng.uniform(1.0, 20.0, count),
        c_kwh_per_c=rng.uniform(0.2, 15.0, count),
        t_initial_c=rng.uniform(15.0, 35.0, count),
        gain_kw=rng.uniform(-1.0, 1.0, count),
    )
    outside_c = rng.uniform(-5.0, 40.0, scenario.grid.n_steps)
    return replace(scenario, temperature_c=outside_c, thermal_loads=loads)
