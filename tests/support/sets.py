"""Generating sets with usual figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.kinds.gensets import Gensets, GensetState
from vppres.kinds.gensets.physics import SetsAhead
from vppres.scenario.scenario import Scenario


def gensets(count: int = 1, **more: Any) -> Gensets:
    """Sets of 100 kW with the usual line of fuel and 200 l, at bus 2."""
    values: dict[str, Any] = {
        "id": [f"g{i}" for i in range(count)], "bus": [2] * count, "p_max_kw": 100.0,
        "p_min_kw": 30.0, "ramp_up_kw_per_h": np.inf, "ramp_down_kw_per_h": np.inf,
        "min_on_h": 0.0, "min_off_h": 0.0, "on_before_h": -24.0, "start_cost_gbp": 0.0,
        "fuel_price_gbp_per_litre": 1.5, "litres_per_kwh": 0.246, "litres_per_h_idle": 8.415,
        "tank_litres": 200.0, "fuel_level_litres": 200.0, "only_in_outage": True,
    } | more  # fmt: skip
    return Gensets(**{k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()})


def ahead(day: Scenario, n_steps: int | None = None) -> SetsAhead:
    """Sets of the first steps of a day."""
    steps = range(n_steps or day.grid.n_steps)
    found = SetsAhead.of(day, steps, GensetState.at_first(day.gensets))
    assert found is not None
    return found


def random_sets(rng: np.random.Generator, scenario: Scenario) -> Gensets:
    """One to three sets of all sorts, full and nearly empty, on and off before."""
    count = int(rng.integers(1, 4))
    p_max_kw = scenario.load_kw.sum(axis=1).max() * rng.uniform(0.1, 0.6, count)
    tank_litres = 0.3 * p_max_kw * rng.uniform(0.5, 8.0, count)
    ramps = np.where(rng.random((2, count)) < 0.5, np.inf, p_max_kw * rng.uniform(0.2, 1.0))
    return gensets(
        count,
        bus=rng.choice(np.array(scenario.network.buses, dtype=object), count),
        p_max_kw=p_max_kw,
        p_min_kw=p_max_kw * rng.choice([0.0, 0.3, 0.5], count),
        ramp_up_kw_per_h=ramps[0],
        ramp_down_kw_per_h=ramps[1],
        min_on_h=rng.choice([0.0, 1.0, 3.0], count),
        min_off_h=rng.choice([0.0, 1.0, 2.0], count),
        on_before_h=rng.choice([-5.0, -1.0, 1.0, 5.0], count),
        start_cost_gbp=rng.choice([0.0, 20.0], count),
        litres_per_h_idle=p_max_kw * rng.choice([0.0, 0.084], count),
        tank_litres=tank_litres,
        fuel_level_litres=tank_litres * rng.uniform(0.2, 1.0, count),
        only_in_outage=rng.random(count) < 0.6,
    )
