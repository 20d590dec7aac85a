"""Faults of lines in the service; how they are reported is in ``sequences/faults.txt``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

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


def test_a_step_by_rule_knows_the_parts(live: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    http, clock, _ = live
    http.put("/v1/events/feeder-b", FAULT)
    monkeypatch.setattr(Controller, "step", lambda *_: 1 / 0)
    plan = decided(http, clock, NOON + HOUR)
    assert plan["status"] == "failed"
    assert set(off(plan)) == {"homes"}
    assert [one["name"] for one in plan["faults"]] == ["line 2-4"]


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
