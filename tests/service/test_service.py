"""The service over HTTP: the same decisions, kept, taken up again, and refused where they must be."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import sqlalchemy as sa

import vppres
from tests.support.live_service import (
    HERE,
    NOON,
    Live,
    client,
    decided,
    heard,
    said,
    site,
    told,
)
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock, written
from vppres.service.http.serve import opened
from vppres.service.operation.loop import Loop
from vppres.service.operation.site import Service
from vppres.service.plans.document import tables_of
from vppres.service.plans.gate import refusals
from vppres.service.storage.store import Store


@pytest.mark.daily
def test_the_packaged_day_over_http_is_the_run(tmp_path: Path) -> None:
    """To the last bit, from 10:00 to 15:00; it is ended and begun again before the outage."""
    day = vppres.load_scenario("uk-heatwave-2022").between(10, 15)
    options = RunOptions(horizon_h=1.0, isolate=False)
    run = vppres.run_day(day, options)
    plans: list[dict[str, Any]] = []
    for part in (range(2), range(2, 5)):
        with client(Service(day, options, rehearsal=True), tmp_path) as http:
            for t in part:
                assert http.post("/v1/telemetry", told(run, t)).status == 200
                answer = http.post("/v1/steps", {"time": written(day.grid.times[t])})
                plans.append(answer.json())
    for t, plan in enumerate(plans):
        time = day.grid.times[t]
        customers = run.customers[run.customers["time"] == time]
        batteries = run.batteries[run.batteries["time"] == time]
        assert plan["status"] == "ok" and not plan["estimated"] and not plan["late"], t
        on = said(plan, "customers")
        assert [on[c]["served"] for c in customers["id"]] == customers["served"].tolist()
        net_kw = (batteries["charge_kw"] - batteries["discharge_kw"]).tolist()
        points = said(plan, "batteries")
        assert [points[b]["p_kw"] for b in batteries["id"]] == net_kw
        assert [points[b]["q_kvar"] for b in batteries["id"]] == batteries["q_kvar"].tolist()
        assert plan["expected"]["import_kw"] == run.steps["p_grid_kw"][t]
        assert plan["solve"]["bound"] == run.steps["bound"][t]


def test_it_rolls_over_midnight_and_notes_what_it_missed(tiny: Scenario, live: Live) -> None:
    http, clock = live
    before_midnight = NOON + pd.Timedelta("11h")
    plans = [
        decided(http, clock, time)
        for time in (before_midnight, *pd.date_range("2026-11-22T02:00Z", periods=2, freq="1h"))
    ]
    assert [plan["status"] for plan in plans] == ["ok"] * 3
    assert http.get("/v1/status").json()["steps"] == {
        "ok": 3, "fallback": 0, "hold": 0, "manual": 0, "failed": 0, "off": 0, "missed": 2,
    }  # fmt: skip
    # The same as a controller in Python that knows what the clock says of these hours.
    day = site(tiny)
    grid = TimeGrid(before_midnight, 60.0, 8)
    rows = (23 + np.arange(8)) % 24
    known = replace(day, grid=grid, **{k: v[rows] for k, v in day.series.items()})
    controller = Controller.of(known, HERE)
    for t, plan in zip((0, 3, 4), plans, strict=True):
        decision = controller.step(Measurement(grid.times[t], {"big": 0.5, "small": 0.5}))
        points = said(plan, "batteries")
        assert [points[b]["p_kw"] for b in day.batteries.id] == decision.batteries["p_kw"].tolist()


def test_a_step_is_decided_once_whoever_asks_and_however_often(
    tiny: Scenario, tmp_path: Path
) -> None:
    clock = SetClock(NOON)
    with client(Service(site(tiny), HERE), tmp_path, clock) as http:
        first = decided(http, clock, NOON)
        clock.set(NOON + pd.Timedelta("40min"))
        assert http.post("/v1/steps").json() == first
        with pytest.raises(InputError, match="is in use: another process serves from it"):
            Store(tmp_path, "site")
    with client(Service(site(tiny), HERE), tmp_path, clock) as http:
        assert http.post("/v1/steps", {"time": written(NOON)}).json() == first
        assert http.get("/v1/plan").json() == first
        late = http.post("/v1/steps", {"time": "2026-11-21T11:00:00Z"})
        assert (late.status, late.json()["problems"][0]["message"]) == (
            422, "is over, and was not decided",
        )  # fmt: skip
        early = http.post("/v1/steps", {"time": "2026-11-21T13:00:00Z"}).json()
        assert early["detail"].startswith("step, time = 2026-11-21T13:00:00Z: is not the present")
    other = replace(site(tiny), batteries=replace(tiny.batteries, energy_kwh=[50.0, 60.0]))
    with (
        pytest.raises(InputError, match="holds the state of another site"),
        client(Service(other, HERE), tmp_path, clock),
    ):
        pass


def test_a_step_that_cannot_be_kept_is_not_decided(
    tiny: Scenario, live: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is decided again as if nothing had been, and what was said before still holds."""
    http, clock = live
    decided(http, clock, NOON)
    later = NOON + pd.Timedelta("1h")
    with monkeypatch.context() as broken:

        def full(*_: Any, **__: Any) -> None:
            raise sa.exc.OperationalError("insert", {}, Exception("database or disk is full"))

        broken.setattr("vppres.service.storage.steps.put", full)
        clock.set(later)
        answer = http.post("/v1/steps")
        assert answer.status == 503 and "disk is full" in answer.json()["detail"]
        assert http.get("/v1/plan").json()["start"] == written(NOON)
        assert http.get("/readyz").json()["checks"]["database"] is False
    plan = decided(http, clock, later)
    undisturbed = SetClock(NOON)
    with client(Service(site(tiny), HERE), tmp_path / "other", undisturbed) as other:
        decided(other, undisturbed, NOON)
        assert decided(other, undisturbed, later)["setpoints"] == plan["setpoints"]


