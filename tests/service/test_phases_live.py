"""Phased feeders live: decisions of the run, readings and set-points by phase."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.builders import metered
from tests.support.live_service import HERE, client, readings
from tests.support.phased_feeder import CIRCUIT, day_of
from tests.support.played_service import played
from tests.support.sets import gensets
from tests.support.three_phases import three_phases
from vppres.control.guard.guard import GuardedController
from vppres.core.errors import SolveError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.scenario.earthing import unearthed
from vppres.scenario.phases import Phases
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.http.serve import opened
from vppres.service.operation.site import Service
from vppres.service.overview import site_of
from vppres.service.payloads import Readings
from vppres.service.plans.world import World
from vppres.service.simulate import Play
from vppres.service.telemetry.knowledge import readings_of

pytest.importorskip("opendssdirect")

OPTIONS = RunOptions(horizon_h=0.0, isolate=False)


@pytest.fixture(scope="module")
def day(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """A day of a small unbalanced feeder, its batteries full."""
    day = day_of(CIRCUIT, tmp_path_factory.mktemp("live"))
    full = replace(day.batteries, soc_initial=day.batteries.soc_max)
    return replace(day, batteries=full)


@pytest.fixture(scope="module")
def evening(day: Scenario) -> Scenario:
    """Two steps of its island, and the grid's return."""
    return day.between(16, 19)


@pytest.mark.daily
def test_a_live_controller_decides_as_the_run_does(evening: Scenario) -> None:
    run = run_day(evening, OPTIONS)
    controller = Controller.of(evening, OPTIONS)
    soc = dict(zip(evening.batteries.id, evening.batteries.soc_initial, strict=True))
    steps = run.steps
    for t, time in enumerate(controller.times):
        points = controller.step(Measurement(time, soc=soc))
        soc = points.batteries["soc_end"].to_dict()
        of_run = run.batteries[run.batteries["time"] == time]
        assert (points.batteries["soc_end"].to_numpy() == of_run["soc_end"].to_numpy()).all()
        by_phase = points.by_phase
        assert by_phase is not None
        column = "import" if by_phase.source == "grid" else "former"
        for phase, kva in by_phase.source_kva.items():
            assert kva == steps[f"{column}_{phase}_kva"].iloc[t]
        state = json.loads(json.dumps(controller.state()))
        controller = Controller.of(evening, OPTIONS, state=state)
    assert points.batteries["phases"]["bbc"] == "bc"
    assert points.customers["phases"]["ce"] == "a b c"


@pytest.mark.nightly
def test_strict_order_gives_up_headroom_of_phases_for_the_first_tier(evening: Scenario) -> None:
    of_first = evening.customers.id == "cbc"
    tier = np.where(of_first, "critical", "low").astype(object)
    customers = replace(evening.customers, tier=tier)
    load_kw = evening.load_kw * np.where(of_first, 2.15, 1.0)
    step = replace(evening, customers=customers, load_kw=load_kw).between(1, 2)
    run = run_day(step, replace(OPTIONS, priority="strict"))
    kva = run.steps[[f"former_{p}_kva" for p in "abc"]].to_numpy(float).max()
    third = float(step.batteries.s_max_kva[step.batteries.grid_forming][0]) / 3.0
    assert run.customers.set_index("id")["served"]["cbc"]
    assert 0.9 * third < kva <= third
    assert run.steps["levels"].iloc[0].startswith("critical 1/1")


def test_a_set_that_forms_an_island_is_read_by_phase(tiny: Scenario) -> None:
    sets = gensets(p_max_kw=400.0, p_min_kw=0.0, grid_forming=True, power_factor=0.8)
    day = three_phases(replace(tiny, gensets=sets))
    dark = int(np.argmax(day.outage))
    world = World(day, replace(OPTIONS, mode="physical"))
    record = world.obey(dark, [])
    series = [one for one in world.readings(dark + 1) if one["quantity"] == "source_kva"]
    told = {(one["source"], one["asset"], one["phase"]): one["values"] for one in series}
    kva = {("gensets", "g0", phase): [record.steps[f"former_{phase}_kva"]] for phase in "abc"}
    assert record.steps["former"] == "g0" and told == kva
    batch = [Readings.model_validate(one) for one in series]
    kept, refused = readings_of(batch, day, day.grid.times[-1])
    assert len(kept) == 3 and not refused


@pytest.mark.daily
def test_a_service_hears_and_orders_by_phase(
    day: Scenario, evening: Scenario, tmp_path: Path
) -> None:
    start = evening.grid.start
    player = played(Service(day, OPTIONS), evening, tmp_path, Play(), SetClock(start))
    assert player.tally.statuses == {"ok": 3}
    assert player.tally.refused == 0 and player.tally.estimated == 0
    with opened(Service(day, OPTIONS), tmp_path, SetClock(start)) as runner:
        site = site_of(runner)
        plan = runner.store.step(start)
        assert plan
        told = {one["asset"]: one["phases"] for one in plan["setpoints"]}
        assert told == site["phases"] and told["ba"] == "a"
        check_expected(plan, evening, player.world.records[0].steps)
        later = start + evening.grid.step
        found = runner.store.between(start, later, ["load_kw", "load_kw/bc", "source_kva/c"])
        kept = {(one.asset, one.quantity): one.value for one in found}
        assert kept["cbc", "load_kw"] == kept["cbc", "load_kw/bc"] == evening.load_kw[0][2]
        assert kept["ce", "load_kw"] == pytest.approx(evening.load_kw[0][3])
        assert kept["be", "source_kva/c"] == player.world.records[0].steps["former_c_kva"]


