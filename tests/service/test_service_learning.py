"""A forecaster that learns from what a service is told, and limits that are announced for later."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sqlalchemy as sa

from tests.support.asgi import Caller
from tests.support.live_service import (
    HERE,
    NOON,
    client,
    decided,
    readings,
    running,
    said,
    serving,
    site,
)
from vppres.contract.observation import Observation
from vppres.scenario.history import History
from vppres.scenario.outage_warnings import OutageStatistics
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.store import Store

HOUR = pd.Timedelta("1h")
LEARNING = replace(HERE, forecaster="seasonal")
OTHERS = ("hospital", "homes")
BELIEVING = replace(HERE, outages="belief")


def hour(http: Caller, clock: SetClock, t: int, shop_kw: float = 30.0) -> dict[str, Any]:
    """The plan of a step before which everybody was heard."""
    time = NOON + t * HOUR
    clock.set(time)
    series = readings(time, "load_kw", {**dict.fromkeys(OTHERS, 20.0), "shop": shop_kw})
    series += readings(time, "pv_kw", {"roof": 5.0, "field": 5.0})
    assert http.post("/v1/telemetry", {"series": series}).json()["refused"] == []
    return decided(http, clock, time)


def shop_of(scenario: Scenario) -> int:
    """Place of the shop among the customers."""
    return [str(name) for name in scenario.customers.id].index("shop")


def watch(runner: Runner) -> list[Observation]:
    """What the controller is told from now on."""
    decider = runner.deciding.controller._decider
    seen: list[Observation] = []
    decide = decider.decide

    def noted(observation: Observation) -> Any:
        seen.append(observation)
        return decide(observation)

    decider.decide = noted  # type: ignore[method-assign]
    return seen


def test_measurements_are_kept_as_the_history_that_they_are(tiny: Scenario, tmp_path: Path) -> None:
    """A step in which nothing was read is no row, and not known in what is given back."""
    load_kw = np.array([[1.0, np.nan, 3.0], [np.nan] * 3, [4.0, 5.0, 6.0], [np.nan] * 3])
    pv_kw = np.array([[0.5, np.nan], [np.nan] * 2, [np.nan] * 2, [np.nan] * 2])
    with closing(Store(tmp_path, "site")) as store:
        assert store.measured(NOON, tiny.grid) is None
        store.put_measured(History(NOON, tiny.grid.step_minutes, load_kw, pv_kw))
        for since, first in ((NOON - HOUR, 0), (NOON + tiny.grid.step, 2)):
            found = store.measured(since, tiny.grid)
            assert found is not None
            assert found.start == NOON + first * tiny.grid.step
            assert np.array_equal(found.load_kw, load_kw[first:3], equal_nan=True)
            assert np.array_equal(found.pv_kw, pv_kw[first:3], equal_nan=True)
        assert store.measured(NOON + 3 * tiny.grid.step, tiny.grid) is None


@pytest.mark.nightly
def test_what_is_measured_is_learned_and_taken_up_again(tiny: Scenario, tmp_path: Path) -> None:
    """With a restart on the way as without one, and the saved state does not grow."""
    plans: dict[str, list[Any]] = {}
    sizes = {}
    for name, parts in {"whole": [range(28)], "parts": [range(26), range(26, 28)]}.items():
        plans[name] = []
        for part in parts:
            clock = SetClock(NOON)
            with client(Service(site(tiny), LEARNING), tmp_path / name, clock) as http:
                plans[name] += [hour(http, clock, t, 20.0 + t % 24)["setpoints"] for t in part]
        engine = sa.create_engine(f"sqlite:///{tmp_path / name / 'service.db'}")
        with engine.connect() as db:
            rows = db.exec_driver_sql("SELECT load_kw FROM measured ORDER BY time").scalars().all()
            states = db.exec_driver_sql(
                "SELECT state FROM controller_state ORDER BY time"
            ).scalars()
            sizes[name] = [len(state) for state in states]
        engine.dispose()
        assert [json.loads(row)[shop_of(tiny)] for row in rows] == [
            20.0 + t % 24 for t in range(28)
        ]
    assert plans["whole"] == plans["parts"]
    assert max(sizes["whole"]) < 1.1 * min(sizes["whole"])


@pytest.mark.daily
def test_a_forecaster_that_is_new_learns_from_readings_that_are_kept(
    tiny: Scenario, tmp_path: Path
) -> None:
    """A day with the profile alone; then the shop's 30 kW are what is expected of it."""
    clock = SetClock(NOON)
    with client(Service(site(tiny), HERE), tmp_path, clock) as http:
        for t in range(25):
            hour(http, clock, t)
    with serving(Service(site(tiny), LEARNING), tmp_path, clock) as (http, runner):
        seen = watch(runner)
        hour(http, clock, 25)
        shop = shop_of(tiny)
        assert seen[-1].forecast.load_kw[:, shop] == pytest.approx([30.0] * 3)
        # A forecast that somebody sends goes first.
        eight = {"p10": [7.0] * 48, "p50": [8.0] * 48, "p90": [9.0] * 48}
        body = {"issued_at": written(NOON), "start": written(NOON), "resolution": "PT1H"}
        http.put("/v1/forecasts/load_kw", {**body, "assets": {"shop": eight}})
        hour(http, clock, 26)
        assert seen[-1].forecast.load_kw[:, shop].tolist() == [30.0, 8.0, 8.0]


