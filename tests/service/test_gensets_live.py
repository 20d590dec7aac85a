"""Generating sets of a live controller and service: starts that fail, gauges, restarts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import HERE, NOON, client, decided, readings, said, serving, site
from tests.support.sets import gensets
from tests.support.small_windows import DARK, OPEN, two_buses
from vppres import (
    Controller,
    Measurement,
    RunOptions,
    SetPoints,
)
from vppres.kinds.gensets.data import Refuels
from vppres.kinds.gensets.physics import Engines
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.replay.export import export

OPTIONS = RunOptions(mode="paper", isolate=False, horizon_h=3.0)
HALF_L, LEAST_L = 20.715, 15.795
"""Litres in an hour at 50 kW, and at the least power of 30 kW."""


def powered(limits_kw: list[float], **more: Any) -> Scenario:
    """A customer of 50 kW beside a set of 100 kW with 200 l."""
    day = two_buses([[50.0]] * len(limits_kw), [1.0], limits_kw, r_ohm=1e-6)
    return replace(day, gensets=gensets(**more))


def only(step: SetPoints) -> pd.Series[Any]:
    """The only set of a decision."""
    assert step.gensets is not None
    return step.gensets.iloc[0]


def test_a_set_that_does_not_start_is_out_until_it_reports_no_fault() -> None:
    """Over a restart too; what always said 0 is no news. A set that runs is not out."""
    day = powered([DARK] * 10)
    controller = Controller.of(day, OPTIONS)
    told: list[dict[str, Any]] = [
        {},
        {"running": {"g0": 0}},
        {"running": {"g0": 0}},
        {"start_fault": {"g0": 0}},
        {"running": {"g0": 1}, "start_fault": {"g0": 1}},
        {"running": {"g0": 0}, "start_fault": {"g0": 1}},
        {"running": {"g0": 0}, "start_fault": {"g0": 0}},
        {"running": {"g0": 0}, "start_fault": {"g0": 0}},
        {"running": {"g0": 0}, "start_fault": {"g0": 0}},
        {"running": {"g0": 1}},
    ]
    stands = "told to run, stands still"
    words = ["", stands, "no start", "", "", "start fault", "", stands, "no start", ""]
    for time, heard, why in zip(day.grid.times, told, words, strict=True):
        state = json.loads(json.dumps(controller.state(), allow_nan=False))
        for go_on in (Controller.of(day, OPTIONS, state=state), controller):
            step = go_on.step(Measurement(time, **heard))
            assert bool(only(step)["running"]) == bool(step.customers["served"].all()) == (not why)
            assert only(step)["out"] == bool(why)
            assert f"genset g0 is out ({why})" in step.solve["estimated"] or not why


def test_fuel_is_read_or_the_least_that_the_line_leaves() -> None:
    day = powered([DARK] * 6)
    controller = Controller.of(day, OPTIONS)
    told: list[dict[str, Any]] = [
        {},
        {"fuel_litres": {"g0": 150.0}},
        {},
        {"genset_kw": {"g0": 80.0}},
        {"fuel_litres": {"g0": 150.0}},
        {"fuel_litres": {"g0": 40.0}},
    ]
    least = 150.0 - HALF_L
    litres = [200.0, 150.0, least, least - 28.095, least - 28.095 - HALF_L, 40.0]
    kinds = ["", "", "missing", "missing", "frozen", ""]
    for time, heard, left, kind in zip(day.grid.times, told, litres, kinds, strict=True):
        step = controller.step(Measurement(time, running={"g0": 1}, **heard))
        assert only(step)["fuel_litres"] == pytest.approx(left, abs=1e-6)
        assert only(step)["fuel_end_litres"] == pytest.approx(left - HALF_L, abs=1e-6)
        assert f"{left:.0f} at least ({kind})" in step.solve["estimated"] or not kind
    assert "fuel_litres" not in step.solve["estimated"]


def test_a_gauge_whose_clock_is_ahead_does_not_stand_still_when_its_next_reading_is_lost() -> None:
    """A reading is dated 90 s after the decision that knew it: a step later it is no new one."""
    day = powered([DARK] * 6)
    controller = Controller.of(day, OPTIONS)
    first, second, third = day.grid.times[:3]

    def words(now: pd.Timestamp, read: pd.Timestamp) -> str:
        at = {"fuel_litres": {"g0": read}}
        told = Measurement(now, fuel_litres={"g0": 150.0}, read_at=at, running={"g0": 1})
        return str(controller.step(told).solve["estimated"])

    ahead = first + pd.Timedelta("90s")
    assert words(first, ahead) == ""
    assert words(second, ahead).endswith("(missing)")
    # One that is sent anew and still says the same does stand still.
    assert words(third, third).endswith("(frozen)")


def test_a_coarse_gauge_may_stand_still_for_a_twentieth_of_the_tank() -> None:
    day = powered([DARK] * 3, tank_litres=1000.0, fuel_level_litres=1000.0)
    controller = Controller.of(day, OPTIONS)
    for time in day.grid.times:
        step = controller.step(Measurement(time, fuel_litres={"g0": 400.0}))
        assert step.solve["estimated"] == "" and only(step)["fuel_litres"] == 400.0


def test_a_delivery_is_in_the_tank_once() -> None:
    """100 l come within the first step, and 100 l with the second one, which the gauge has."""
    day = powered([DARK] * 3, fuel_level_litres=50.0)
    start, hour = day.grid.start, pd.Timedelta(hours=1)
    when = [start + hour / 2, start + hour, start + 2 * hour]
    day = replace(day, refuels=Refuels(["g0"] * 3, when, [40.0, 50.0, 30.0]))
    controller = Controller.of(day, OPTIONS)
    assert only(controller.step(Measurement(start)))["fuel_litres"] == 50.0
    step = controller.step(Measurement(start + hour))
    assert only(step)["fuel_litres"] == pytest.approx(140.0 - HALF_L)
    step = controller.step(Measurement(start + 2 * hour, fuel_litres={"g0": 120.0}))
    assert only(step)["fuel_litres"] == 120.0
    assert only(step)["fuel_end_litres"] == pytest.approx(120.0 - HALF_L)


def test_least_times_outlive_a_restart() -> None:
    """On for 3 h at least, although the grid is back after one; then nobody decides for 2 h."""
    day = powered([DARK] + [OPEN] * 7, min_on_h=3.0, min_off_h=2.0)
    on, hours = [], []
    controller = Controller.of(day, OPTIONS)
    for time in day.grid.times[:5]:
        controller = Controller.of(day, OPTIONS, state=json.loads(controller.saved()))
        now = only(controller.step(Measurement(time)))
        on.append(bool(now["running"]))
        hours.append(float(now["hours_before"]))
    assert on == [True] * 3 + [False] * 2
    assert hours == [-24.0, 1.0, 2.0, 3.0, -1.0]
    assert only(controller.step(Measurement(day.grid.times[7])))["hours_before"] == -4.0


def test_a_set_that_nobody_decides_on_stops_at_the_end_of_its_step() -> None:
    day = powered([DARK] * 4)
    controller = Controller.of(day, OPTIONS)
    assert only(controller.step(Measurement(day.grid.times[0])))["running"]
    then = only(controller.step(Measurement(day.grid.times[3])))
    assert then["hours_before"] == -2.0
    assert then["fuel_litres"] == pytest.approx(200.0 - HALF_L)


def test_a_set_started_by_hand_is_on_and_may_have_given_all_that_it_can() -> None:
    """33.015 l in an hour at 100 kW; a step decided anew counts from the moment."""
    day = powered([OPEN] * 3, only_in_outage=True)
    controller = Controller.of(day, OPTIONS)
    start = day.grid.start
    assert not only(controller.step(Measurement(start)))["running"]
    step = controller.step(
        Measurement(start, now=start + pd.Timedelta(minutes=30), running={"g0": 1})
    )
    assert only(step)["hours_before"] == 0.0
    assert only(step)["fuel_litres"] == pytest.approx(200.0 - 33.015 / 2)


def with_set(tiny: Scenario, **more: Any) -> Scenario:
    """The day with a set that all of its demand can be served by."""
    return replace(tiny, gensets=gensets(bus=[4], p_min_kw=10.0, **more))


def test_an_operator_runs_a_set_and_sees_that_it_does_not_start(
    tiny: Scenario, tmp_path: Path
) -> None:
    day = with_set(site(tiny))
    clock = SetClock(NOON)
    hour = pd.Timedelta(hours=1)
    dark = {"type": "outage", "start": written(NOON), "end": written(NOON + 9 * hour)}
    with client(Service(day, HERE), tmp_path, clock) as http:
        http.put("/v1/events/storm", dark)
        first = decided(http, clock, NOON, soc=0.1)
        assert said(first, "gensets")["g0"]["running"]
        point = said(first, "gensets")["g0"]
        assert point["default"] == {"running": True, "p_kw": point["p_kw"]}
        (shown,) = http.get("/v1/setpoints?asset=g0").json()["setpoints"]
        assert shown["id"] == point["id"]
        rejected = {"status": "rejected", "reason": "no oil"}
        answer = http.post(f"/v1/setpoints/{point['id']}/status", rejected)
        assert answer.status == 200
        second = decided(http, clock, NOON + hour, soc=0.1)
        assert not said(second, "gensets")["g0"]["running"]
        assert second["expected"]["gensets"]["g0"]["out"]
        assert "genset g0 is out (start fault)" in second["estimated"]
        alarms = http.get("/v1/alarms").json()["alarms"]
        assert "g0 did not follow its set-point: it does not start." in [a["text"] for a in alarms]
    with client(Service(day, HERE), tmp_path, clock) as http:
        clock.set(NOON + 2 * hour)
        series = readings(NOON + 2 * hour, "start_fault", {"g0": 0.0})
        series += readings(NOON + 2 * hour, "fuel_litres", {"g0": 123.0})
        assert http.post("/v1/telemetry", {"series": series}).status == 200
        beyond = readings(NOON + 2 * hour, "fuel_litres", {"g0": 1230.0})
        refused = http.post("/v1/telemetry", {"series": beyond})
        assert refused.status == 422 and "tank of 200 l" in json.dumps(refused.json())
        third = decided(http, clock, NOON + 2 * hour, soc=0.1)
        assert said(third, "gensets")["g0"]["running"]
        assert third["expected"]["gensets"]["g0"]["fuel_litres"] == 123.0
        seen = http.get("/v1/overview").json()
        assert http.get("/v1/site").json()["gensets"]["g0"]["tank_litres"] == 200.0
        assert seen["plan"]["gensets"]["g0"]["running"]
        assert seen["measured"]["fuel_litres g0"]["value"] == 123.0
        until = written(NOON + 5 * hour)
        mode = {"mode": "manual", "until": until, "reason": "a test"}
        asked = {"kind": "gensets", "asset": "g0", "p_kw": 5.0}
        refused = http.put("/v1/mode", {**mode, "setpoints": [asked]})
        assert refused.status == 422 and "is not from 10 to 100 kW" in json.dumps(refused.json())
        for hours, p_kw in ((3, 40.0), (4, 0.0)):
            by_hand = {**mode, "setpoints": [{**asked, "p_kw": p_kw}]}
            assert http.put("/v1/mode", by_hand).status == 200
            point = said(decided(http, clock, NOON + hours * hour), "gensets")["g0"]
            assert (point["running"], point["p_kw"]) == (p_kw > 0.0, p_kw)
        sixth = decided(http, clock, NOON + 5 * hour, soc=0.1)
        assert "genset g0 is out" not in str(sixth["estimated"])
        # Since the third step it may have run for 3 h with the most that it was told.
        most_kw = max(said(third, "gensets")["g0"]["p_kw"], 40.0)
        least = 123.0 - 3 * (8.415 + 0.246 * most_kw)
        known = sixth["expected"]["gensets"]["g0"]
        assert known["fuel_litres"] == pytest.approx(least) and known["hours_before"] == 0.0
        told = export(Service(day, HERE), tmp_path, written(NOON), written(NOON + 6 * hour)).gensets
    assert told is not None
    assert told["running"].tolist()[:5] == [True, False, True, True, False]
    assert told["fuel_start_litres"][2] == 123.0 and told["p_kw"][3] == 40.0
    assert told["hours_before"].tolist() == [-24.0, -25.0, -26.0, 1.0, 2.0, 0.0]


def test_an_exported_day_has_its_first_delivery_once(tiny: Scenario, tmp_path: Path) -> None:
    clock = SetClock(NOON)
    day = replace(with_set(site(tiny)), refuels=Refuels(["g0"], [NOON], [50.0]))
    with client(Service(day, HERE), tmp_path, clock) as http:
        assert http.post(
            "/v1/telemetry", {"series": readings(NOON, "fuel_litres", {"g0": 120.0})}
        ).status == 200  # fmt: skip
        first = decided(http, clock, NOON, soc=0.1)
        assert first["expected"]["gensets"]["g0"]["fuel_litres"] == 120.0
        told = export(
            Service(day, HERE), tmp_path, written(NOON), written(NOON + pd.Timedelta(hours=1))
        ).scenario
    assert Engines(told).tank_litres(0).tolist() == [120.0]


def test_a_step_by_rule_leaves_a_set_as_it_was(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = SetClock(NOON)
    with client(Service(with_set(site(tiny)), HERE), tmp_path, clock) as http:
        http.put("/v1/events/storm", {"type": "outage", "start": written(NOON)})
        first = said(decided(http, clock, NOON, soc=0.1), "gensets")["g0"]
        with monkeypatch.context() as broken:
            broken.setattr("vppres.service.operation.deciding.known_at", None)
            plan = decided(http, clock, NOON + pd.Timedelta(hours=1), soc=0.1)
        point = said(plan, "gensets")["g0"]
        assert plan["status"] == "failed" and point["running"] and point["p_kw"] == first["p_kw"]


def test_what_a_set_that_can_form_the_grid_gave_is_not_known_without_a_meter() -> None:
    """33.015 l in an hour at 100 kW, although 50 kW were planned."""
    day = powered([DARK] * 2, grid_forming=True)
    controller = Controller.of(day, OPTIONS)
    controller.step(Measurement(day.grid.times[0], fuel_litres={"g0": 150.0}))
    step = controller.step(Measurement(day.grid.times[1], running={"g0": 1}))
    assert only(step)["fuel_litres"] == pytest.approx(150.0 - 33.015)


def test_a_set_that_is_out_forms_no_grid() -> None:
    day = powered([DARK] * 3, grid_forming=True)
    controller = Controller.of(day, replace(OPTIONS, mode="physical"))
    for time, told, runs in zip(
        day.grid.times, ({}, {"g0": 0}, {"g0": 1}), (True, False, True), strict=True
    ):
        step = controller.step(Measurement(time, running=told))
        assert bool(only(step)["running"]) == bool(step.customers["served"].all()) == runs


def test_a_set_that_rejected_its_start_and_has_no_fault_is_planned_for_at_once(
    tiny: Scenario, tmp_path: Path
) -> None:
    """Its first reading of a fault says that there is none; the same once more is no news."""
    day, clock, minute = with_set(site(tiny)), SetClock(NOON), pd.Timedelta("1min")
    dark = {"type": "outage", "start": written(NOON), "end": written(NOON + 540 * minute)}

    def sends_no_fault(minutes: float) -> None:
        clock.set(NOON + minutes * minute)
        series = readings(clock.now(), "start_fault", {"g0": 0.0})
        assert http.post("/v1/telemetry", {"series": series}).status == 200

    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):
        http.put("/v1/events/storm", dark)
        point = said(decided(http, clock, NOON, soc=0.1), "gensets")["g0"]
        assert point["running"]
        clock.set(NOON + 5 * minute)
        http.post(f"/v1/setpoints/{point['id']}/status", {"status": "rejected"})
        plan = runner.anew()
        assert plan is not None and plan["expected"]["gensets"]["g0"]["out"]
        sends_no_fault(10.0)
        assert runner.changes.reasons == ("g0 start_fault = 0 (scada)",)
        plan = runner.anew()
        assert plan is not None and not plan["expected"]["gensets"]["g0"]["out"]
        assert said(plan, "gensets")["g0"]["running"]
        sends_no_fault(15.0)
        assert runner.changes.reasons == ()


def test_a_set_that_is_refuelled_is_planned_for_at_once(tiny: Scenario, tmp_path: Path) -> None:
    """20 l last for no hour at 100 kW; a gauge that stands still is no news."""
    day, clock = with_set(site(tiny)), SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):

        def gauge(minutes: float, litres: float) -> tuple[str, ...]:
            clock.set(NOON + pd.Timedelta(minutes=minutes))
            series = readings(clock.now(), "fuel_litres", {"g0": litres})
            assert http.post("/v1/telemetry", {"series": series}).status == 200
            return runner.changes.reasons

        http.put("/v1/events/storm", {"type": "outage", "start": written(NOON)})
        gauge(0.0, 20.0)
        before = said(decided(http, clock, NOON, soc=0.1), "gensets")["g0"]
        assert gauge(19.0, 20.0) == ()
        assert gauge(20.0, 200.0) == ("fuel_litres of g0 is 200 (scada)",)
        plan = runner.anew()
        assert plan is not None and plan["anew"] == "fuel_litres of g0 is 200 (scada)"
        assert plan["expected"]["gensets"]["g0"]["fuel_litres"] == 200.0
        assert said(plan, "gensets")["g0"]["p_kw"] > before["p_kw"]
        assert gauge(21.0, 199.5) == ()


def test_a_set_that_stands_still_is_out_after_a_step_however_often_it_is_decided_anew(
    tiny: Scenario, tmp_path: Path
) -> None:
    """And one that was started by hand since is planned with at once."""
    day, clock = with_set(site(tiny)), SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):

        def runs(minutes: float, running: float) -> tuple[str, ...]:
            clock.set(NOON + pd.Timedelta(minutes=minutes))
            series = readings(clock.now(), "running", {"g0": running}, lasts="PT1M")
            assert http.post("/v1/telemetry", {"series": series}).status == 200
            return runner.changes.reasons

        http.put("/v1/events/storm", {"type": "outage", "start": written(NOON)})
        assert said(decided(http, clock, NOON), "gensets")["g0"]["running"]
        assert runs(2.0, 0.0) == ("g0 running = 0 (scada)",)
        plan = runner.anew()
        assert plan is not None and said(plan, "gensets")["g0"]["running"]
        runs(60.0, 0.0)
        plan = decided(http, clock, NOON + pd.Timedelta("1h"))
        assert "genset g0 is out (told to run, stands still)" in plan["estimated"]
        assert runs(69.0, 0.0) == ()
        assert runs(70.0, 1.0) == ("g0 running = 1 (scada)",)
        plan = runner.anew()
        assert plan is not None and said(plan, "gensets")["g0"]["running"]
        assert runs(71.0, 1.0) == ()


@pytest.mark.parametrize("fails", ["start_fault", "rejected"])
def test_a_set_that_runs_after_its_fault_stays_in_the_plan(
    tiny: Scenario, tmp_path: Path, fails: str
) -> None:
    """Started by hand; its fault is never taken back, and the step is decided anew again."""
    day, clock = with_set(site(tiny)), SetClock(NOON)
    with serving(Service(day, HERE), tmp_path, clock) as (http, runner):

        def planned(minutes: float, quantity: str, value: float) -> bool:
            clock.set(NOON + pd.Timedelta(minutes=minutes))
            http.post("/v1/telemetry", {"series": readings(clock.now(), quantity, {"g0": value})})
            runner.changes.note("a test")
            plan = runner.anew()
            assert plan is not None
            return bool(said(plan, "gensets")["g0"]["running"])

        http.put("/v1/events/storm", {"type": "outage", "start": written(NOON)})
        point = said(decided(http, clock, NOON), "gensets")["g0"]
        clock.set(NOON + pd.Timedelta(minutes=1))
        if fails == "rejected":
            http.post(f"/v1/setpoints/{point['id']}/status", {"status": "rejected"})
        told = ("start_fault", 1.0) if fails == "start_fault" else ("fuel_litres", 160.0)
        assert not planned(3.0, *told)
        assert planned(5.0, "running", 1.0)
        assert planned(7.0, "fuel_litres", 150.0)
        assert not planned(9.0, "running", 0.0)
