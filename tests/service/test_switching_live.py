"""Switches of a service: one operation at a time, confirmed by an operator and by telemetry."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, Live, decided, said, serving
from tests.support.live_service import client as asked
from tests.support.page_words import NODE, said_by
from tests.support.switching_service import confirm, read, switched, want
from tests.support.three_phases import three_phases
from vppres.model.site import Site
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches
from vppres.service.clock import SetClock, written
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.replay.explanations import explained, question
from vppres.service.replay.export import exported
from vppres.service.storage.store import Store

HOUR = pd.Timedelta(hours=1)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    clock = SetClock(NOON)
    with asked(Service(switched(), HERE, paced=True), tmp_path / "db", clock) as http:
        yield http, clock


def test_the_next_operation_comes_after_telemetry_has_confirmed_the_one_before(
    live: Live,
) -> None:
    http, clock = live
    read(http, clock, t=0, s=1)
    told = want(http, t=True, s=False).json()
    assert (told["status"], told["next"], told["issued"]) == ("confirm", "t", None)
    assert told["operations"][0].startswith("close t: it closes a loop and carries ")
    assert told["operations"][1].startswith("open s: it opens the loop; ")
    # The second is not confirmed before the first.
    refused = confirm(http, "s")
    assert (
        refused.status == 422
        and "is not the switch of the next operation" in refused.content.decode()
    )
    told = confirm(http, "t").json()
    assert (told["status"], told["next"]) == ("waiting", None)
    until = written(NOON + pd.Timedelta(minutes=25))
    now = written(NOON)
    assert told["issued"] == {"switch": "t", "closed": True, "confirmed_at": now, "until": until}
    # Nor while the first is not seen.
    assert confirm(http, "s").status == 422
    clock.set(NOON + pd.Timedelta(minutes=3))
    read(http, clock, t=1)
    told = http.get("/v1/switching").json()
    assert (told["status"], told["next"], told["unlike_plans"]) == ("confirm", "s", ["t"])
    assert confirm(http, "s").json()["issued"]["switch"] == "s"
    read(http, clock, s=0)
    told = http.get("/v1/switching").json()
    assert (told["status"], told["issued"], told["read"]) == ("done", None, {"t": True, "s": False})
    # Whoever moves a switch by hand later is not taken for a late device.
    clock.set(NOON + pd.Timedelta(hours=2))
    read(http, clock, s=1)
    assert http.get("/v1/switching").json()["status"] == "confirm"


def test_an_operation_that_is_not_seen_in_time_stops_the_order(live: Live) -> None:
    http, clock = live
    read(http, clock, t=0, s=1)
    want(http, t=True, s=False)
    confirm(http, "t")
    # It is on its way, whatever is asked for meanwhile.
    assert want(http, t=False, s=True).json()["status"] == "waiting"
    assert http.delete("/v1/switching").json()["issued"]["switch"] == "t"
    want(http, t=True, s=False)
    clock.set(NOON + pd.Timedelta(minutes=25))
    told = http.get("/v1/switching").json()
    assert told["status"] == "stopped" and told["operations"] == []
    assert told["reason"].startswith("t did not read closed by 2026-11-21T12:25:00Z.")
    assert confirm(http, "s").status == 422
    assert want(http, t=True, s=False).json()["status"] == "confirm"
    assert http.delete("/v1/switching").json()["status"] == "none"


def test_an_order_that_an_operator_has_not_seen_is_not_replaced(live: Live) -> None:
    http, clock = live
    read(http, clock, t=0, s=1)
    asked = {"closed": {"t": True, "s": False}}
    tag = http.get("/v1/switching").headers["etag"]
    first = http.put("/v1/switching", asked, if_match=tag)
    seen = first.headers["etag"]
    assert first.status == 200 and seen != tag
    late = http.put("/v1/switching", {"closed": {"s": False}}, if_match=tag)
    assert (late.status, late.json()["detail"]) == (412, "The switching has changed since.")
    assert http.delete("/v1/switching", if_match=tag).status == 412
    asks = {"switch": "t"}
    assert http.post("/v1/switching/confirm", asks, if_match=tag).status == 412
    told = http.get("/v1/switching")
    assert (told.headers["etag"], told.json()["asked"]) == (seen, asked["closed"])
    confirmed = http.post("/v1/switching/confirm", asks, if_match=seen)
    assert confirmed.status == 200
    # What was confirmed meanwhile is another state of the order.
    assert http.put("/v1/switching", asked, if_match=seen).status == 412
    assert http.delete("/v1/switching", if_match=confirmed.headers["etag"]).status == 200


PAGE = """
import { switching } from "./words.mjs";
import { readFileSync } from "node:fs";
console.log(JSON.stringify(switching({ overview: JSON.parse(readFileSync(0)) })));
"""


@pytest.mark.skipif(NODE is None, reason="no node on the path")
def test_the_page_shows_the_order_and_the_operation_to_confirm(live: Live, tmp_path: Path) -> None:
    http, clock = live

    def shown() -> Any:
        return said_by(PAGE, tmp_path, json.dumps(http.get("/v1/overview").json()))

    read(http, clock, t=0, s=1)
    assert shown() is None
    want(http, t=True, s=False)
    page = shown()
    assert [words.split(":")[0] for words in page["operations"]] == ["close t", "open s"]
    asked_for = "Asked for: s open, t closed."
    assert page["words"] == f"{asked_for} The first waits for an operator's confirmation."
    assert page["next"] == "close t"
    assert page["seen"] == http.get("/v1/switching").headers["etag"]
    confirm(http, "t")
    page = shown()
    words = "An operation is carried out: t has not yet read closed."
    assert (page["words"], page["next"]) == (f"{asked_for} {words}", "")
    clock.set(NOON + pd.Timedelta(minutes=25))
    assert shown()["words"].startswith(f"{asked_for} Stopped: t did not read closed by ")
    http.delete("/v1/switching")
    assert shown() is None


def test_an_order_that_is_stopped_is_an_alarm(tmp_path: Path) -> None:
    clock = SetClock(NOON)
    with serving(Service(switched(), HERE, paced=True), tmp_path / "db", clock) as (http, runner):
        check_alarm(http, clock, runner)


def check_alarm(http: Caller, clock: SetClock, runner: Runner) -> None:
    """It is raised when telemetry is late, and cleared when it comes."""

    def stopped() -> list[dict[str, Any]]:
        runner.watch.check_alarms()
        found = http.get("/v1/alarms").json()["alarms"]
        return [one for one in found if one["kind"] == "switching_stopped"]

    read(http, clock, t=0, s=1)
    want(http, t=True, s=False)
    confirm(http, "t")
    assert stopped() == []
    clock.set(NOON + pd.Timedelta(minutes=25))
    (alarm,) = stopped()
    assert (alarm["priority"], alarm["state"]) == ("medium", "raised")
    words = "The order of switching is stopped: t did not read closed by 2026-11-21T12:25:00Z."
    assert alarm["text"].startswith(words)
    # The device was late: the order goes on.
    read(http, clock, t=1)
    assert http.get("/v1/switching").json()["next"] == "s"
    assert all(one["cleared_at"] for one in stopped())
    # A grid that is lost does not stop it.
    lose_grid(http, clock)
    assert http.get("/v1/switching").json()["next"] == "s"
    assert all(one["cleared_at"] for one in stopped())


def lose_grid(http: Caller, clock: SetClock) -> None:
    """A reading that the grid is lost, as an event announced it."""
    until = written(clock.now() + HOUR)
    event = {"type": "outage", "start": written(clock.now()), "end": until}
    assert http.put("/v1/events/works", event).status == 201
    grid = {"source": "scada", "asset": "grid", "quantity": "grid_on", "resolution": "PT1M"}
    body = {"series": [{**grid, "start": written(clock.now()), "values": [0]}]}
    assert http.post("/v1/telemetry", body).status == 200


def test_a_tie_supplies_what_is_behind_a_reported_fault(live: Live) -> None:
    """Line 2-3 is out by an event: it is not closed again, and the tie supplies the shop."""
    http, clock = live
    read(http, clock, t=0, s=1)
    fault = {"type": "fault", "line": "3", "start": written(NOON), "end": written(NOON + 2 * HOUR)}
    assert http.put("/v1/events/digger", fault).status == 201
    told = want(http, t=True, s=False).json()
    assert any(
        words.startswith("close t: it supplies customer shop") for words in told["operations"]
    )
    read(http, clock, t=1, s=0)
    back = want(http, t=False, s=True)
    assert back.status == 422
    assert "s cannot be closed: its line, or a bus of it, has a fault." in back.content.decode()


@pytest.mark.parametrize(
    ("line", "cure"),
    [
        ("2-3", "Give 3: a line is named by the bus that it feeds."),
        ("line 4-2", "Give 4: a line is named by the bus that it feeds."),
        ("s", "Give 3: a line is named by the bus that it feeds."),
        ("t", "Send closed, 0, of it as telemetry: a tie has no fault of its own."),
    ],
)
def test_a_fault_of_what_an_operator_calls_a_line_says_how_to_name_it(
    live: Live, line: str, cure: str
) -> None:
    fault = {"type": "fault", "line": line, "start": written(NOON), "end": None}
    answer = live[0].put("/v1/events/digger", fault)
    [problem] = answer.json()["problems"]
    assert (answer.status, problem["cure"]) == (422, cure)


def test_states_that_cannot_be_reached_are_refused_with_the_reason(tmp_path: Path) -> None:
    day = switched(locked=["men at work", ""])
    with asked(Service(day, HERE, paced=True), tmp_path / "db", SetClock(NOON)) as http:
        unknown = want(http, T=True)
        assert unknown.status == 422 and "is no switch of the site" in unknown.content.decode()
        unread = want(http, t=True)
        assert unread.status == 422 and "has no reading of its state" in unread.content.decode()
        read(http, SetClock(NOON), t=0, s=1)
        locked = want(http, t=True, s=False)
        assert locked.status == 422 and "t is locked: men at work." in locked.content.decode()
        loop = want(http, t=True)
        assert loop.status == 422 and "t is locked" in loop.content.decode()
        assert http.get("/v1/switching").json()["status"] == "none"


def test_what_is_not_known_by_phase_is_refused(tmp_path: Path) -> None:
    """A tie that lacks a phase is left open in plans, and is in no order of operations."""
    day = three_phases(switched())
    bare = [replace(row, phases="a" if row.at == 4 else row.phases) for row in day.phases.buses]
    lines = [row for row in day.phases.lines if row.to_bus != "4"]
    line = next(row for row in day.phases.lines if row.to_bus == "4")
    z_ohm = np.where(np.eye(3) * [1, 0, 0], line.z_ohm, np.nan)
    lines.append(replace(line, z_ohm=z_ohm))
    on_a = [replace(row, coils="a") if row.bus == "4" else row for row in day.phases.connections]
    day = replace(day, phases=Phases(tuple(bare), tuple(lines), connections=tuple(on_a)))
    options = replace(HERE, mode="physical")
    with asked(Service(day, options, paced=True), tmp_path / "db", SetClock(NOON)) as http:
        read(http, SetClock(NOON), s=0, t=1)
        plan = http.post("/v1/steps").json()
        assert plan["switches_open"] == ["s", "t"]
        assert "t lacks a phase, and is open in the plan" in plan["estimated"]
        assert "unaware_of" not in http.get("/v1/plan").json()
        refused = want(http, s=True).content.decode()
        assert "t is closed or would be, and has not all three phases" in refused


def test_higher_demand_after_an_outage_is_not_known_by_phase(tmp_path: Path) -> None:
    day = three_phases(switched())
    day = replace(day, switching=replace(day.switching, cold_load_factor=1.5))
    options = replace(HERE, mode="physical")
    with asked(Service(day, options, paced=True), tmp_path / "db", SetClock(NOON)) as http:
        read(http, SetClock(NOON), t=0, s=1)
        assert "is not known by phase" in want(http, t=True, s=False).content.decode()


@pytest.mark.daily
@pytest.mark.parametrize("seen", ["seen", "unseen"])
def test_a_service_killed_between_two_operations_goes_on_from_what_is_read(
    tmp_path: Path, seen: str
) -> None:
    """Killed with -9 after the first operation was confirmed, before or after it was read."""
    root = Path(__file__).parents[2]
    module = "tests.support.switching_service"
    words = [sys.executable, "-m", module, str(tmp_path / "db"), seen]
    assert subprocess.run(words, cwd=root, timeout=120, check=False).returncode == -9
    clock = SetClock(NOON + pd.Timedelta(minutes=2))
    with asked(Service(switched(), HERE, paced=True), tmp_path / "db", clock) as http:
        told = http.get("/v1/switching").json()
        if seen == "seen":
            assert (told["status"], told["next"], told["read"]["t"]) == ("confirm", "s", True)
        else:
            assert (told["status"], told["issued"]["switch"]) == ("waiting", "t")
            read(http, clock, t=1)
        # Meanwhile somebody opened the switch by hand: nothing is left to be done.
        read(http, clock, s=0)
        assert http.get("/v1/switching").json()["status"] == "done"
        assert decided(http, clock, NOON + HOUR)["switches_open"] == ["s"]


def site_of(mode: str, **options: Any) -> Service:
    """The service of the feeder with two switches in a mode, or with three equal phases."""
    by_phase = mode == "by phase"
    day = three_phases(switched()) if by_phase else switched()
    mode = "physical" if by_phase else mode
    return Service(day, replace(HERE, mode=mode, **options), paced=True)


def the_shop(plan: dict[str, Any]) -> dict[str, Any]:
    return said(plan, "customers")["shop"]


def standing(http: Caller, kind: str) -> list[dict[str, Any]]:
    """Alarms of a kind that are not cleared."""
    found = http.get("/v1/alarms").json()["alarms"]
    return [one for one in found if one["kind"] == kind and not one["cleared_at"]]


def out(http: Caller, line: str) -> None:
    """A fault of a line from now on, without an end."""
    fault = {"type": "fault", "line": line, "start": written(NOON), "end": None}
    assert http.put("/v1/events/digger", fault).status == 201


@pytest.mark.parametrize(
    "mode", ["paper", "physical", pytest.param("by phase", marks=pytest.mark.daily)]
)
def test_plans_are_of_the_feeder_as_its_switches_are_read(tmp_path: Path, mode: str) -> None:
    service = site_of(mode)
    clock = SetClock(NOON)
    with serving(service, tmp_path / "db", clock) as (http, runner):
        read(http, clock, t=0, s=1)
        out(http, "3")
        plan = decided(http, clock, NOON)
        assert plan["switches_open"] == ["t"]
        assert not the_shop(plan)["served"]
        # The operator opens the switch of the faulted line, and closes the tie.
        clock.set(NOON + pd.Timedelta("10min"))
        read(http, clock, s=0)
        read(http, clock, t=1)
        assert http.get("/v1/plan").json()["unaware_of"] == [
            "s is open (scada)",
            "t is closed (scada)",
        ]
        assert http.get("/v1/switching").json()["unlike_plans"] == ["s", "t"]
        anew = runner.anew()
        assert anew is not None
        assert (anew["switches_open"], the_shop(anew)["served"]) == (["s"], True)
        assert "unaware_of" not in http.get("/v1/plan").json()
        assert http.get("/v1/switching").json()["unlike_plans"] == []
        # The fault is there, and takes nobody's supply.
        [alarm] = standing(http, "line_out")
        assert alarm["text"] == "Line 2-3 is out of service, and its end is not known."
        # Set-points of an operator are checked on the same feeder.
        on = {"kind": "customers", "asset": "shop", "served": True}
        until = written(NOON + HOUR)
        asked = {"mode": "manual", "reason": "test", "until": until, "setpoints": [on]}
        assert http.post("/v1/mode/check", asked).json()["found"] == []
    # A restart reads no switch anew, and goes on.
    with serving(service, tmp_path / "db", clock) as (http, runner):
        assert the_shop(decided(http, clock, NOON + HOUR))["served"]
        # Once the line is repaired the tie has to be opened before it is closed again.
        http.delete("/v1/events/digger")
        read(http, clock, s=1)
        loop = decided(http, clock, NOON + 2 * HOUR)
        assert loop["switches_open"] == ["s"]
        assert "s closes a loop, and is open in the plan" in loop["estimated"]
        assert "unaware_of" not in http.get("/v1/plan").json()
        read(http, clock, t=0)
        anew = runner.anew()
    with closing(Store(tmp_path / "db", Site.of(service.scenario).key, reading=True)) as store:
        run = exported(service, store, NOON, NOON + 3 * HOUR)
    assert run.steps["switches_open"].tolist() == ["s", "s", "s"]
    served = run.by_step("customers", "served")
    assert served[:, 1].all()


@pytest.mark.parametrize("mode", ["paper", pytest.param("by phase", marks=pytest.mark.daily)])
def test_what_a_plan_proposes_is_asked_for_and_carried_out(tmp_path: Path, mode: str) -> None:
    service = site_of(mode, move_switches=True)
    with serving(service, tmp_path / "db", SetClock(NOON)) as (http, runner):
        read(http, runner.clock, t=0, s=1)
        out(http, "3")
        plan = decided(http, runner.clock, NOON)
        assert not the_shop(plan)["served"]
        proposed = http.get("/v1/switching").json()["proposed"]
        assert proposed == plan["proposed"]
        assert proposed["closed"] == {"t": True, "s": False}
        assert proposed["why"].startswith("closing t serves 1 customer until ")
        [alarm] = standing(http, "switch_proposed")
        assert alarm["text"] == f"C{proposed['why'][1:]}; it waits for an operator."
        overview = json.dumps(http.get("/v1/overview").json())
        if NODE is not None:
            page = said_by(PAGE, tmp_path, overview)
            assert page["next"] == "ask for s open, t closed"
            assert (page["method"], page["body"]) == ("PUT", {"closed": proposed["closed"]})
        told = http.put("/v1/switching", {"closed": proposed["closed"]}).json()
        assert [words.split(":")[0] for words in told["operations"]] == ["open s", "close t"]
        for name, state in (("s", 0), ("t", 1)):
            assert confirm(http, name).status == 200
            read(http, runner.clock, **{name: state})
        runner.clock.set(NOON + pd.Timedelta("1min"))
        plan = runner.anew() or {}
        assert the_shop(plan)["served"] and "proposed" not in plan
        assert http.get("/v1/switching").json()["proposed"] is None
        assert standing(http, "switch_proposed") == []


def test_a_step_is_explained_on_the_feeder_as_it_was_read(tmp_path: Path) -> None:
    """The homes are off for the voltage of the shop, which hangs behind them at the tie."""
    day = switched()
    weak = replace(day.network, r_ohm=300.0 * day.network.r_ohm, x_ohm=300.0 * day.network.x_ohm)
    service = Service(replace(day, network=weak), HERE, paced=True)
    with serving(service, tmp_path / "db", SetClock(NOON)) as (http, runner):
        read(http, SetClock(NOON), t=1, s=0)
        plan = decided(http, runner.clock, NOON)
        assert not said(plan, "customers")["homes"]["served"]
        asked = question(runner, plan)
        [step] = asked.records()
        assert step.steps["switches_open"] == "s"
        found = explained(asked)
        [homes] = (one for one in found["reasons"] if one["asset"] == "homes")
        assert homes["driver"] == "voltage" and "at bus 3 would add" in homes["words"]


def test_steps_without_a_decision_are_of_the_feeder_as_it_is_read(tmp_path: Path) -> None:
    clock = SetClock(NOON)
    with serving(Service(switched(), HERE, paced=True), tmp_path / "db", clock) as (http, runner):
        read(http, clock, t=1, s=0)
        out(http, "3")

        def fails(_: object) -> None:
            raise RuntimeError("the controller is broken")

        runner.deciding.controller.step = fails  # type: ignore[assignment,method-assign]
        plan = decided(http, clock, NOON)
        assert (plan["status"], plan["switches_open"]) == ("failed", ["s"])
        assert the_shop(plan)["served"]


def with_three_switches() -> Scenario:
    """The tie from 3 to 4, and a switch on each of the lines from 2."""
    none = np.nan
    switches = Switches(
        ["t", "s", "u"],
        [3, 2, 2],
        [4, 3, 4],
        ["tie", "sectionaliser", "sectionaliser"],
        [False, True, True],
        r_ohm=[0.5, none, none],
        x_ohm=[0.4, none, none],
    )
    return replace(switched(), switches=switches)


@pytest.mark.parametrize(
    "mode", ["paper", "physical", pytest.param("by phase", marks=pytest.mark.daily)]
)
def test_without_grid_a_tie_supplies_what_is_behind_a_fault(tmp_path: Path, mode: str) -> None:
    with serving(site_of(mode), tmp_path / "db", SetClock(NOON)) as (http, runner):
        read(http, runner.clock, t=0, s=1)
        lose_grid(http, runner.clock)
        out(http, "3")
        anew = decided(http, runner.clock, NOON, 0.84)
        assert not the_shop(anew)["served"]
        told = want(http, t=True, s=False).json()
        words = "; ".join(told["operations"])
        assert "close t: it supplies customer shop; " in words
        assert "open s: it has carried nothing since the fault; " in words
        while name := http.get("/v1/switching").json()["next"]:
            assert confirm(http, name).status == 200
            runner.clock.set(runner.clock.now() + pd.Timedelta("1min"))
            read(http, runner.clock, **{name: int(name == "t")})
            anew = runner.anew() or anew
        assert http.get("/v1/switching").json()["status"] == "done"
        assert the_shop(anew)["served"] and not anew["grid"]["available"]


@pytest.mark.parametrize("by_phase", [False, pytest.param(True, marks=pytest.mark.daily)])
def test_an_island_is_split_where_each_part_holds_what_its_set_points_say(
    tmp_path: Path, by_phase: bool
) -> None:
    """Without the other battery, big at bus 2 would have to give 60 + 40 - 20 kW of 50."""
    day = three_phases(with_three_switches()) if by_phase else with_three_switches()
    with serving(
        Service(day, replace(HERE, mode="physical"), paced=True), tmp_path / "db", SetClock(NOON)
    ) as (http, runner):
        read(http, runner.clock, t=0, s=1, u=1)
        lose_grid(http, runner.clock)
        plan = decided(http, runner.clock, NOON, 0.84)
        on = {name: one["served"] for name, one in said(plan, "customers").items()}
        assert on == {"hospital": True, "shop": True, "homes": False}
        refused = want(http, u=False).content.decode()
        assert "big holds the island with 80.0 kW" in refused
        told = want(http, s=False).json()
        assert told["operations"][0].startswith("open s: customer shop is without supply; ")
        runner.clock.set(NOON + pd.Timedelta("1min"))
        read(http, runner.clock, s=0)
        anew = runner.anew() or {}
        assert not the_shop(anew)["served"]
        told = want(http, u=False).json()
        assert told["operations"][0].startswith(
            "open u: it splits off an island, which small holds"
        )


@pytest.mark.parametrize("mode", ["physical", "by phase"])
def test_a_dark_island_has_no_voltage_to_check(tmp_path: Path, mode: str) -> None:
    with serving(site_of(mode), tmp_path / "db", SetClock(NOON)) as (http, runner):
        read(http, runner.clock, t=0, s=1)
        lose_grid(http, runner.clock)
        plan = decided(http, runner.clock, NOON, 0.15)
        assert plan["solve"]["dark_reason"]
        told = want(http, s=False).json()
        assert told["operations"][0].startswith("open s: its line has no supply")


@pytest.mark.daily
def test_a_customer_behind_open_switches_is_off_for_them(tmp_path: Path) -> None:
    """Nobody is told that a customer is off although there is grid: there is none behind them."""
    service = Service(switched(), replace(HERE, mode="physical"), paced=True)
    with serving(service, tmp_path / "db", SetClock(NOON)) as (http, runner):
        read(http, runner.clock, t=0, s=0)
        plan = decided(http, runner.clock, NOON)
        why = "no battery forms the grid behind line 2-3, which is open"
        assert the_shop(plan)["reason"] == f"blacked out: {why}"
        [alarm] = standing(http, "off_with_grid")
        assert alarm["text"] == f"shop off supply: {why}."
        [shop] = http.get("/v1/explanations").json()["reasons"]
        assert shop["words"] == f"Not supplied: {why}."
        on = {"kind": "customers", "asset": "shop", "served": True}
        until = written(NOON + HOUR)
        asked = {"mode": "manual", "reason": "test", "until": until, "setpoints": [on]}
        assert http.put("/v1/mode", asked).json()["found"] == ["Not supplied all the same: shop."]
        runner.clock.set(NOON + pd.Timedelta("1min"))
        runner.anew()
        [alarm] = standing(http, "off_with_grid")
        words = "shop behind open switches, whose supply is not planned in the mode manual."
        assert alarm["text"] == words


def test_a_switch_does_not_move_because_its_reading_is_missing(live: Live) -> None:
    """Open at 12:02, and nothing known of it from 12:03 on, by another source too."""
    http, clock = live
    read(http, clock, t=1, s=1)
    assert decided(http, clock, NOON)["switches_open"] == ["t"]
    clock.set(NOON + pd.Timedelta("5min"))
    at = {"asset": "s", "quantity": "closed", "resolution": "PT1M"}
    for source, minute, value in (("rtu", 2, 0), ("rtu", 3, None), ("scada", 4, None)):
        start = written(NOON + pd.Timedelta(minutes=minute))
        body = {"series": [{**at, "source": source, "start": start, "values": [value]}]}
        assert http.post("/v1/telemetry", body).status == 200
    assert http.get("/v1/switching").json()["read"] == {"s": False, "t": True}
    assert decided(http, clock, NOON + HOUR)["switches_open"] == ["s"]


@pytest.mark.parametrize(
    ("asset", "quantity", "value", "message", "cure"),
    [
        ("t", "closed", 2, "must be 0 or 1", "Give 1 if it is closed, else 0."),
        ("grid", "grid_on", 0.5, "must be 0 or 1", "Give 1 if there is grid, else 0."),
        ("t", "soc", 0.5, "has no soc", "Give an asset with soc. Known: big, small."),
        ("big", "closed", 1, "has no closed", "Give an asset with closed. Known: t, s."),
        ("x", "closed", 1, "is not at the site", "Give an asset with closed. Known: t, s."),
    ],
)
def test_a_reading_that_is_refused_says_what_would_do(
    live: Live, asset: str, quantity: str, value: float, message: str, cure: str
) -> None:
    one = {"source": "scada", "asset": asset, "quantity": quantity, "start": written(NOON),
           "resolution": "PT1M", "values": [value]}  # fmt: skip
    answer = live[0].post("/v1/telemetry", {"series": [one]})
    [problem] = answer.json()["problems"]
    assert (answer.status, problem["message"], problem["cure"]) == (422, message, cure)
