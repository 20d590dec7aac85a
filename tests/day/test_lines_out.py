"""Days in which lines are out: what is known of it when, who is off, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.studies.phased_feeders import in_phases
from tests.support.faulted import faulted_day
from tests.support.sets import gensets
from tests.support.three_phases import three_phases
from vppres import RunOptions, run_day
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.inversions import inversions
from vppres.day.metrics import cautions
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.io import read_scenario, write_scenario
from vppres.report.events import events_of
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario

PAPER = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
PHYSICAL = replace(PAPER, mode="physical")
NOON, HOUR = pd.Timestamp("2022-07-19T12:00Z"), pd.Timedelta(hours=1)


def with_fault(day: Scenario, **place: object) -> Scenario:
    """The day without its outage, with a fault from 12:00 to 14:00."""
    limit_kw = [float("inf")] * day.grid.n_steps
    fault = LineFault(NOON, NOON + 2 * HOUR, **place)
    return replace(day, grid_limit_kw=limit_kw, faults=(fault,))


NO_FORMER = "no battery forms the grid behind line 2-4, which is out"


def cut_off(tiny: Scenario) -> Scenario:
    """The homes cut off by a fault, with a battery that forms no grid."""
    named = replace(tiny.batteries, grid_forming=[True, False])
    return with_fault(replace(tiny, batteries=named), line=4)


def assert_homes_are_off(run: Trajectory) -> None:
    """During the fault, and then alone."""
    homes = run.customers[run.customers["id"] == "homes"]
    assert homes["served"].tolist() == [True, True, False, False, True, True]


def assert_off_for(run: Trajectory, reason: str) -> None:
    """All who are off are so by the fault, with these words."""
    off = run.explanations[run.explanations["action"] == "not_served"]
    assert set(off["driver"]) == {"fault"}
    assert set(off["words"]) == {f"Not supplied: {reason}."}


def test_a_part_without_a_former_is_dark_by_name(tiny: Scenario, tmp_path: Path) -> None:
    write_scenario(cut_off(tiny), tmp_path / "day")
    run = run_day(read_scenario(tmp_path / "day"), PAPER)
    assert_homes_are_off(run)
    homes = run.customers[run.customers["id"] == "homes"]
    assert homes["off_by_fault"].tolist() == ["", "", NO_FORMER, NO_FORMER, "", ""]
    others = run.customers[run.customers["id"] != "homes"]
    assert others["served"].all()
    assert not (others["off_by_fault"] != "").any()
    assert run.steps["lines_out"].tolist() == ["", "", "line 2-4", "line 2-4", "", ""]
    assert (run.steps["status"] == "optimal").all()


def test_a_part_with_a_former_is_an_island(tiny: Scenario) -> None:
    named = replace(tiny.batteries, grid_forming=[True] * 2, soc_initial=[0.8] * 2)
    run = run_day(with_fault(replace(tiny, batteries=named), line=2), PAPER)
    during = run.steps["lines_out"] == "line 1-2"
    assert during.sum() == 2
    assert (run.steps.loc[during, "p_grid_kw"].abs() < 1e-6).all()
    assert run.customers["served"].mean() > 0.5
    assert (run.customers["off_by_fault"] == "").all()


def test_a_lower_tier_elsewhere_is_no_inversion(tiny: Scenario) -> None:
    stores = replace(tiny.batteries, grid_forming=[True, False], soc_initial=[0.8] * 2)
    times = tiny.grid.times
    fault = LineFault(times[0], times[-1] + HOUR, line=3)
    run = run_day(replace(tiny, batteries=stores, faults=(fault,)), PAPER)
    served = run.by_step("customers", "served")[tiny.outage]
    assert not served[:, 1].any() and served[:, 2].any()  # the shop behind the line, and homes
    assert inversions(run) == []


def test_a_bus_that_is_out_is_off_though_it_has_a_battery(tiny: Scenario) -> None:
    named = replace(tiny.batteries, grid_forming=[True] * 2, soc_initial=[0.8] * 2)
    run = run_day(with_fault(replace(tiny, batteries=named), bus=4), PAPER)
    homes = run.customers[run.customers["id"] == "homes"]
    assert homes["off_by_fault"].tolist() == ["", "", "bus 4 is out", "bus 4 is out", "", ""]
    assert not homes["served"].iloc[2:4].any()


def test_plans_keep_energy_for_a_fault_that_they_know(tiny: Scenario) -> None:
    named = replace(tiny.batteries, grid_forming=[True] * 2)
    flat = np.full(tiny.grid.n_steps, 0.3)  # energy is bought ahead for nothing else
    day = with_fault(replace(tiny, batteries=named, price_gbp_per_kwh=flat), line=2)
    known = run_day(day, PAPER)
    unknown = run_day(replace(day, faults=(replace(day.faults[0], known=False),)), PAPER)
    held = [run.by_step("batteries", "soc_start")[2].sum() for run in (known, unknown)]
    assert held[0] > held[1] + 0.05
    served = [run.customers["served"].sum() for run in (known, unknown)]
    assert served[0] > served[1]


def test_a_part_with_phases_is_dark_by_name(tiny: Scenario) -> None:
    run = run_day(three_phases(cut_off(tiny)), PHYSICAL)
    assert_homes_are_off(run)
    homes = run.customers[run.customers["id"] == "homes"]
    assert set(homes["off_by_fault"][2:4]) == {NO_FORMER}
    dark = run.nodes["v_ac_pu"].isna()
    assert set(run.nodes["bus"][dark]) == {"4"} and dark.sum() == 2 * 3


def known(day: Scenario) -> Scenario:
    """The day in physical mode whose faults are known, with inverters that limit nothing."""
    wide = replace(day.batteries, s_max_kva=np.full(len(day.batteries), 600.0))
    faults = tuple(replace(fault, known=True) for fault in day.faults)
    return replace(day, faults=faults, batteries=wide)


@pytest.mark.daily
@pytest.mark.parametrize("seed", range(12))
def test_three_equal_phases_go_through_faults_as_one(seed: int) -> None:
    day = known(faulted_day(seed, steps=3))
    one, three = (run_day(each, PHYSICAL) for each in (day, three_phases(day)))
    for column in ("served", "off_by_fault"):
        assert one.customers[column].tolist() == three.customers[column].tolist()
    assert three.steps["objective"].to_numpy() == pytest.approx(one.steps["objective"], abs=2e-3)
    assert three.steps["island_mismatch_kw"].abs().max() < 0.1


@pytest.mark.daily
@pytest.mark.parametrize("seed", range(12))
def test_each_part_of_an_unbalanced_feeder_has_its_own_former(seed: int) -> None:
    """Nobody is shed that a plan knows as supplied, in the first step by rule, then by plans."""
    day = in_phases(faulted_day(seed), np.random.default_rng([seed, 62]))
    faults = tuple(replace(fault, known=True) for fault in day.faults)
    outage = FaultPlan({0: SolverOutage("killed")})
    run = explain_day(run_day(replace(day, faults=faults), PHYSICAL, faults=outage))
    assert run.steps["fallback"].tolist() == ["rule", "none", "none", "none"]
    assert not run.customers["shed"].any()
    out = run.steps["lines_out"].ne("")
    assert out.any()
    assert run.steps["island_mismatch_kw"][out].abs().max() < 0.1
    assert run.steps["v_error_pu"][1:].max() < 2e-4
    most_kva = float(day.batteries.s_max_kva.max()) / 3.0
    kva = run.steps[["former_a_kva", "former_b_kva", "former_c_kva"]].to_numpy(float)
    assert np.nanmax(kva, initial=0.0) <= most_kva + 1e-3
    off = run.explanations[run.explanations["action"] == "not_served"]
    planned = run.by_step("customers", "off_by_fault")[1:]
    assert (off["driver"] == "fault").sum() >= (planned != "").sum()


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(30))
def test_plans_of_physical_mode_agree_with_ac_in_each_part(seed: int) -> None:
    """A former gives nothing beyond its plan, and who is planned is on, but for what is unknown."""
    day = faulted_day(seed, steps=3)
    known = replace(day, faults=tuple(replace(fault, known=True) for fault in day.faults))
    run = run_day(known, PHYSICAL)
    assert set(run.steps["fallback"]) == {"none"}
    assert run.steps["shed_kw"].max() == 0.0
    assert run.steps["island_mismatch_kw"].abs().max() < 0.1
    errors = run.steps.loc[run.steps["lines_out"] != "", "v_error_pu"]
    assert errors.max() < 2e-4


def test_words_name_the_fault(tiny: Scenario) -> None:
    run = explain_day(run_day(cut_off(tiny), PAPER))
    assert_off_for(run, NO_FORMER)
    assert f"Blacked out for 2 customer hours: {NO_FORMER}." in cautions(run)
    events = [(event.t, event.words) for event in events_of(run)]
    assert (2, "Line 2-4 out of service.") in events
    assert (4, "Line 2-4 in service again.") in events


def test_each_part_has_a_set_that_forms_its_grid(tiny: Scenario) -> None:
    """Lines 1-2 and 2-4 are out: one set behind each, no battery that could."""
    sets = gensets(2, bus=[2, 4], p_min_kw=0.0, grid_forming=True)
    empty = replace(tiny.batteries, soc_initial=tiny.batteries.soc_min, grid_forming=[False] * 2)
    day = with_fault(replace(tiny, gensets=sets, batteries=empty), line=4)
    [fault] = day.faults
    run = run_day(replace(day, faults=(fault, replace(fault, line=2))), PHYSICAL)
    forms = run.gensets.pivot(index="time", columns="genset", values="forms").to_numpy(bool)
    assert forms.tolist() == [[2 <= t < 4] * 2 for t in range(6)]
    lit = run.buses.pivot(index="time", columns="bus", values="v_ac_pu").notna()
    assert lit.to_numpy().all()


def test_a_part_beside_the_grid_is_explained_as_an_island(tiny: Scenario) -> None:
    """The price, export and voltage of the part with the grid are none of its own."""
    run = explain_day(run_day(with_fault(tiny, line=4), PHYSICAL))
    told = run.explanations
    during = told[told["time"].isin(run.steps["time"][2:4])]
    steps = during[during["item"] == "step"]
    assert set(steps["driver"]) == {"fault"}
    assert steps["words"].str.endswith("Lines that are out or open cut off the others.").all()
    small = during[during["id"] == "small"]
    assert set(small["words"]) == {"Charges: PV exceeds the supplied demand."}
    field = during[during["action"] == "curtail"]
    why = "more in the batteries has no use in the plan"
    assert field["words"].iloc[0] == f"Curtailed: PV exceeds the supplied demand, {why}."


def test_events_have_the_names_of_buses_as_they_are(tiny: Scenario) -> None:
    """Capitals stay, and a name with "and" in it is one name."""
    names = {bus: f"Mill and Son {bus}" for bus in (1, 2, 3, 4)}
    net = tiny.network
    ends = {side: [names[bus] for bus in getattr(net, side)] for side in ("from_bus", "to_bus")}
    named = {
        table: replace(assets, bus=[names[bus] for bus in assets.bus])
        for table in ("customers", "batteries")
        if (assets := getattr(tiny, table))
    }
    network = replace(net, **ends, slack_bus=names[net.slack_bus])
    run = run_day(with_fault(replace(tiny, network=network, **named), line=names[4]), PAPER)
    words = [event.words for event in events_of(run)]
    line = "Line Mill and Son 2-Mill and Son 4"
    assert {f"{line} out of service.", f"{line} in service again."} < {*words}


def test_a_part_that_has_too_little_is_named(tiny: Scenario) -> None:
    """Battery and PV power of the homes carry less than their demand."""
    named = replace(tiny.batteries, grid_forming=[True] * 2, p_max_kw=[50.0, 5.0])
    run = explain_day(run_day(with_fault(replace(tiny, batteries=named), line=4), PAPER))
    words = "the part behind line 2-4, which is out, has too little power or energy"
    assert_off_for(run, words)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_fallbacks_keep_the_balance_of_each_part(seed: int, known: bool) -> None:
    """By the rule from the first step on, or by the plan of the step before."""
    day = faulted_day(seed)
    begun = 0 if known else 1
    outage = FaultPlan({t: SolverOutage("killed") for t in range(begun, day.grid.n_steps)})
    run = run_day(day, PAPER, faults=outage)
    assert set(run.steps["fallback"][begun:]) <= {"rule", "previous_plan"}
    out = run.steps["lines_out"].ne("").to_numpy()
    assert out.any()
    assert not run.customers["shed"].any()
    # The paper's plans have no losses: these are what formers give beyond their set-points.
    assert run.steps["island_mismatch_kw"][out].abs().max() < 1.0
    off = run.customers[run.customers["off_by_fault"] != ""]
    assert not off["served"].any()


@pytest.mark.parametrize("kind", ["idle", "reserve"])
def test_baselines_know_the_parts(tiny: Scenario, kind: str) -> None:
    run = run_day(cut_off(tiny), replace(PAPER, controller=kind))
    assert set(run.steps["fallback"]) == {"none"}
    assert_homes_are_off(run)
