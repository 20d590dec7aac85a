"""Switches of a service: the page, a kill, what is not known by phase; more in ``sequences/switching.txt``."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
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
from vppres.scenario.phases import Phases
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service

HOUR = pd.Timedelta(hours=1)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    clock = SetClock(NOON)
    with asked(Service(switched(), HERE, paced=True), tmp_path / "db", clock) as http:
        yield http, clock


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
