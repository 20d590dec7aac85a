"""What devices are left with where nobody decides: with grid their defaults, in an island their state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, client, decided, readings, said, serving
from tests.support.phased_feeder import CIRCUIT, day_of
from tests.support.sites import last_former
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.plans.world import World

HOUR = pd.Timedelta("1h")
LOST = {"type": "outage", "start": written(NOON)}
OFF = {"mode": "off", "reason": "work on the line"}
STATE = ("served", "share", "running", "p_kw", "p_limit_kw", "setpoint_c", "curtailed_kw")
"""Fields of set-points that say how a device is."""


def state(points: Mapping[str, Any]) -> dict[str, Any]:
    """How devices are by their set-points."""
    return {name: {f: v for f, v in one.items() if f in STATE} for name, one in points.items()}


def now(http: Caller, kind: str) -> dict[str, Any]:
    """Set-points of a kind that hold now."""
    points = http.get("/v1/setpoints").json()["setpoints"]
    return {one["asset"]: one for one in points if one["kind"] == kind}


def test_a_service_that_is_gone_in_an_island_leaves_it_as_it_is(tmp_path: Path) -> None:
    """The diesel goes on forming the grid and nobody is reconnected; the plant carries it."""
    clock = SetClock(NOON)
    day = last_former()
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):
        http.put("/v1/events/storm", LOST)
        plan = decided(http, clock, NOON, soc=0.2)
        off = [name for name, one in said(plan, "customers").items() if not one["served"]]
        assert off and said(plan, "gensets")["g0"]["running"]
        clock.set(NOON + 90 * pd.Timedelta("1min"))
        for kind in ("customers", "gensets", "batteries"):
            left, told = now(http, kind), said(plan, kind)
            assert {one["active"] for one in left.values()} == {False}
            assert state(left) == state(told)
        for _ in range(2):  # the alarm waits a minute
            runner.watch.check_alarms()
            clock.set(clock.now() + pd.Timedelta("2min"))
        words = "devices keep their last state, and how long the island lasts is not known."
        alarms = http.get("/v1/alarms").json()["alarms"]
        assert any(one["kind"] == "no_decision" and words in one["text"] for one in alarms)
    dark = replace(day, grid_limit_kw=np.zeros(day.grid.n_steps))
    world = World(dark, HERE)
    before, after = (world.obey(t, moved(plan, t, day)) for t in (0, 1))
    assert after.steps["mode"] == before.steps["mode"] and not after.steps["dark"]
    assert not after.customers["served"][np.isin(day.customers.id, off)].any()
    # Started again, it goes on from there: what was missed left the devices as they were.
    with client(Service(day, HERE), tmp_path, clock) as http:
        later = decided(http, clock, NOON + 3 * HOUR, soc=0.2)
        assert later["expected"]["gensets"]["g0"]["p_before_kw"] > 0.0
        at = f"/v1/setpoints?at={written(NOON + 2 * HOUR)}"
        kept = {one["asset"]: one for one in http.get(at).json()["setpoints"]}
        assert kept["g0"]["running"] and not any(kept[name]["served"] for name in off)


def moved(plan: dict[str, Any], t: int, day: Scenario) -> list[dict[str, Any]]:
    """Set-points of a plan, as if it had been made for a day's first step."""
    begin = day.grid.times[0]
    times = {"valid_from": written(begin), "valid_until": written(begin + 1.1 * HOUR)}
    return [{**one, **times} for one in plan["setpoints"]]


def test_what_the_last_check_stops_in_an_island_stays_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A set goes on, and a battery rests: what it held may be gone."""
    clock = SetClock(NOON)
    with client(Service(last_former(), HERE), tmp_path, clock) as http:
        http.put("/v1/events/storm", LOST)
        first = decided(http, clock, NOON, soc=0.2)
        stopped = {("gensets", "g0"): "no number", ("batteries", "big"): "no number"}
        monkeypatch.setattr("vppres.service.operation.deciding.refusals", lambda *_: stopped)
        plan = decided(http, clock, NOON + HOUR, soc=0.2)
        assert state(said(plan, "gensets")) == state(said(first, "gensets"))
        assert said(plan, "gensets")["g0"]["reason"] == "default: no number"
        assert said(plan, "batteries")["big"]["p_kw"] == 0.0


@pytest.mark.nightly
def test_an_island_by_phase_is_left_as_it_is_too(tmp_path: Path) -> None:
    pytest.importorskip("opendssdirect")
    day = day_of(CIRCUIT, tmp_path)
    start = day.grid.times[17]
    clock = SetClock(start)
    with client(Service(day, replace(HERE, horizon_h=0.0)), tmp_path / "state", clock) as http:
        http.put("/v1/events/storm", {"type": "outage", "start": written(start)})
        soc: dict[str, float | None] = dict.fromkeys(map(str, day.batteries.id), 0.5)
        http.post("/v1/telemetry", {"series": readings(start, "soc", soc)})
        plan = http.post("/v1/steps").json()
        off = [name for name, one in said(plan, "customers").items() if not one["served"]]
        assert off and len(off) < len(day.customers)
        clock.set(start + 2 * day.grid.step)
        left = now(http, "customers")
        assert [name for name, one in left.items() if not one["served"]] == off
