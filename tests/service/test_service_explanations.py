"""Why the devices of a step do what they do, over HTTP: as a finished run is explained."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import threading
import time as machine
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pytest

from tests.support.live_service import (
    HERE,
    NOON,
    client,
    decided,
    heard,
    readings,
    running,
    site,
    told,
)
from tests.support.long_days import repeated
from vppres.day.options import RunOptions
from vppres.day.recorder import ROTATED
from vppres.day.simulate import run_day
from vppres.explain.day import explain_day
from vppres.scenario.scenario import Scenario
from vppres.service.access import Denied
from vppres.service.clock import written
from vppres.service.http.serve import opened
from vppres.service.operation.loop import Loop
from vppres.service.operation.site import Service
from vppres.service.replay import explainer
from vppres.service.replay.explanations import KINDS, explained, question
from vppres.service.replay.export import exported


@pytest.mark.nightly
@pytest.mark.parametrize(("outages", "rotation"), [
    ("known", 0.0),
    ("known", 0.5),
    pytest.param("belief", 0.0, marks=pytest.mark.nightly),
    pytest.param("belief", 0.5, marks=pytest.mark.nightly),
])  # fmt: skip
def test_every_step_is_explained_as_the_run_is(
    tiny: Scenario, tmp_path: Path, outages: Literal["known", "belief"], rotation: float
) -> None:
    """After a restart, with nothing remembered but what is stored; weights are the plan's."""
    if rotation:  # where there is one customer a tier, nothing rotates
        tiny = replace(tiny, customers=replace(tiny.customers, tier=np.full(3, "low")))
        tiny = replace(tiny, tiers=("low",))
    day = repeated(tiny, 24, "2025-07-01T00:00Z")
    options = RunOptions(
        horizon_h=2.0, isolate=False, outages=outages, rotation=rotation, turn_h=1.0
    )
    run = explain_day(run_day(day, options))
    assert run.explanations is not None and run.shadow_prices is not None
    off = 0
    with client(Service(day, options, rehearsal=True), tmp_path) as http:
        for t, time in enumerate(day.grid.times):
            sent = told(run, t)
            sent["series"] += readings(time, "grid_on", {"grid": float(not day.outage[t])})
            http.post("/v1/telemetry", sent)
            assert http.post("/v1/steps", {"time": written(time)}).status == 200
    with opened(Service(day, options, rehearsal=True), tmp_path) as runner:
        for time in day.grid.times:
            plan = runner.store.step(time)
            assert plan
            found = explained(question(runner, plan))
            rows = run.explanations[run.explanations["time"] == time]
            assert found["step"]["words"] == rows.iloc[0]["words"], time
            if outages == "known":  # else the run's phases know what the service does not
                assert found["phase"] == rows.iloc[0]["phase"], time
            said = [
                (o["kind"], o["asset"], o["action"], o["driver"], o["binding"], o["words"])
                for o in found["reasons"]
            ]
            columns = ["id", "action", "driver", "binding", "words"]
            assert said == [
                (KINDS[row["item"]], *row[columns]) for _, row in rows.iloc[1:].iterrows()
            ], time
            off += sum(one[2] == "not_served" for one in said)
            prices = run.shadow_prices
            prices = prices[(prices["time"] == time) & (prices["constraint"] == "stored_energy")]
            shown = [one["weighted_h"] for one in found["price"] or []]
            assert np.allclose(
                np.array(shown, dtype=float), prices["weighted_h"].to_numpy(float),
                rtol=1e-3, atol=1e-5, equal_nan=True,
            ), time  # fmt: skip
    assert off > 3
    if rotation:
        weight = run.customers.groupby("id")[ROTATED].nunique()
        assert weight.max() > 1


def off_and_explained(
    plan: dict[str, Any], found: dict[str, Any], words: str = "Not supplied: "
) -> list[str]:
    """Customers that a plan leaves off, of each of which it is explained why."""
    off = [one["asset"] for one in plan["setpoints"] if one.get("served") is False]
    told = [one for one in found["reasons"] if one["action"] == "not_served"]
    assert [one["asset"] for one in told] == off and off
    assert all(one["words"].startswith(words) for one in told)
    return off


