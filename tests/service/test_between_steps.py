"""Between two steps: what changes is decided anew at once, for the rest of the step."""

from __future__ import annotations

import json
import threading
import time as machine
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import (
    HERE,
    NOON,
    Running,
    decided,
    heard,
    reading,
    readings,
    running,
    said,
    serving,
    site,
)
from vppres.core.errors import InputError, StorageError
from vppres.kinds.customer.data import SwitchingRules
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.events.announced import check_not_over
from vppres.service.http.serve import opened
from vppres.service.operation.loop import Loop
from vppres.service.operation.site import Service
from vppres.service.payloads import Belief

LATER = NOON + pd.Timedelta("13min")
END = "2026-11-21T13:06:00Z"


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Running]:
    """A service that has decided the step of noon, with grid; it is 12:13."""
    with running(tiny, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON, soc=0.85)
        clock.set(LATER)
        yield http, clock, runner


def grid(on: float, at: pd.Timestamp = LATER) -> dict[str, Any]:
    """The grid's reading."""
    return {"series": readings(at, "grid_on", {"grid": on})}


def test_a_grid_that_is_lost_is_planned_for_at_once(live: Running) -> None:
    http, clock, runner = live
    before = http.get("/v1/plan").json()
    assert runner.anew() is None
    http.post("/v1/telemetry", grid(0.0))
    why = "grid lost at 2026-11-21T12:13:00Z (scada)"
    assert http.get("/v1/plan").json()["unaware_of"] == [why]
    assert http.get("/v1/overview").json()["plan"]["unaware_of"] == [why]
    runner.anew()
    plan = http.get("/v1/plan").json()
    assert plan["grid"] == {"available": False, "known_by": "reading"}
    assert (plan["start"], plan["valid_from"], plan["anew"]) == (
        "2026-11-21T12:00:00Z", "2026-11-21T12:13:00Z", why,
    )  # fmt: skip
    assert "unaware_of" not in plan
    on = said(plan, "customers")
    assert on["hospital"]["served"] and not all(one["served"] for one in on.values())
    now = http.get("/v1/setpoints").json()["setpoints"]
    assert all(one["active"] and one["anew"] == why and one["valid_until"] == END for one in now)
    was = http.get("/v1/setpoints?at=2026-11-21T12:05:00Z").json()["setpoints"]
    assert [one["id"] for one in was] == [one["id"] for one in before["setpoints"]]
    assert http.get("/v1/status").json()["steps"]["ok"] == 1  # a step counts once
    accepted = http.post(f"/v1/setpoints/{was[0]['id']}/status", {"status": "accepted"})
    assert accepted.status == 200
    # And back again.
    clock.set(LATER + pd.Timedelta("20min"))
    http.post("/v1/telemetry", grid(1.0, clock.now()))
    runner.anew()
    light = http.get("/v1/plan").json()
    assert all(one["served"] for one in said(light, "customers").values())
    assert [one["valid_from"] for one in light["before"]] == [
        "2026-11-21T12:00:00Z",
        "2026-11-21T12:13:00Z",
    ]
    assert decided(http, clock, NOON + pd.Timedelta("1h"))["status"] == "ok"


def test_what_was_stored_in_the_step_counts_when_it_is_decided_anew(live: Running) -> None:
    """13 minutes of what was ordered first, then 47 of what was ordered anew."""
    http, clock, runner = live
    first = said(http.get("/v1/plan").json(), "batteries")["big"]["p_kw"]
    http.post("/v1/telemetry", grid(0.0))
    plan = runner.anew()
    assert plan is not None
    second = said(plan, "batteries")["big"]["p_kw"]
    assert first < 0.0 and second < 0.0 and first != second
    clock.set(NOON + pd.Timedelta("1h"))
    silent = runner.step()
    given_kwh = -(first * 13 + second * 47) / 60 / 0.95
    left = 0.85 - given_kwh / 100.0
    assert any(one.startswith(f"soc big {left:.4f} ") for one in silent["estimated"])


def test_a_service_that_comes_back_within_a_step_sees_what_it_missed(
    tiny: Scenario, tmp_path: Path
) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON, soc=0.85)
        clock.set(LATER)
        http.post("/v1/telemetry", grid(0.0))
    clock.set(LATER + pd.Timedelta("2min"))
    with opened(Service(site(tiny), HERE), tmp_path, clock) as runner:
        assert runner.changes.reasons == ()
        runner.hearing.look()
        plan = runner.anew()
        assert plan is not None and not plan["grid"]["available"]
        assert said(plan, "customers")["hospital"]["served"]


