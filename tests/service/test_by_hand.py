"""Set-points of an operator are checked for balance and by AC before they hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import NOON, decided, readings, serving, site
from tests.support.vans import van
from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service

HOUR = pd.Timedelta(hours=1)
ISLAND = RunOptions(horizon_h=1.0, isolate=False, mode="physical")
DARK = {"type": "outage", "start": written(NOON), "end": "2026-11-21T13:00:00Z"}


def on(*names: str) -> dict[str, Any]:
    """Manual mode with these customers on."""
    points = [{"kind": "customers", "asset": name, "served": True} for name in names]
    return {"mode": "manual", "until": "2026-11-21T13:00:00Z", "setpoints": points}


def test_what_set_points_lead_to_is_told(tiny: Scenario, tmp_path: Path) -> None:
    """The shop stays off from before; of the homes there is not enough for."""
    day = site(tiny)
    poor = replace(day, pv_kw=0.0 * day.pv_kw)
    with serving(Service(poor, ISLAND), tmp_path, SetClock(NOON)) as (http, runner):
        http.put("/v1/events/storm", DARK)
        plan = decided(http, runner.clock, NOON, soc=0.7)
        off = {one["asset"] for one in plan["setpoints"] if one.get("served") is False}
        assert off == {"homes", "shop"}
        checked = http.post("/v1/mode/check", on("homes")).json()["found"]
        assert "Not supplied all the same: homes." in checked
        assert "Off as before: shop." in checked
        assert any(one.startswith("By the balance of power: ") for one in checked)
        assert http.get("/v1/mode").json()["mode"] == "auto"  # nothing is changed
        assert http.put("/v1/mode", on("homes")).json()["found"] == checked
        one = {"kind": "customers", "asset": "hospital", "served": False}
        less = {**on(), "setpoints": [one, {**one, "asset": "homes", "served": True}]}
        calm = http.post("/v1/mode/check", less).json()["found"]
        assert not any(each.startswith("Not supplied") for each in calm)


def test_set_points_that_black_out_a_lit_island_are_refused(tiny: Scenario, tmp_path: Path) -> None:
    """Lines that do not carry the hospital's power."""
    day = site(tiny)
    network = replace(day.network, r_ohm=1000.0 * day.network.r_ohm)
    far = replace(day, pv_kw=0.0 * day.pv_kw, network=network)
    b = far.batteries
    far = replace(far, batteries=replace(b, bus=[4, 4]))
    with serving(Service(far, ISLAND), tmp_path, SetClock(NOON)) as (http, runner):
        http.put("/v1/events/storm", DARK)
        plan = decided(http, runner.clock, NOON, soc=0.8)
        lit = {one["asset"] for one in plan["setpoints"] if one.get("served")}
        assert lit and "hospital" not in lit
        for method, path in (("PUT", "/v1/mode"), ("POST", "/v1/mode/check")):
            answer = getattr(http, method.lower())(path, on("hospital", "shop"))
            assert answer.status == 422
            assert "would black out the island" in answer.json()["problems"][0]["message"]
        assert http.get("/v1/mode").json()["mode"] == "auto"


@pytest.mark.parametrize("limit_kw", [None, 20.0])
def test_a_limit_of_import_that_is_not_kept_is_told(
    tiny: Scenario, tmp_path: Path, limit_kw: float | None
) -> None:
    with serving(Service(site(tiny), ISLAND), tmp_path, SetClock(NOON)) as (http, runner):
        if limit_kw is not None:
            cap = {"type": "import_limit", "limit_kw": limit_kw}
            http.put("/v1/events/cap", {**cap, "start": written(NOON), "end": DARK["end"]})
        decided(http, runner.clock, NOON, soc=0.5)
        charging = [{"kind": "batteries", "asset": "big", "p_kw": 50.0}]
        body = {**on(), "setpoints": charging}
        found = http.post("/v1/mode/check", body).json()["found"]
    told = any(one.endswith("above its limit of 20 kW.") for one in found)
    assert told == (limit_kw is not None)


@pytest.mark.parametrize("read_soc", [0.3, 0.99])
def test_a_vehicle_is_charged_from_what_is_read_of_it(
    tiny: Scenario, tmp_path: Path, read_soc: float
) -> None:
    """Its session says 18 kWh of 60: there is room for 40 kW, unless it is nearly full by now."""
    day = site(tiny)
    charger, session = van(NOON - HOUR, NOON + 6 * HOUR)
    day = replace(day, chargers=replace(charger, p_charge_kw=[40.0]), sessions=session)
    cap = {"type": "import_limit", "limit_kw": 130.0, "start": written(NOON), "end": DARK["end"]}
    with serving(Service(day, ISLAND), tmp_path, SetClock(NOON)) as (http, runner):
        http.put("/v1/events/cap", cap)
        series = readings(NOON, "ev_soc", {"k0": read_soc})
        assert http.post("/v1/telemetry", {"series": series}).status == 200
        decided(http, runner.clock, NOON, soc=0.5)
        rest = [{"kind": "batteries", "asset": name, "p_kw": 0.0} for name in ("big", "small")]
        body = on("homes", "shop", "hospital")
        body["setpoints"] += [*rest, {"kind": "chargers", "asset": "k0", "p_limit_kw": 40.0}]
        found = http.post("/v1/mode/check", body).json()["found"]
    assert any("above its limit" in one for one in found) == (read_soc < 0.5)