@pytest.fixture
def stormy(tiny: Scenario, tmp_path: Path) -> Any:
    """A service in an outage with little in store: runner, client and plan."""
    with running(tiny, tmp_path) as (http, clock, runner):
        event = {"type": "outage", "start": written(NOON), "end": "2026-11-21T20:00:00Z"}
        assert http.put("/v1/events/storm", event).status == 201
        yield runner, http, decided(http, clock, NOON, soc=0.25)


def test_a_plan_of_the_second_half_of_a_step_is_explained_as_it_is(
    tiny: Scenario, tmp_path: Path
) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON, soc=0.25)
        lost = NOON + pd.Timedelta("40min")
        clock.set(lost)
        http.post("/v1/telemetry", {"series": readings(lost, "grid_on", {"grid": 0.0})})
        plan = runner.anew()
        assert plan
        found = explained(question(runner, plan))
        service = Service(site(tiny), HERE)
        run = exported(service, runner.store, NOON, NOON + pd.Timedelta("1h"))
    off = off_and_explained(plan, found)
    assert [*run.customers.loc[~run.customers["served"].astype(bool), "id"]] == off


@pytest.mark.daily
def test_the_last_step_is_explained_once(stormy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    runner, http, plan = stormy
    answer = http.get("/v1/explanations")
    found = answer.json()
    assert answer.status == 200 and found["plan"] == plan["id"] and found["phase"] == "island"
    off = off_and_explained(plan, found)
    assert {one["asset"] for one in found["price"]} == {"big", "small"}
    assert max(one["weighted_h"] for one in found["price"]) > 0.0
    assert {k: v for k, v in found.items() if k in ("phase", "step", "reasons", "price")} == {
        k: v for k, v in explained(question(runner, plan)).items() if k != "price_reason"
    }
    monkeypatch.setattr(explainer, "_asked", None)  # it is kept: nothing is solved again
    tag = answer.headers["etag"]
    assert http.get("/v1/explanations", if_none_match=tag).status == 304
    same = http.get("/v1/explanations?at=2026-11-21T12:59:59Z")
    assert same.json() == found
    name = off[0]
    one = http.get(f"/v1/explanations?asset={name}").json()
    assert [each["asset"] for each in one["reasons"]] == [name]
    assert [each["asset"] for each in http.get("/v1/explanations?asset=big").json()["price"]] == [
        "big"
    ]


def test_a_plan_that_leaves_a_customer_off_is_explained_before_anybody_asks(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()

    def explained_here(asked: bytes) -> subprocess.CompletedProcess[bytes]:
        begun.set()
        return subprocess.CompletedProcess(
            [], 0, json.dumps(explained(pickle.loads(asked))).encode()
        )

    monkeypatch.setattr(explainer, "_asked", explained_here)
    with running(tiny, tmp_path) as (http, _, runner):
        event = {"type": "outage", "start": written(NOON), "end": "2026-11-21T20:00:00Z"}
        http.put("/v1/events/storm", event)
        http.post("/v1/telemetry", heard(NOON, 0.25))
        loop = Loop(runner)
        loop.start()
        try:
            assert begun.wait(30.0)
        finally:
            loop.end()
        monkeypatch.setattr(explainer, "_asked", None)  # who asks now starts nothing
        while (answer := http.get("/v1/explanations")).status == 429:  # it is being made
            machine.sleep(0.02)
        assert runner.last
        found = answer.json()
    off_and_explained(runner.last, found)
    assert found["price_reason"] is None and found["plan"] == runner.last["id"]


def test_who_takes_too_long_is_ended_and_one_is_made_at_a_time(
    stormy: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner, http, plan = stormy
    busy = explainer.Explainer(runner)
    busy._turn.acquire()
    with pytest.raises(Denied, match="Ask again"):
        busy.of(plan)
    monkeypatch.setattr(explainer, "WITHIN_S", 0.05)
    found = http.get("/v1/explanations").json()
    assert found["price"] is None and found["price_reason"] == explainer.LATE
    off_and_explained(plan, found, "plan")
    assert {one["words"] for one in found["reasons"]} == {"plan"}
    monkeypatch.setattr(
        explainer, "command", lambda *_: [sys.executable, "-c", "raise SystemExit(3)"]
    )
    monkeypatch.setattr(explainer, "WITHIN_S", 30.0)
    assert explainer.Explainer(runner).of(plan)["price_reason"] == explainer.FAILED
