"""What devices answer, what an operator orders, and steps that nobody waits for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
import pandas as pd

from tests.support.browser import listening
from tests.support.live_service import (
    HERE,
    NOON,
    Live,
    decided,
    heard,
    said,
    serving,
    site,
)
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access
from vppres.service.clock import SetClock, written
from vppres.service.http.app import make_app
from vppres.service.http.client import Client
from vppres.service.operation.site import Service

HOUR = pd.Timedelta("1h")


def test_only_set_points_that_there_are_can_be_answered(live: Live) -> None:
    http, clock = live
    plan = decided(http, clock, NOON)
    name = said(plan, "customers")["shop"]["id"]
    assert http.post(f"/v1/setpoints/{name}/status", {"status": "succeeded"}).status == 200
    assert http.post(f"/v1/setpoints/{name}/status", {"status": "done"}).status == 422
    for other in (name.replace("shop", "shp"), name.replace("T12", "T11"), "..", "x/y/z"):
        assert http.post(f"/v1/setpoints/{other}/status", {"status": "started"}).status == 404


def test_names_need_no_encoding_by_hand(tiny: Scenario, tmp_path: Path) -> None:
    """The identifier of a set-point is written in an address as it is, or encoded once more."""
    odd = "Küche 2/50% #1?"
    named = replace(tiny, batteries=replace(tiny.batteries, id=np.array([odd, "small"], object)))
    with serving(Service(site(named), HERE), tmp_path, SetClock(NOON)) as (http, runner):
        point = said(runner.step(), "batteries")[odd]
        assert point["id"].isascii() and not set(point["id"]) & set(" #?")
        with listening(make_app(runner, Access())) as address:
            client = Client(address)
            for name in (point["id"], quote(point["id"], safe=""), quote(unquote(point["id"]))):
                answer = client.ask("POST", f"/v1/setpoints/{name}/status", {"status": "started"})
                assert answer.status == 200 and answer.body["id"] == point["id"], name
            client.close()
        assert runner.store.acks([point["id"]])[point["id"]]["status"] == "started"
        storm = {"type": "outage", "start": "2026-11-21T13:00:00Z"}
        assert http.put("/v1/events/north/storm 1", storm).status == 201
        assert http.put("/v1/events/north%2Fstorm%201", storm).status == 200
        assert [*http.get("/v1/events").json()] == ["north/storm 1"]
        assert len(http.get("/v1/events/north/storm%201/versions").json()) == 2
        assert http.delete("/v1/events/north/storm%201").status == 200


def test_set_points_are_held_until_the_end_of_hold(live: Live) -> None:
    http, clock = live
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T13:00:00Z"})
    first = decided(http, clock, NOON, soc=0.3)
    assert "must have an end" in http.put("/v1/mode", {"mode": "hold"}).json()["detail"]
    hold = {"mode": "hold", "until": "2026-11-21T13:30:00Z", "reason": "a look at it"}
    assert http.put("/v1/mode", hold).json()["mode"] == "hold"
    held = decided(http, clock, NOON + HOUR, soc=0.3)
    assert held["status"] == "hold" and held["start"] == "2026-11-21T13:00:00Z"
    for kind in ("batteries", "pv", "customers"):
        before, after = said(first, kind), said(held, kind)
        for asset, one in before.items():
            values = {"p_kw", "q_kvar", "served"} & set(one)
            assert {v: one[v] for v in values} == {v: after[asset][v] for v in values}
    assert said(held, "batteries")["big"]["reason"] == "a look at it"
    assert decided(http, clock, NOON + 2 * HOUR)["status"] == "ok"
    assert http.get("/v1/status").json()["steps"]["hold"] == 1


def test_a_step_that_nobody_waits_for_is_a_job(live: Live) -> None:
    http, _ = live
    http.post("/v1/telemetry", heard(NOON))
    answer = http.post("/v1/steps", prefer="respond-async")
    assert (answer.status, answer.headers["preference-applied"]) == (202, "respond-async")
    place = answer.headers["location"]
    assert place == f"/v1/jobs/{written(NOON)}"
    plan = http.post("/v1/steps").json()  # waits for its turn
    assert http.get(place).json() == {"id": written(NOON), "status": "finished", "plan": plan}
    assert http.get("/v1/jobs/2026-11-21T11:00:00Z").status == 404
    assert http.get("/v1/jobs/yesterday").status == 404
    late = http.post("/v1/steps", {"time": "2026-11-21T11:00:00Z"}, prefer="respond-async")
    assert late.status == 202
    http.post("/v1/steps")
    failed = http.get(late.headers["location"]).json()
    assert failed["status"] == "failed" and "is over" in failed["reason"]


def test_a_request_that_is_sent_again_means_the_same_step(live: Live) -> None:
    http, clock = live
    http.post("/v1/telemetry", heard(NOON))
    first = http.post("/v1/steps", idempotency_key="k1").json()
    clock.set(NOON + HOUR)
    assert http.post("/v1/steps", idempotency_key="k1").json() == first
    other = http.post("/v1/steps", {"time": "2026-11-21T13:00:00Z"}, idempotency_key="k1")
    assert other.status == 422 and "was used for 2026-11-21T12:00:00Z" in other.json()["detail"]
    assert http.post("/v1/steps", idempotency_key="k2").json()["start"] == "2026-11-21T13:00:00Z"
