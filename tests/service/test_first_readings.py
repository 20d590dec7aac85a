"""What is heard for the first time is planned for when it comes, whatever it is of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.live_service import HERE, NOON, readings, serving, site
from tests.support.played_service import crowded
from vppres.kinds.vehicles import Sessions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service

LEAVES = (NOON + pd.Timedelta("3h")).timestamp()
FIRST: dict[tuple[str, str], float] = {
    ("soc", "big"): 0.71,
    ("soc", "small"): 0.33,
    ("load_kw", "hospital"): 31.0,
    ("load_kw", "shop"): 22.0,
    ("pv_kw", "roof"): 7.5,
    ("grid_on", "grid"): 0.0,
    ("plugged", "k0"): 1.0,
    ("energy_needed_kwh", "k0"): 9.0,
    ("departure", "k0"): LEAVES,
    ("indoor_c", "h0"): 24.7,
    ("fuel_litres", "g0"): 83.0,
    ("running", "g0"): 1.0,
    ("start_fault", "g0"): 1.0,
    ("online", "shop"): 0.0,
}


def everything(tiny: Scenario) -> Scenario:
    """Batteries, PV, a set, a room and a charger of which no session is known."""
    return replace(crowded(site(tiny)), sessions=Sessions())


@pytest.fixture
def begun(tiny: Scenario, tmp_path: Path) -> Iterator[tuple[Any, SetClock, Runner]]:
    """A service that has decided its first step, of which it has heard nothing."""
    clock = SetClock(NOON)
    with serving(Service(everything(tiny), HERE), tmp_path, clock) as (http, runner):
        assert runner.step()["status"] == "ok"
        yield http, clock, runner


def planned_with(runner: Runner, quantity: str, asset: str) -> Any:
    """What the last plan took a quantity for."""
    assert runner.last
    measured = getattr(
        runner.deciding.expected[runner.last["id"]],
        {"online": "connected"}.get(quantity, quantity),
        None,
    )
    if quantity == "grid_on":
        return float(runner.last["grid"]["available"])
    if isinstance(measured, pd.DataFrame):
        return measured[asset].iloc[0]
    value = (measured or {}).get(asset)
    return value.timestamp() if isinstance(value, pd.Timestamp) else value


@pytest.mark.parametrize("seed", range(40))
def test_a_first_reading_is_planned_for_at_once(
    seed: int, begun: tuple[Any, SetClock, Runner]
) -> None:
    """By property: in any order, at any second, alone or beside others, holding for any time."""
    http, clock, runner = begun
    rng = np.random.default_rng([seed, 57])
    order = [list(FIRST)[i] for i in rng.permutation(len(FIRST))][: int(rng.integers(2, 6))]
    at_s = np.sort(rng.choice(np.arange(1, 3500), len(order), replace=False))
    for (quantity, asset), second in zip(order, at_s.tolist(), strict=True):
        clock.set(NOON + pd.Timedelta(seconds=second))
        value = FIRST[quantity, asset]
        sent = readings(clock.now(), quantity, {asset: value})
        sent[0]["resolution"] = str(rng.choice(["PT1S", "PT1M", "PT1H"]))
        assert http.post("/v1/telemetry", {"series": sent}).json()["accepted"] == 1
        assert runner.changes.new.is_set(), (quantity, asset)
        plan = runner.anew()
        assert plan is not None and plan["status"] == "ok", (quantity, asset)
        assert planned_with(runner, quantity, asset) == value, (quantity, asset)
        assert runner.changes.reasons == ()
        # What is said again says nothing new.
        clock.set(clock.now() + pd.Timedelta("1s"))
        again = [{**one, "start": str(clock.now().isoformat())} for one in sent]
        http.post("/v1/telemetry", {"series": again})
        assert runner.anew() is None, (quantity, asset, runner.last)