def test_the_loop_answers_a_lost_grid_within_seconds(live: Running) -> None:
    http, _, runner = live
    loop = Loop(runner)
    loop.start()
    try:
        machine.sleep(0.2)
        http.post("/v1/telemetry", grid(0.0))
        begin = machine.monotonic()
        while not runner.last or "anew" not in runner.last:
            assert machine.monotonic() < begin + 30.0
            machine.sleep(0.02)
        assert runner.changes.reasons == ()
    finally:
        loop.end()
    assert not loop.is_alive()


def test_the_loop_tries_a_new_plan_again_that_could_not_be_kept(
    live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, runner = live
    done = threading.Event()
    tries = []

    def anew() -> None:
        tries.append(runner.changes.new.is_set())
        runner.changes.new.clear()
        if len(tries) == 1:
            raise StorageError("the disk is full")
        runner.changes.known(runner.changes.noted)
        done.set()

    monkeypatch.setattr(runner, "anew", anew)
    monkeypatch.setattr("vppres.service.operation.loop.RETRY_S", 0.01)
    loop = Loop(runner)
    loop.start()
    runner.changes.note("event storm")
    assert done.wait(20.0)
    loop.end()


def test_a_change_at_the_moment_of_a_plan_is_seen_once_the_clock_goes_on(live: Running) -> None:
    http, _, runner = live
    http.post("/v1/telemetry", grid(0.0))
    assert runner.anew() is not None
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T12:00:00Z"})
    assert runner.anew() is None and not runner.changes.new.is_set()
    runner.set_clock(LATER + pd.Timedelta("1min"))
    assert runner.changes.new.is_set()
    assert runner.anew() is not None


def test_a_step_that_is_not_decided_yet_is_left_to_its_own_plan(live: Running) -> None:
    http, clock, runner = live
    clock.set(NOON + pd.Timedelta("1h"))
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T13:00:00Z"})
    assert runner.anew() is None and runner.changes.reasons == ("event storm",)
    http.post("/v1/telemetry", heard(clock.now()))
    plan = http.post("/v1/steps").json()
    assert not plan["grid"]["available"] and "anew" not in plan
    assert runner.changes.reasons == ()


def test_a_state_of_charge_far_from_the_plan_is_planned_for_at_once(live: Running) -> None:
    """Twice: a jump that the measured power does not explain counts once it is borne out."""
    http, clock, runner = live
    first = said(http.get("/v1/plan").json(), "batteries")["big"]["p_kw"]
    on_its_way = 0.85 - 0.95 * -first * 13 / 60 / 100
    http.post("/v1/telemetry", {"series": readings(LATER, "soc", {"big": on_its_way})})
    assert runner.changes.reasons == ()
    meter = [reading("big", "battery_kw", NOON, first, lasts="PT13M")]
    gauge = readings(LATER, "soc", {"big": 0.3})
    http.post("/v1/telemetry", {"series": meter + gauge})
    assert runner.changes.reasons == ("soc of big is 0.3 (scada)",)
    plan = runner.anew()
    assert plan is not None and plan["estimated"][0].endswith("(jumped)")
    for minutes, reasons in ((14, ("soc of big is 0.3 (scada)",)), (15, ())):
        clock.set(NOON + pd.Timedelta(minutes=minutes))
        gauge = readings(clock.now(), "soc", {"big": 0.3})
        http.post("/v1/telemetry", {"series": gauge})
        assert runner.changes.reasons == reasons
        plan = runner.anew() or plan
    assert plan["expected"]["soc_start"]["big"] == pytest.approx(0.3, abs=0.01)


def test_a_grid_that_may_not_be_drawn_from_is_no_news_with_each_reading(live: Running) -> None:
    http, clock, runner = live
    limit = {"type": "import_limit", "start": written(NOON), "limit_kw": 0.0}
    http.put("/v1/events/limit", limit)
    http.post("/v1/telemetry", grid(1.0))
    plan = runner.anew()
    assert plan is not None and plan["grid"] == {"available": False, "known_by": "limit"}
    clock.set(LATER + pd.Timedelta("1min"))
    http.post("/v1/telemetry", grid(1.0, clock.now()))
    assert runner.changes.reasons == ()


@pytest.mark.parametrize("gateway", ["silent", "says null"])
def test_a_lost_grid_is_not_back_because_nothing_is_heard_of_it(
    live: Running, gateway: str
) -> None:
    """However long that lasts; a reading, or a measured import, brings it back."""
    http, clock, runner = live
    http.post("/v1/telemetry", grid(0.0))
    assert runner.anew() is not None
    for hours in (2, 5, 30):
        time = NOON + pd.Timedelta(hours=hours)
        if gateway == "says null":
            series = readings(time, "grid_on", {"grid": None})
            clock.set(time)
            http.post("/v1/telemetry", {"series": series})
        plan = decided(http, clock, time)
        assert plan["grid"] == {"available": False, "known_by": "last reading"}
    clock.set(time + pd.Timedelta("5min"))
    http.post("/v1/telemetry", grid(1.0, clock.now()))
    plan = runner.anew()
    assert plan is not None and plan["grid"]["available"]


def test_a_battery_that_is_not_connected_stays_out_and_raises_an_alarm(live: Running) -> None:
    """It said so once, and how full it is since; only that it is back counts."""
    http, clock, runner = live
    http.post("/v1/telemetry", {"series": readings(LATER, "online", {"big": 0.0}, lasts="PT1M")})
    plan = decided(http, clock, NOON + pd.Timedelta("3h"))
    assert "battery big is out" in plan["estimated"]
    words = "big did not follow its set-point: reported as not connected."
    assert words in [one["text"] for one in http.get("/v1/alarms").json()["alarms"]]
    http.post("/v1/telemetry", {"series": readings(clock.now(), "online", {"big": 1.0})})
    clock.set(clock.now() + pd.Timedelta("1min"))
    again = runner.anew()
    assert again is not None and "battery big is out" not in again["estimated"]


def test_of_two_prices_the_one_that_was_written_later_counts(live: Running) -> None:
    """Whatever their names are."""
    http, clock, runner = live
    for minutes, name, price in ((0, "b", 0.9), (1, "a", 0.1), (2, "b", 0.8)):
        clock.set(LATER + pd.Timedelta(minutes=minutes))
        hour = {"start": written(NOON), "resolution": "PT1H", "price_gbp_per_kwh": [price]}
        http.put(f"/v1/events/{name}", {"type": "price", **hour})
        clock.set(clock.now() + pd.Timedelta("10s"))
        plan = runner.anew()
        assert plan is not None and plan["expected"]["price_gbp_per_kwh"] == price


def test_the_rest_of_a_step_is_decided_after_a_restart_as_without_one(
    tiny: Scenario, tmp_path: Path
) -> None:
    """Duties and the power flow are those of the beginning of the step."""
    rules = SwitchingRules(min_unserved_h=2.0)
    options = replace(HERE, switching=rules, mode="physical", outages="belief", rotation=1.0)
    service, plans = Service(site(tiny), options), []
    for restarts in (False, True):
        clock, folder = SetClock(NOON - pd.Timedelta("1h")), tmp_path / str(restarts)
        with serving(service, folder, clock) as (http, runner):
            decided(http, clock, clock.now(), soc=0.3)
            clock.set(NOON)
            http.post("/v1/telemetry", grid(0.0, NOON))
            decided(http, clock, NOON, soc=0.3)
            clock.set(LATER)
            if not restarts:
                http.post("/v1/telemetry", grid(1.0))
                plans.append(runner.anew())
        if restarts:
            with serving(service, folder, clock) as (http, runner):
                http.post("/v1/telemetry", grid(1.0))
                plans.append(runner.anew())
    alone, killed = (json.dumps({**plan, "solve": None}, sort_keys=True) for plan in plans)
    assert all(one["served"] for one in said(plans[0], "customers").values())
    assert alone == killed


@pytest.mark.parametrize(("duration", "over"), [
    ({"family": "discrete", "hours": [1.0, 2.0], "probabilities": [0.5, 0.5]}, True),
    ({"family": "discrete", "hours": [1.0, 5.0], "probabilities": [0.5, 0.5]}, False),
    ({"family": "until", "until": "2026-11-21T11:00:00Z"}, True),
    ({"family": "lognormal", "median_h": 1.0, "sigma": 1.0, "max_h": None}, False),
])  # fmt: skip
def test_a_believed_outage_is_over_when_its_longest_is(
    duration: dict[str, Any], over: bool
) -> None:
    onset = {"start": "2026-11-21T08:00Z", "resolution": "PT1H", "probabilities": [0.5, 0.5]}
    body = {"type": "outage_belief", "probability": 0.6, "onset": onset, "duration": duration}
    with pytest.raises(InputError, match="wholly in the past") if over else nullcontext():
        check_not_over(Belief.model_validate(body), NOON)