def test_set_points_end_and_leave_the_default(live: Live) -> None:
    http, clock = live
    assert http.get("/v1/setpoints").json()["setpoints"] == []
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T13:00:00Z"})
    plan = decided(http, clock, NOON, soc=0.2)
    now = http.get("/v1/setpoints?asset=big").json()["setpoints"][0]
    assert now == {**said(plan, "batteries")["big"], "active": True, "status": "new"}
    assert now["valid_until"] == "2026-11-21T13:06:00Z" and now["p_kw"] != 0.0
    over = http.get("/v1/setpoints?asset=big&at=2026-11-21T13:06:00Z").json()["setpoints"][0]
    assert (over["active"], over["p_kw"], over["q_kvar"]) == (False, 0.0, 0.0)
    assert http.get("/v1/setpoints?at=noon").json()["problems"][0]["message"].startswith("is not a")


def test_the_gate_lets_nothing_pass_that_a_device_cannot_do(tiny: Scenario) -> None:
    controller = Controller.of(tiny, HERE)
    good = controller.step(Measurement(tiny.grid.times[0], {"big": 0.5, "small": 0.5}))
    tables = tables_of(good, tiny)
    assert refusals(tables, tiny, {"big": 0.5, "small": 0.5}) == {}

    def refused(soc: dict[str, float], table: str, **values: Any) -> dict[Any, str]:
        frame = tables[table].copy()
        for column, (name, value) in values.items():
            frame.loc[name, column] = value
        return refusals({**tables, table: frame}, tiny, soc)

    half = {"big": 0.5, "small": 0.5}
    battery = ("batteries", "big")  # 50 kW, 60 kVA, 100 kWh, 0.15 to 0.85, 0.95 each way
    assert refused(half, "batteries", p_kw=("big", 51.0)) == {battery: "power above its rating"}
    assert refused(half, "batteries", p_kw=("big", 30.0), q_kvar=("big", 53.0)) == {
        battery: "apparent power above its rating"
    }
    # 30 kW for an hour store 28.5 kWh: 0.565 + 0.285 is just full, 0.57 is more.
    assert refused({"big": 0.565}, "batteries", p_kw=("big", 30.0)) == {}
    assert refused({"big": 0.57}, "batteries", p_kw=("big", 30.0)) == {
        battery: "energy above its upper limit"
    }
    # 19 kW for an hour take 20 kWh.
    assert refused({"big": 0.35}, "batteries", p_kw=("big", -19.0)) == {}
    assert refused({"big": 0.34}, "batteries", p_kw=("big", -19.0)) == {
        battery: "energy below its lower limit"
    }
    assert refused(half, "batteries", p_kw=("big", np.nan)) == {battery: "no number"}
    assert refused(half, "pv", p_kw=("roof", 21.0)) == {
        ("pv", "roof"): "power above the available power"
    }
    assert refused(half, "pv", p_kw=("roof", -1.0)) == {("pv", "roof"): "negative power"}


