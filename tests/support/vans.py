"""Vehicles at chargers: some that follow by hand, and some that are drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.kinds.vehicles import Chargers, Sessions
from vppres.scenario.scenario import Scenario


def chargers(count: int = 1, **more: Any) -> Chargers:
    """Chargers that stand alone at bus 2: 7.4 kW, efficiency 0.92, one way."""
    values: dict[str, Any] = {
        "id": [f"k{i}" for i in range(count)], "bus": [2] * count, "customer": [""] * count,
        "p_charge_kw": 7.4, "p_charge_min_kw": 0.0, "p_discharge_kw": 0.0, "eta_charge": 0.92,
        "eta_discharge": 0.92,
    } | more  # fmt: skip
    return Chargers(**{k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()})


def sessions(plug_in: list[pd.Timestamp], plug_out: list[pd.Timestamp], **more: Any) -> Sessions:
    """A vehicle of 60 kWh at each charger between these times: 30 %, needs 80 %."""
    count = len(plug_in)
    values: dict[str, Any] = {
        "vehicle": [f"car{i}" for i in range(count)], "capacity_kwh": 60.0, "soc_at_plug_in": 0.3,
        "soc_needed": 0.8, "energy_needed_kwh": np.nan, "v2g_soc_floor": np.nan, "weight": 1.0,
        "announced": True,
    } | more  # fmt: skip
    values = {k: np.broadcast_to(np.asarray(v), count) for k, v in values.items()}
    times = (np.array(each, dtype=object) for each in (plug_in, plug_out))
    return Sessions(**dict(zip(("plug_in", "plug_out"), times, strict=True)), **values)


def plugged_in(day: Scenario, *hours: tuple[float, float], **more: Any) -> Scenario:
    """The day with a vehicle at each charger between these hours."""
    times = [
        [day.grid.start + pd.Timedelta(hours=h) for h in each] for each in zip(*hours, strict=True)
    ]
    named = {"charger": day.chargers.id[: len(hours)], "tier": day.tiers[0]} | more
    return replace(day, sessions=sessions(*times, **named))


def van(plug_in: pd.Timestamp, plug_out: pd.Timestamp) -> tuple[Chargers, Sessions]:
    """A charger at bus 4, and a van that comes unannounced with 18 kWh and needs 54."""
    one = {"charger": "k0", "vehicle": "van", "tier": "low", "weight": 0.02, "announced": False}
    charger = chargers(bus=[4], p_charge_min_kw=1.4)
    return charger, sessions([plug_in], [plug_out], soc_needed=0.9, **one)


def with_random_vehicles(scenario: Scenario, seed: int) -> Scenario:
    """The day with up to five chargers, some two-way and some alone, and a session each."""
    rng = np.random.default_rng([seed, 12])
    count = int(rng.integers(1, 6))
    alone = rng.random(count) < 0.4
    owner = rng.choice(scenario.customers.id, count)
    customer = np.where(alone, "", owner).astype(object)
    bus = np.where(alone, rng.choice(np.array(scenario.network.buses, dtype=object), count), None)
    back_kw = np.where(rng.random(count) < 0.5, rng.uniform(1.0, 11.0, count), 0.0)
    day = replace(
        scenario,
        chargers=chargers(
            count,
            customer=customer,
            bus=bus,
            p_charge_kw=rng.uniform(1.0, 22.0, count),
            p_discharge_kw=back_kw,
        ),
    )
    n_steps = scenario.grid.n_steps
    begin = rng.integers(-2, n_steps, count)
    hours = begin * scenario.grid.dt_h
    ends = (begin + rng.integers(1, n_steps + 4, count)) * scenario.grid.dt_h
    held = rng.uniform(0.1, 0.9, count)
    return plugged_in(
        day,
        *zip(hours, ends, strict=True),
        capacity_kwh=rng.uniform(10.0, 80.0, count),
        soc_at_plug_in=held,
        soc_needed=rng.uniform(held, 1.0),
        v2g_soc_floor=np.where(rng.random(count) < 0.5, rng.uniform(0.0, 1.0, count), np.nan),
        weight=rng.choice([1.0, 2.5, 10.0], count),
    )
