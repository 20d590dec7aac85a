"""Whatever is read, from the first step on, the step is decided, and the device in use or named."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.live_service import HERE, NOON, client, readings, said, site
from tests.support.played_service import crowded
from tests.support.tiny_day import tiny_scenario
from vppres import Controller, Measurement, RunOptions, SetPoints
from vppres.live.door import float_of
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

DAY = crowded(site(tiny_scenario()))
"""Batteries, PV, a van, a cooled home and a generating set."""

OPTIONS = RunOptions(horizon_h=1.0, isolate=False)
ASSETS = {
    "soc": ["big", "small"],
    "load_kw": ["hospital", "shop", "homes"],
    "pv_kw": ["roof", "field"],
    "battery_kw": ["big", "small"],
    "plugged": ["k0"],
    "ev_soc": ["k0"],
    "energy_needed_kwh": ["k0"],
    "departure": ["k0"],
    "indoor_c": ["h0"],
    "running": ["g0"],
    "genset_kw": ["g0"],
    "fuel_litres": ["g0"],
    "start_fault": ["g0"],
    "eta_charge": ["big", "small"],
    "eta_discharge": ["big", "small"],
    "import_kw": ["grid"],
}
EDGES = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, 0.15, 0.85, 0.8500001, 2, 30.0, 45.1, 100.0, 200.0, 300.0, 1e6),
    *(1e-12, 5e-324, -1e-9, 1e300, -1e300, 10**400, -(10**400), math.inf, -math.inf, math.nan),
)
HOURS = (-24, 0, 1 / 3, 1, 2, 400 * 24)
"""Of departures, from the step on."""


def drawn(rng: np.random.Generator) -> float:
    """A number: one at an edge, a share, some kilowatts, or of any size."""
    kind = rng.random()
    if kind < 0.5:
        return EDGES[rng.integers(len(EDGES))]
    if kind < 0.75:
        return float(rng.uniform(0.0, 1.0))
    if kind < 0.9:
        return float(rng.uniform(-50.0, 150.0))
    return float(np.exp(rng.uniform(-50.0, 50.0)) * rng.choice([-1.0, 1.0]))


def odd_readings(rng: np.random.Generator, time: pd.Timestamp) -> dict[str, dict[str, Any]]:
    """One to five readings by quantity and asset, beside states of charge."""
    found: dict[str, dict[str, Any]] = {"soc": {"big": 0.5, "small": 0.5}}
    for _ in range(int(rng.integers(1, 6))):
        quantity = list(ASSETS)[rng.integers(len(ASSETS))]
        asset = str(rng.choice(ASSETS[quantity]))
        value: Any = drawn(rng)
        if quantity == "departure":
            value = time + pd.Timedelta(hours=float(rng.choice(HOURS)))
        found.setdefault(quantity, {})[asset] = value
    return found


def of(table: str, column: str) -> Callable[[SetPoints, str], float]:
    """What a decision counts with."""
    return lambda step, name: float(getattr(step, table).loc[name, column])


COUNTED: dict[str, tuple[Callable[[SetPoints, str], float], dict[str, tuple[float, float]]]] = {
    "soc": (of("batteries", "soc"), {"big": (0.15, 0.85), "small": (0.15, 0.85)}),
    "load_kw": (of("customers", "load_kw"), {}),
    "pv_kw": (of("pv", "available_kw"), {"roof": (0.0, 30.0), "field": (0.0, 20.0)}),
    "indoor_c": (of("thermal_loads", "indoor_c"), {}),
    "fuel_litres": (of("gensets", "fuel_litres"), {"g0": (0.0, 200.0)}),
}
"""What shows that a reading is used, and within which limits."""

RECKONED = ("indoor_c", "fuel_litres")
"""What is not named where it was never read."""


def wrong(step: SetPoints, told: dict[str, dict[str, Any]], dark: bool) -> list[str]:
    """What a decision lacks."""
    found = []
    if step.solve["fallback"] != "none":
        found.append(f"{step.solve['fallback']}: {step.solve['fallback_reason']}")
    if not dark and not step.customers["served"].all():
        found.append("customers are off with grid")
    words = step.solve["estimated"]
    for quantity, (counted, limits) in COUNTED.items():
        for asset, value in told.get(quantity, {}).items():
            lowest, highest = limits.get(asset, (-math.inf, math.inf))
            number = float_of(value)
            assert number is not None
            used = counted(step, asset) == pytest.approx(min(max(number, lowest), highest), 1e-6)
            named = asset in words or f"{quantity.removesuffix('_kw')} of all" in words
            if not (used or named or (math.isnan(number) and quantity in RECKONED)):
                found.append(f"{quantity} of {asset} = {value}: {counted(step, asset)}, not named")
    return found


@pytest.mark.parametrize("seed", range(340))
def test_whatever_a_controller_reads_it_decides_and_names_it(seed: int) -> None:
    """By Python: three steps, in half of the days an outage in the second; 3,000 readings in all."""
    rng = np.random.default_rng([seed, 576])
    controller = Controller.of(DAY, OPTIONS)
    begins, outage = int(rng.integers(0, 2)), bool(rng.random() < 0.5)
    for t, time in enumerate(controller.times[:3]):
        told = odd_readings(rng, time) if t >= begins else {"soc": {"big": 0.5, "small": 0.5}}
        dark = outage and t == 1
        import_kw = told.pop("import_kw", {}).get("grid")
        limit_kw = {"grid_limit_kw": 0.0} if dark else {}
        step = controller.step(Measurement(time, **told, import_kw=import_kw, **limit_kw))
        assert wrong(step, told, dark) == [], (t, told, step.solve["estimated"])


@pytest.mark.parametrize("seed", range(40))
def test_whatever_a_service_reads_it_decides_and_names_it(seed: int, tmp_path: Path) -> None:
    """By HTTP: what is no number is refused by name; the step is decided on the rest."""
    rng = np.random.default_rng([seed, 577])
    clock = SetClock(NOON)
    with client(Service(DAY, HERE), tmp_path, clock) as http:
        for hour in range(2):
            time = NOON + hour * pd.Timedelta("1h")
            clock.set(time)
            odd = odd_readings(rng, time)
            leaves = odd.get("departure", {})
            odd["departure"] = {name: one.timestamp() for name, one in leaves.items()}
            odd["grid_on"] = {"grid": 1.0}
            if rng.random() < 0.5:
                odd.setdefault("load_kw", {})["shop"] = rng.choice(["", "unavailable", "40 kW"])
            series = [
                one for quantity, values in odd.items() for one in readings(time, quantity, values)
            ]
            answer = http.post("/v1/telemetry", {"series": series}).json()
            refused = [one["field"] for one in answer["refused"]]
            assert answer["accepted"] + len(refused) == len(series)
            plan = http.post("/v1/steps").json()
            assert plan["status"] == "ok", (odd, plan["reason"])
            assert all(one["served"] for one in said(plan, "customers").values()), odd
            (source,) = http.get("/v1/overview").json()["sources"]
            assert len(source["refused"]) >= len(set(refused))
            for name in ("big", "small"):
                out = f"battery {name} is out" in plan["estimated"]
                assert out <= (f"soc of {name}" in refused), (odd, plan["estimated"])