def test_what_the_gate_refuses_becomes_the_default(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    http, clock = live
    monkeypatch.setattr(
        "vppres.service.operation.deciding.refusals", lambda *_: {("batteries", "big"): "no number"}
    )
    big = said(decided(http, clock, NOON), "batteries")["big"]
    assert (big["p_kw"], big["q_kvar"], big["reason"]) == (0.0, 0.0, "default: no number")


def test_tokens_open_their_scopes_and_nothing_else(tiny: Scenario, tmp_path: Path) -> None:
    secret, token = new_token("scada:telemetry")
    reader, reads = new_token("panel:read")
    assert secret not in token.sha256 and len(secret) > 40
    clock = SetClock(NOON)
    with client(Service(site(tiny), HERE), tmp_path, clock, Access([token, reads])) as http:
        sent = {"authorization": f"Bearer {secret}"}
        read = {"authorization": f"Bearer {reader}"}
        assert http.get("/livez").status == 200
        assert http.post("/v1/telemetry", heard(NOON)).status == 401
        assert http.get("/v1/plan", authorization="Bearer wrong").status == 401
        assert http.get("/v1/plan", authorization=f"Basic {reader}").status == 401
        assert http.post("/v1/telemetry", heard(NOON), **read).status == 403
        assert http.post("/v1/telemetry", heard(NOON), **sent).status == 200
        assert http.get("/v1/plan", **read).status == 200
        denied = http.post("/v1/steps", **sent)
        assert (denied.status, denied.headers["content-type"]) == (403, "application/problem+json")
        assert denied.json()["detail"] == "The token of scada has no scope operator."
        assert http.get("/v1/status", **read).json()["step"] is None  # nothing was decided
    with pytest.raises(InputError, match=r"add-token = x:all: is not a name with scopes"):
        new_token("x:all")


HOSTILE = [
    ("POST", "/v1/telemetry", b"{"),
    ("POST", "/v1/telemetry", b'{"series": [], "more": 1}'),
    ("POST", "/v1/telemetry", b"\xff\xfe"),
    ("POST", "/v1/telemetry", b'{"series": NaN}'),
    ("POST", "/v1/telemetry", b"[" * 5000),
    ("POST", "/v1/steps", b'{"time": "tomorrow"}'),
    ("POST", "/v1/steps", b'{"time": "0001-01-01T00:00:00Z"}'),
    ("POST", "/v1/steps", b'{"time": "2026-11-21T12:00:00"}'),
    ("PUT", "/v1/events/x", b'{"type": "outage_belief", "probability": 0.5}'),
    ("PUT", "/v1/events/x", b'{"type": "outage", "start": 5}'),
    ("PUT", "/v1/events/%00", b'{"type": "outage", "start": "2026-11-21T12:00:00Z"}'),
    ("PUT", "/v1/mode", b'{"mode": "manual"}'),
    ("PUT", "/v1/forecasts/soc", b"{}"),
    ("GET", "/v1/setpoints?at=9999-99-99", None),
    ("GET", "/../../etc/passwd", None),
    ("DELETE", "/v1/plan", None),
]


@pytest.mark.daily
def test_hostile_requests_get_a_problem_and_change_nothing(live: Live) -> None:
    http, _ = live
    for method, path, body in HOSTILE:
        answer = http.ask(method, path, body, {})
        assert 400 <= answer.status < 500, (path, body, answer)
        assert answer.headers["content-type"] == "application/problem+json", path
        assert answer.json()["detail"], path
        assert "Traceback" not in answer.content.decode()
    numbers = b'{"series": [{"source": "s", "asset": "big", "quantity": "soc", "start": '
    numbers += b'"2026-11-21T12:00:00Z", "resolution": "PT1H", "values": [%s]}]}'
    for value in (b"NaN", b"Infinity", b'"0.5"', b"true", b"1e999"):
        assert http.ask("POST", "/v1/telemetry", numbers % value, {}).status == 422, value
    large = http.ask("POST", "/v1/telemetry", b" " * 9_000_000, {})
    assert (large.status, large.headers["content-type"]) == (413, "application/problem+json")
    assert http.get("/v1/plan", host="evil.example").status == 400
    status = http.get("/v1/status").json()
    assert status["sources"] == {} and status["step"] is None
    assert http.get("/v1/events").json() == {}


def test_a_reading_is_of_one_device(tiny: Scenario) -> None:
    alike = replace(tiny.batteries, id=np.array(["big", str(tiny.customers.id[0])], dtype=object))
    with pytest.raises(InputError, match="two devices, and a reading of online says not whose"):
        Service(site(replace(tiny, batteries=alike)), HERE)


def test_the_interface_is_the_one_that_is_published(live: Live) -> None:
    """``docs/_static/openapi.json``; write it anew where the change is meant."""
    http, _ = live
    published = Path(__file__).parents[2] / "docs" / "_static" / "openapi.json"
    found = http.get("/openapi.json").json()
    assert found.pop("openapi").startswith("3.1")
    known = json.loads(published.read_text(encoding="utf-8"))
    known.pop("openapi")
    found["info"].pop("version")
    known["info"].pop("version")
    assert found == known


def test_the_loop_decides_the_present_step_and_waits_for_the_next(
    tiny: Scenario, tmp_path: Path
) -> None:
    clock = SetClock(NOON + pd.Timedelta("10min"))
    with opened(Service(site(tiny), HERE), tmp_path, clock) as runner:
        assert Loop(runner)._once() == 50 * 60.0
        assert runner.last and runner.last["start"] == written(NOON)


@pytest.mark.nightly
def test_killed_at_random_moments_it_decides_as_if_it_had_not_been(tmp_path: Path) -> None:
    """By SIGKILL, in the middle of whatever it does; and nothing that it answered is lost."""
    root = Path(__file__).parents[2]
    asked = [sys.executable, "-m", "tests.support.killed_service", str(tmp_path), "5", "2", "1"]
    done = subprocess.run(asked, capture_output=True, text=True, check=True, cwd=root)
    found = json.loads(done.stdout)
    assert found["kills"] >= 1 and found["shed"] > 0
    assert (found["different"], found["lost_readings"], found["lost_plans"]) == ([], [], [])
