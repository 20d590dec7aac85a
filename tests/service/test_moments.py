"""Vehicles, rooms and sets in a step that is decided anew: what they took since counts."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import HERE, NOON, heard, readings, said, serving, with_units
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

MINUTES = pd.Timedelta(minutes=1)
MOMENTS = (0, 20, 45, 60, 75)
"""Minutes after noon at which the site is decided; a step is an hour."""


def played(tiny: Scenario, folder: Path, told: dict[int, list[Any]], dark: bool) -> list[Any]:
    """Plans of the moments, with what is read at some of them; an event each begins them anew."""
    clock, plans = SetClock(NOON), []
    service = Service(with_units(tiny), replace(HERE, mode="paper"))
    with serving(service, folder, clock) as (http, runner):
        if dark:
            storm = {"type": "outage", "start": NOON.isoformat()}
            assert http.put("/v1/events/storm", storm).status == 201
        assert http.post("/v1/telemetry", heard(NOON, 0.6)).status == 200
        for minutes in MOMENTS:
            clock.set(NOON + minutes * MINUTES)
            if series := told.get(minutes):
                answer = http.post("/v1/telemetry", {"series": series})
                assert answer.status == 200 and not answer.json().get("refused")
            runner.changes.note(f"minute {minutes}")
            plan = runner.step() if minutes % 60 == 0 else runner.anew()
            assert plan is not None and plan["status"] == "ok"
            plans.append(plan)
    return plans


def test_a_vehicle_has_what_it_was_charged_with_since(tiny: Scenario, tmp_path: Path) -> None:
    """0.4 of 60 kWh at noon, and 0.92 of what its charger was told to take."""
    told = {0: readings(NOON, "ev_soc", {"k0": 0.4}, "PT2H")}
    plans = played(tiny, tmp_path, told, dark=False)
    energy_kwh = 24.0
    for begun, minutes, before, plan in zip(MOMENTS, MOMENTS[1:], plans, plans[1:], strict=False):
        energy_kwh += 0.92 * said(before, "chargers")["k0"]["p_kw"] * (minutes - begun) / 60
        found = plan["expected"]["vehicles"]["k0"]["energy_kwh"]
        assert found == pytest.approx(energy_kwh, abs=1e-6)
    assert energy_kwh > 25.0


def test_a_need_that_was_read_holds_once_and_is_met_on(tiny: Scenario, tmp_path: Path) -> None:
    """20 kWh at 12:20, read with a resolution of two hours: what came since is not asked again."""
    told = {20: readings(NOON + 20 * MINUTES, "energy_needed_kwh", {"k0": 20.0}, "PT2H")}
    plans = played(tiny, tmp_path, told, dark=False)[1:]
    left_kwh = 20.0
    for begun, minutes, before, plan in zip(
        MOMENTS[1:], MOMENTS[2:], plans, plans[1:], strict=False
    ):
        left_kwh -= 0.92 * said(before, "chargers")["k0"]["p_kw"] * (minutes - begun) / 60
        van_there = plan["expected"]["vehicles"]["k0"]
        found = van_there["needed_kwh"] - van_there["energy_kwh"]
        assert found == pytest.approx(left_kwh, abs=1e-6)
    assert left_kwh < 19.0


def test_a_reading_of_ten_minutes_ago_is_followed_from_its_time(
    tiny: Scenario, tmp_path: Path
) -> None:
    told = {45: readings(NOON + 35 * MINUTES, "ev_soc", {"k0": 0.5})}
    _, before, plan, *_ = played(tiny, tmp_path, told, dark=False)
    charged_kwh = 0.92 * said(before, "chargers")["k0"]["p_kw"] * 10 / 60
    assert charged_kwh > 0.5
    found = plan["expected"]["vehicles"]["k0"]["energy_kwh"]
    assert found == pytest.approx(30.0 + charged_kwh, abs=1e-6)


def test_a_room_goes_on_from_the_temperature_that_it_has(tiny: Scenario, tmp_path: Path) -> None:
    """Its way to where it rests shrinks by e^(-t/40 h), whatever its machine does."""
    told = {0: readings(NOON, "indoor_c", {"h0": 27.0}, "PT2H")}
    plans = played(tiny, tmp_path, told, dark=False)
    for begun, minutes, before, plan in zip(MOMENTS, MOMENTS[1:], plans, plans[1:], strict=False):
        start, end = (before["expected"][name]["h0"] for name in ("indoor_c", "indoor_end_c"))
        share = math.expm1(-(minutes - begun) / 60 / 40.0) / math.expm1(-1.0 / 40.0)
        assert abs(end - start) > 0.1
        found = plan["expected"]["indoor_c"]["h0"]
        assert found == pytest.approx(start + share * (end - start), abs=1e-6)
        assert not any("frozen" in words for words in plan["estimated"])


def test_a_tank_has_lost_what_its_set_burnt_since(tiny: Scenario, tmp_path: Path) -> None:
    """8.415 l in each hour and 0.246 l for each kWh, of 60 l at noon."""
    told = {0: readings(NOON, "fuel_litres", {"g0": 60.0}, "PT2H")}
    plans = played(tiny, tmp_path, told, dark=True)
    litres = 60.0
    for begun, minutes, before, plan in zip(MOMENTS, MOMENTS[1:], plans, plans[1:], strict=False):
        point = said(before, "gensets")["g0"]
        burnt = (8.415 + 0.246 * point["p_kw"]) * point["running"] * (minutes - begun) / 60
        litres -= burnt
        assert plan["expected"]["gensets"]["g0"]["fuel_litres"] == pytest.approx(litres, abs=1e-6)
    assert litres < 55.0


def test_what_a_charger_says_once_is_not_late(tiny: Scenario, tmp_path: Path) -> None:
    """A vehicle says what it needs and when it leaves as it comes; its silence is no alarm."""
    clock = SetClock(NOON)
    with serving(Service(with_units(tiny), HERE), tmp_path, clock) as (http, runner):
        leaves = (NOON + 540 * MINUTES).timestamp()
        told = {"plugged": 1.0, "energy_needed_kwh": 20.0, "departure": leaves}
        series = [
            one for name, value in told.items() for one in readings(NOON, name, {"k0": value})
        ]
        http.post("/v1/telemetry", {"series": series})
        for hour in range(7):
            now = NOON + 60 * hour * MINUTES
            clock.set(now)
            http.post("/v1/telemetry", heard(now))
            plan = runner.step()
            runner.watch.check_alarms()
        assert plan["late"] == [] and plan["expected"]["vehicles"]["k0"]["needed_kwh"] == 20.0
        assert http.get("/v1/alarms").json()["alarms"] == []


def test_parts_of_a_forecast_that_were_issued_together_all_count(
    tiny: Scenario, tmp_path: Path
) -> None:
    """Two customers in two requests, in another zone, with half hours where steps are hours."""
    clock = SetClock(NOON)
    with serving(Service(with_units(tiny), HERE), tmp_path, clock) as (http, runner):
        issued = {"issued_at": NOON.isoformat(), "start": "2026-11-21T14:00:00+01:00"}
        for name, values in (("shop", [10.0, 30.0]), ("homes", [50.0, 50.0])):
            body = {**issued, "resolution": "PT30M", "assets": {name: {"p50": values}}}
            assert http.put("/v1/forecasts/load_kw", body).status == 200
        http.post("/v1/telemetry", heard(NOON))
        plan = runner.step()
        known = runner.deciding.expected[plan["id"]].load_kw
        assert isinstance(known, pd.DataFrame)
        row = known.loc[NOON + 60 * MINUTES]
        assert (row["shop"], row["homes"]) == (20.0, 50.0)


def test_what_an_operator_orders_counts_too(tiny: Scenario, tmp_path: Path) -> None:
    """Held from 12:20 to 14:00, by hand from 14:15 to 16:00: the van has what it took by then."""
    clock = SetClock(NOON)
    with serving(Service(with_units(tiny), HERE), tmp_path, clock) as (http, runner):

        def asked(minutes: int, **mode: Any) -> Any:
            clock.set(NOON + minutes * MINUTES)
            if mode:
                assert http.put("/v1/mode", mode).status == 200
                return runner.anew()
            assert http.post("/v1/telemetry", heard(clock.now(), 0.6)).status == 200
            return runner.step()

        series = readings(NOON, "ev_soc", {"k0": 0.4}) + readings(NOON, "indoor_c", {"h0": 25.0})
        http.post("/v1/telemetry", {"series": series})
        first_kw = said(asked(0), "chargers")["k0"]["p_kw"]
        asked(20, mode="hold", until="2026-11-21T14:00:00Z")
        asked(60)
        plan = asked(120)
        energy_kwh = 24.0 + 0.92 * 2.0 * first_kw
        assert plan["status"] == "ok" and energy_kwh > 25.0
        found = plan["expected"]["vehicles"]["k0"]["energy_kwh"]
        assert found == pytest.approx(energy_kwh, abs=1e-6)
        then_kw = said(plan, "chargers")["k0"]["p_kw"]
        before_c = plan["expected"]["indoor_end_c"]["h0"]
        points = [
            {"kind": "chargers", "asset": "k0", "p_limit_kw": 2.0},
            {"kind": "thermal_loads", "asset": "h0", "setpoint_c": 22.0},
        ]
        asked(135, mode="manual", until="2026-11-21T16:00:00Z", setpoints=points)
        asked(180)
        plan = asked(240)
        energy_kwh += 0.92 * (0.25 * then_kw + 1.75 * 2.0)
        found = plan["expected"]["vehicles"]["k0"]["energy_kwh"]
        assert found == pytest.approx(energy_kwh, abs=1e-6)
        # At full power in the hour that the operator had: 7 kW of cold, 5 K/kW.
        rests_c = float(runner.scenario.temperature_c[15]) + 5.0 * (0.5 - 7.0)
        cooled_c = rests_c + (before_c - rests_c) * math.exp(-1.0 / 40.0)
        assert plan["expected"]["indoor_c"]["h0"] == pytest.approx(cooled_c, abs=1e-6)