def test_limits_that_are_announced_reach_plans_with_beliefs(tiny: Scenario, tmp_path: Path) -> None:
    """Of steps ahead the limit that holds then, in place of the one of now; an outage stays one."""
    quiet = replace(site(tiny), outage_statistics=OutageStatistics("none"))
    clock = SetClock(NOON)
    options = replace(BELIEVING, horizon_h=5.0)
    limit = {"type": "import_limit", "start": "2026-11-21T13:00:00Z", "limit_kw": 40.0,
             "end": "2026-11-21T15:00:00Z"}  # fmt: skip
    with serving(Service(quiet, options), tmp_path, clock) as (http, runner):
        seen = watch(runner)
        http.put("/v1/events/cap", limit)
        hour(http, clock, 0)
        assert seen[-1].forecast.grid_limit_kw.tolist() == [np.inf, 40.0, 40.0, *[np.inf] * 3]
        storm = {"type": "outage", "start": "2026-11-21T14:00:00Z", "end": "2026-11-21T16:00:00Z"}
        http.put("/v1/events/storm", storm)
        hour(http, clock, 1)  # now it holds, and ends before the window does
        assert seen[-1].forecast.grid_limit_kw.tolist() == [40.0, 0.0, 0.0, *[np.inf] * 3]


def test_a_rehearsal_knows_of_limits_ahead_what_is_announced(
    tiny: Scenario, tmp_path: Path
) -> None:
    """The outage that comes in the scenario's own days stays unknown."""
    day = replace(site(tiny), outage_statistics=OutageStatistics("none"))
    times = day.grid.times
    limits = np.where(np.arange(24) == 3, 0.0, 90.0)
    day = replace(day, grid_limit_kw=limits)
    options = replace(BELIEVING, horizon_h=5.0)
    with serving(Service(day, options, rehearsal=True), tmp_path) as (http, runner):
        seen = watch(runner)
        for announced, expected in ((False, [90.0] * 6), (True, [90.0, 50.0, 50.0, *[90.0] * 3])):
            if announced:
                body = {"type": "import_limit", "start": written(times[2]), "limit_kw": 50.0}
                http.put("/v1/events/cap", {**body, "end": written(times[4])})
            t = int(announced)
            soc = readings(times[t], "soc", {"big": 0.5, "small": 0.5})
            http.post("/v1/telemetry", {"series": soc})
            assert http.post("/v1/steps", {"time": written(times[t])}).status == 200
            assert seen[-1].forecast.grid_limit_kw.tolist() == expected


def test_who_cannot_be_switched_on_is_left_off_until_it_is_back(
    tiny: Scenario, tmp_path: Path
) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        seen = watch(runner)
        shop = shop_of(tiny)

        def answered(plan: dict[str, Any], status: str) -> None:
            name = said(plan, "customers")["shop"]["id"]
            said_so = {"status": status, "reason": "earth fault"}
            assert http.post(f"/v1/setpoints/{name}/status", said_so).status == 200

        plan = hour(http, clock, 0)
        assert said(plan, "customers")["shop"]["served"] and not plan["lost"]
        answered(plan, "rejected")
        for t in (1, 2):
            plan = hour(http, clock, t)
            point = said(plan, "customers")["shop"]
            assert (point["served"], point["reason"]) == (
                False, "cannot be supplied: rejected: earth fault",
            )  # fmt: skip
            assert plan["lost"] == [{"asset": "shop", "reason": "rejected: earth fault"}]
            assert seen[-1].forecast.load_kw[:, shop].tolist() == [0.0] * 3
            assert plan["status"] == "ok"
            answered(plan, "succeeded")  # it is off, as it was told: that does not bring it back
        assert said(plan, "customers")["homes"]["served"]
        assert hour(http, clock, 3)["lost"]
        now = clock.now()
        http.post("/v1/telemetry", {"series": readings(now, "online", {"shop": 1.0})})
        plan = hour(http, clock, 4)
        assert not plan["lost"] and said(plan, "customers")["shop"]["served"]
        assert seen[-1].forecast.load_kw[0, shop] == 30.0
        # Telemetry alone says so too, however old it is.
        http.post("/v1/telemetry", {"series": readings(clock.now(), "online", {"shop": 0.0})})
        silent = readings(clock.now() + pd.Timedelta("1h"), "online", {"shop": None})
        http.post("/v1/telemetry", {"series": silent})
        assert hour(http, clock, 9)["lost"] == [
            {"asset": "shop", "reason": "reported as not connected"}
        ]
    with client(Service(site(tiny), HERE), tmp_path, clock) as http:
        assert hour(http, clock, 10)["lost"]
