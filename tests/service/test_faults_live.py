"""Faults of lines in the service: reported, changed, repaired, refused, and known after a restart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.faulted import faulted_day
from tests.support.live_service import (
    HERE,
    NOON,
    Running,
    client,
    decided,
    running,
    said,
    site,
)
from tests.support.played_service import played
from tests.support.sequences import Player, Row, one
from tests.support.three_phases import three_phases
from vppres import Controller, RunOptions, run_day
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service
from vppres.service.replay.export import export
from vppres.service.simulate import Play

SOON = NOON + pd.Timedelta("10min")
HOUR = pd.Timedelta("1h")
BEHIND = "no battery forms the grid behind line 2-4, which is out"
FAULT = {
    "type": "fault",
    "line": "4",
    "start": "2026-11-21T12:10:00Z",
    "end": "2026-11-21T14:00:00Z",
}


@pytest.fixture
def one_former(tiny: Scenario) -> Scenario:
    """The tiny day in which only the battery at bus 2 forms a grid."""
    return replace(tiny, batteries=replace(tiny.batteries, grid_forming=[True, False]))


@pytest.fixture
def live(one_former: Scenario, tmp_path: Path) -> Iterator[Running]:
    """A service that has decided the step of noon; it is 12:10."""
    with running(one_former, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON)
        clock.set(SOON)
        yield http, clock, runner


def off(plan: dict[str, Any]) -> dict[str, str]:
    """Customers that are off, and why."""
    return {k: one["reason"] for k, one in said(plan, "customers").items() if not one["served"]}


def alarms(http: Caller) -> dict[str, dict[str, Any]]:
    """Alarms that are not cleared, by kind."""
    found = http.get("/v1/alarms").json()["alarms"]
    return {one["kind"]: one for one in found if not one["cleared_at"]}


PUT = "PUT events/feeder-b"
CALM = {"": lambda plan: off(plan) == {} and "faults" not in plan}
DARK = {"": lambda plan: off(plan) == {"homes": f"blacked out: {BEHIND}"}}
SEQUENCES: dict[str, list[Row]] = {
    "a fault that is reported is planned for at once": [
        ("12:10", "GET plan", None, 200, CALM),
        ("12:10", PUT, FAULT, 201, {}),
        ("12:10", "GET plan", None, 200, {"unaware_of": ["event feeder-b"]}),
        ("12:10", "anew", None, 200, {**DARK, "faults.*.name": ["line 2-4"], "faults.0.out": True,
            "faults.0.end": FAULT["end"], "ahead.served.homes": [False, True]}),
        ("12:10", "GET alarms", None, 200, {"alarms": one(kind="line_out", priority="medium",
            text=f"Line 2-4 is out of service until 14:00; homes off supply: {BEHIND}.")}),
        ("12:10", "GET overview", None, 200, {"plan.off.*.reason": [f"blacked out: {BEHIND}"]}),
    ],
    "its end may change and it may be repaired early": [
        ("12:10", PUT, {**FAULT, "end": None}, 201, {}),
        ("12:10", "anew", None, 200, {"ahead.served.homes": [False, False]}),
        ("12:10", PUT, FAULT, 200, {}),
        ("13:00", "decide", 0.5, 200, DARK),
        ("13:20", PUT, {**FAULT, "end": "2026-11-21T13:20:00Z"}, 200, {}),
        ("13:20", "anew", None, 200, CALM),
        ("13:20", "GET alarms", None, 200, {"alarms.line_out.cleared_at": "2026-11-21T13:20:00Z"}),
    ],
    "a fault that is withdrawn is none": [
        ("12:10", "PUT events/bus", {"type": "fault", "bus": 4, "start": FAULT["start"]}, 201, {}),
        ("12:10", "anew", None, 200, {"": lambda plan: off(plan) == {"homes": "blacked out: bus 4 is out"}}),
        ("12:15", "DELETE events/bus", None, 200, {}),
        ("12:15", "anew", None, 200, CALM),
    ],
    "what is not there is refused once": [
        *(("12:10", "PUT events/x", {"type": "fault", "start": FAULT["start"], **place}, 422,
            {"": lambda answer, words=words: str(answer).count(words) == 1})
            for place, words in (
                ({"line": "44"}, "event, line = 44: is not a bus of the feeder. Did you mean 4?"),
                ({"bus": 1}, "event, bus = 1: is the bus of the grid. Put an event outage, or give another bus."),
                ({}, "names not one place. Give line, the bus that it feeds, or bus"),
                ({"line": "4", "bus": "3"}, "names not one place. Give line, the bus that it feeds, or bus"))),
        ("12:10", "GET events", None, 200, {"": {}}),
        ("12:10", "anew", None, 204, {}),
    ],
}  # fmt: skip


@pytest.mark.parametrize("rows", SEQUENCES.values(), ids=list(SEQUENCES))
def test_a_sequence_of_reports(rows: list[Row], live: Running) -> None:
    Player(live).play(rows)


@pytest.mark.parametrize("mode", ["hold", "off", "manual"])
def test_a_fault_that_a_mode_does_not_plan_for_is_urgent(live: Running, mode: str) -> None:
    """Everybody is ordered on, as before the fault: nobody knows whether that holds."""
    http, clock, runner = live
    on = {"kind": "customers", "asset": "homes", "served": True}
    until = "2026-11-21T15:00:00Z"
    body = {"mode": mode, "reason": "test", "until": until}
    assert http.put("/v1/mode", body | {"setpoints": [on] * (mode == "manual")}).status == 200
    http.put("/v1/events/feeder", {**FAULT, "line": "2"})
    clock.set(SOON + pd.Timedelta("1min"))
    assert (runner.anew() or {})["status"] == mode
    alarm = alarms(http)["line_out"]
    behind = f"homes, hospital, shop behind it, whose supply is not planned in the mode {mode}."
    words = f"Line 1-2 is out of service until 14:00; {behind}"
    assert (alarm["text"], alarm["priority"]) == (words, "high")


def test_a_fault_later_in_the_step_is_told_as_to_come(one_former: Scenario, tmp_path: Path) -> None:
    """At noon the step is planned without the line that is switched off at ten past."""
    with running(one_former, tmp_path) as (http, clock, _):
        http.put("/v1/events/feeder-b", FAULT)
        assert set(off(decided(http, clock, NOON))) == {"homes"}
        words = "Line 2-4 will be out of service from 12:10 until 14:00; homes off supply: "
        assert alarms(http)["line_out"]["text"].startswith(words)


def test_an_island_that_has_too_little_is_no_want_of_grid(tiny: Scenario, tmp_path: Path) -> None:
    """The battery of the homes forms their part, and gives less than they take."""
    b = replace(tiny.batteries, grid_forming=[True] * 2, p_max_kw=[50.0, 5.0])
    with running(replace(tiny, batteries=b), tmp_path) as (http, clock, _):
        http.put("/v1/events/feeder-b", {**FAULT, "start": "2026-11-21T12:00:00Z"})
        assert set(off(decided(http, clock, NOON))) == {"homes"}
        found = alarms(http)
        words = (
            "Line 2-4 is out of service until 14:00; homes off supply: too little power or energy"
        )
        assert found["line_out"]["text"] == f"{words} behind it."
        assert "off_with_grid" not in found
        first = found["line_out"]["raised_at"]
        decided(http, clock, NOON + HOUR)
        assert (
            alarms(http)["line_out"]["raised_at"] == first
        )  # it is one alarm for as long as it lasts


def test_a_feeder_with_phases_knows_the_parts(one_former: Scenario, tmp_path: Path) -> None:
    service = Service(three_phases(site(one_former)), replace(HERE, mode="physical"))
    clock = SetClock(NOON)
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/feeder-b", FAULT)
        plan = decided(http, clock, NOON)
    assert off(plan) == {"homes": f"blacked out: {BEHIND}"}
    assert [one["name"] for one in plan["faults"]] == ["line 2-4"]


def test_a_step_by_rule_knows_the_parts(live: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    http, clock, _ = live
    http.put("/v1/events/feeder-b", FAULT)
    monkeypatch.setattr(Controller, "step", lambda *_: 1 / 0)
    plan = decided(http, clock, NOON + HOUR)
    assert plan["status"] == "failed"
    assert set(off(plan)) == {"homes"}
    assert [one["name"] for one in plan["faults"]] == ["line 2-4"]


def test_a_fault_is_known_after_a_restart(one_former: Scenario, tmp_path: Path) -> None:
    clock = SetClock(NOON)
    service = Service(site(one_former), HERE)
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/feeder-b", FAULT)
        assert set(off(decided(http, clock, NOON))) == {"homes"}
    with client(service, tmp_path, clock) as http:
        assert set(off(decided(http, clock, NOON + HOUR))) == {"homes"}
        assert off(decided(http, clock, NOON + 2 * HOUR)) == {}


def test_faults_of_the_folder_are_known(one_former: Scenario, tmp_path: Path) -> None:
    fault = LineFault(NOON + HOUR, NOON + 2 * HOUR, line=4)
    clock = SetClock(NOON)
    with client(Service(replace(site(one_former), faults=(fault,)), HERE), tmp_path, clock) as http:
        plan = decided(http, clock, NOON)
        assert plan["ahead"]["served"]["homes"] == [False, True]
        assert [one["out"] for one in plan["faults"]] == [False]
        assert set(off(decided(http, clock, NOON + HOUR))) == {"homes"}


@pytest.mark.daily
@pytest.mark.parametrize("seed", range(20))
def test_a_simulated_day_is_played_by_reports(seed: int, tmp_path: Path) -> None:
    """The service knows the day, but of faults only what is reported to it."""
    day = faulted_day(seed)
    options = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
    run = run_day(day, options)
    service = Service(replace(day, faults=()), options, rehearsal=True)
    player = played(service, day, tmp_path, Play())
    assert player.tally.statuses == {"ok": day.grid.n_steps}
    for t, record in enumerate(player.world.records):
        assert record.customers["served"].tolist() == run.by_step("customers", "served")[t].tolist()
        why = run.by_step("customers", "off_by_fault")[t].tolist()
        assert record.customers["off_by_fault"].tolist() == why


@pytest.mark.daily
def test_it_is_explained_and_exported(one_former: Scenario, tmp_path: Path) -> None:
    """The export knows each fault as the plans knew it, to its end or repair."""
    clock = SetClock(NOON)
    service = Service(site(one_former), HERE)
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/feeder-b", {**FAULT, "start": "2026-11-21T12:00:00Z", "end": None})
        decided(http, clock, NOON)
        found = http.get("/v1/explanations?asset=homes").json()["reasons"]
        (reason,) = [one for one in found if one["kind"] == "customers"]
        assert (reason["driver"], reason["words"]) == ("fault", f"Not supplied: {BEHIND}.")
        decided(http, clock, NOON + HOUR)
        http.put("/v1/events/feeder-b", {**FAULT, "end": "2026-11-21T14:00:00Z"})
        plan = decided(http, clock, NOON + 2 * HOUR)
        assert "faults" not in plan
    run = export(service, tmp_path, "2026-11-21T12:00Z", "2026-11-21T15:00Z")
    assert run.steps["lines_out"].tolist() == ["line 2-4", "line 2-4", ""]
    homes = run.customers[run.customers["id"] == "homes"]
    assert homes["off_by_fault"].tolist() == [BEHIND, BEHIND, ""]
    assert homes["served"].tolist() == [False, False, True]
