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
from vppres.service.clock import SetClock
from vppres.service.events.announced import check_not_over
from vppres.service.operation.loop import Loop
from vppres.service.operation.site import Service
from vppres.service.payloads import Belief

LATER = NOON + pd.Timedelta("13min")


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