def check_expected(plan: Any, evening: Scenario, lived: Any) -> None:
    """What a plan expects of the phases is what the plant then does, within a third of a rating."""
    expected = plan["expected"]["phases"]
    kva = expected["source_kva"]
    former = evening.batteries.grid_forming
    assert expected["source"] == evening.batteries.id[former][0]
    assert expected["rating_kva"] == evening.batteries.s_max_kva[former][0] / 3
    assert kva == pytest.approx({p: lived[f"former_{p}_kva"] for p in "abc"})
    nearest = expected["nearest"]
    share = max(kva.values()) / expected["rating_kva"]
    assert nearest["share"] >= share
    assert min(low for low, _ in expected["v_pu"].values()) >= 0.94
    assert list(expected["v_pu"])[:3] == ["a", "b", "c"]


@pytest.mark.parametrize("by_rule", [False, True])
def test_a_meter_in_watts_puts_nobody_off_with_grid(
    day: Scenario, by_rule: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From its first reading on, by the plan and where the rule decides."""

    def fails(*_: Any) -> None:
        raise SolveError("no answer")

    if by_rule:
        monkeypatch.setattr(GuardedController, "_inner_decision", fails)
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    hours = [(1000.0 * float(kw), None) for kw in day.load_kw[:2, 2]]
    for found in metered(day, hours, "cbc", soc):
        assert found.customers["served"].all()
        assert found.solve["fallback"] == ("rule" if by_rule else "none")
        assert "load cbc" in found.solve["estimated"]


@pytest.mark.parametrize(("sent", "words"), [
    ([("ca", "load_kw", "b")], "is no phase of it"),
    ([("ba", "soc", "a")], "Leave the phase out."),
    ([("m", "v_pu", None)], "is no phase of it"),
    ([("ce", "load_kw", "a"), ("ce", "load_kw", "b")], "lacks phase c"),
    ([("ce", "load_kw", "a"), ("ce", "load_kw", "b"), ("ce", "load_kw", "c")], ""),
    ([("d", "v_pu", "ab"), ("be", "source_kva", "c")], ""),
])  # fmt: skip
def test_phases_of_readings(evening: Scenario, sent: Any, words: str) -> None:
    batch = [reading(*one) for one in sent]
    good, problems = readings_of(batch, evening, evening.grid.end)
    found = "; ".join(f"{one.problem.message} {one.problem.cure}" for one in problems)
    assert (words in found) if words else not problems
    if len(sent) == 3:
        assert [one.value for one in good if one.quantity == "load_kw"] == [30.0]


def test_phases_that_are_refused_change_nothing(evening: Scenario, tmp_path: Path) -> None:
    """A phase alone is none of the reading that came before, and no reading itself."""
    time = evening.grid.start
    service = Service(evening, replace(HERE, mode="physical"), rehearsal=True)
    with client(service, tmp_path, SetClock(time)) as http:

        def sent(**kw: float) -> Any:
            series = [
                {**one, "phase": phase}
                for phase, value in kw.items()
                for one in readings(time, "load_kw", {"ce": value})
            ]
            return http.post("/v1/telemetry", {"series": series})

        assert sent(a=10.0, b=11.0, c=12.0).json()["accepted"] == 4
        assert sent(a=30.0).status == 422
        answer = sent(a=-1.0, b=30.0, c=30.0)
        assert answer.status == 422
        assert answer.json()["problems"][1]["message"] == "lacks phase a"
        assert sent(a=10.0, b=11.0, c=12.0).json()["duplicates"] == 4


def test_a_power_that_is_not_the_sum_of_its_phases_is_named(evening: Scenario) -> None:
    by_phase = [reading("ce", "load_kw", phase) for phase in "abc"]
    alone = reading("ce", "load_kw", None)
    good, problems = readings_of([alone, *by_phase], evening, evening.grid.end)
    assert [one.problem.message for one in problems] == ["is not the sum of its phases, 30 kW"]
    assert [one.value for one in good] == [10.0, 10.0, 10.0, 30.0]
    whole = alone.model_copy(update={"values": [30.4]})  # by meters
    assert not readings_of([whole, *by_phase], evening, evening.grid.end)[1]


def test_what_earths_an_island_is_reckoned_once_for_all_readings(
    evening: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is a system of equations of the whole feeder."""
    reckoned = []

    def counted(phases: Phases, *given: Any, **named: Any) -> set[str]:
        reckoned.append(phases)
        return unearthed(phases, *given, **named)

    monkeypatch.setattr("vppres.scenario.earthing.unearthed", counted)
    batch = [reading(bus, "v_pu", phase) for bus, phase in evening.phases.measured] * 2
    good, refused = readings_of(batch, evening, evening.grid.end)
    assert len(good) == len(batch) > 20 and not refused
    assert len(reckoned) <= 1


def reading(asset: str, quantity: str, phase: str | None) -> Readings:
    """A reading of 10 kW, 10 kVA, or 1 pu."""
    value = 1.0 if quantity in ("v_pu", "soc") else 10.0
    return Readings(
        source="scada",
        asset=asset,
        quantity=quantity,  # type: ignore[arg-type]
        phase=phase,
        start="2025-07-01T16:00:00Z",  # type: ignore[arg-type]
        resolution="PT1H",  # type: ignore[arg-type]
        values=[value],
    )
