"""Generating sets that form the grid of an island: known answers, and the plant beside the plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.sets import gensets, random_sets
from tests.support.small_windows import DARK, OPEN, battery, two_buses, with_pv
from vppres import RunOptions, load_scenario, run_day, write_scenario
from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.converged import dark_steps, physics_of, without_power
from vppres.control.forming import formed_by_set, headroom_kw
from vppres.control.step_state import one_step
from vppres.core.errors import NumericalError
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.trajectory import Trajectory
from vppres.kinds.gensets.data import Gensets, GensetState, Refuels
from vppres.kinds.gensets.physics import SetsAhead
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.beyond_paper.losses import lossless
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.plant.island import SET_NO_BALANCE
from vppres.scenario.remarks import ONE_FORMER, darkness, former_words
from vppres.scenario.scenario import Scenario
from vppres.service.gate import refusals
from vppres.service.plans import tables_of

PHYSICAL = RunOptions(isolate=False, mode="physical", horizon_h=4.0)
INDUCTIVE = 0.9


def hospital(*load_kw: float, **more: Any) -> Scenario:
    """An outage between two steps with grid, and a set of 100 kW that forms the grid."""
    limits = [OPEN] + [DARK] * (len(load_kw) - 2) + [OPEN]
    day = two_buses([[kw] for kw in load_kw], [10.0], limits, r_ohm=0.05)
    factors = np.full(1, INDUCTIVE)
    day = replace(day, customers=replace(day.customers, power_factor=factors))
    return replace(day, gensets=gensets(grid_forming=True, **more))


def served(run: Trajectory) -> list[int]:
    """Whether the customer is on in each step."""
    return run.customers["served"].astype(int).tolist()


def test_a_set_forms_an_island_and_gives_its_losses_and_reactive_power() -> None:
    day = hospital(50.0, 50.0, 80.0, 50.0, 50.0, bus=[1])
    run = run_day(day, PHYSICAL)
    sets, steps = run.gensets, run.steps
    assert sets is not None and served(run) == [1] * 5 and not steps["dark"].any()
    assert sets["forms"].tolist() == [False, True, True, True, False]
    island = sets["forms"].to_numpy(bool)
    loads = run.customers.loc[island]
    given = sets.loc[island]
    assert (given["p_kw"].to_numpy() - loads["p_load_kw"].to_numpy()) == pytest.approx(
        steps.loc[island, "losses_kw"].to_numpy(), abs=1e-6
    )
    assert (given["q_kvar"].to_numpy() >= loads["q_load_kvar"].to_numpy()).all()
    assert (steps.loc[island, ["p_grid_kw", "q_grid_kvar"]] == 0.0).all(axis=None)
    assert steps["island_mismatch_kw"].abs().max() < 1e-2


def test_fuel_ends_and_the_island_with_it() -> None:
    """60 l are two steps at 50 kW and not a third at the least power with its headroom."""
    run = run_day(hospital(*[50.0] * 6, fuel_level_litres=60.0), PHYSICAL)
    assert served(run) == [1, 1, 1, 0, 0, 1]
    assert (run.steps["dark_reason"] != "").tolist() == [False] * 3 + [True] * 2 + [False]
    assert run.steps["status"].tolist()[3:5] == ["blacked_out"] * 2


def test_a_delivery_lights_the_island_again() -> None:
    day = hospital(*[50.0] * 6, fuel_level_litres=25.0)
    day = replace(day, refuels=Refuels(["g0"], [day.grid.times[3]], [60.0]))
    assert served(run_day(day, PHYSICAL)) == [1, 1, 0, 1, 1, 1]


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({"p_min_kw": 80.0}, [1, 0, 0, 0, 1]),  # nothing takes its least power
        ({"on_before_h": -0.5, "min_off_h": 2.0}, [1, 0, 1, 1, 1]),  # it has to rest
        ({"fuel_level_litres": 45.0, "min_on_h": 5.0}, [1, 1, 1, 0, 1]),  # fuel ends its least time
        ({"power_factor": 1.0}, [1, 0, 0, 0, 1]),  # no reactive power for the customer
    ],
)
def test_a_set_forms_no_island_that_it_cannot_hold(
    more: dict[str, Any], expected: list[int]
) -> None:
    assert served(run_day(hospital(*[50.0] * 5, **more), PHYSICAL)) == expected


def test_headroom_is_left_above_and_below() -> None:
    """A tenth of the rating: no 91 kW of 100 kW, and no 35 kW above the least 30 kW."""
    assert served(run_day(hospital(50.0, 91.0, 50.0), PHYSICAL)) == [1, 0, 1]
    assert served(run_day(hospital(50.0, 35.0, 50.0), PHYSICAL)) == [1, 0, 1]
    assert served(run_day(hospital(50.0, 89.0, 50.0), PHYSICAL)) == [1, 1, 1]
    assert headroom_kw(gensets(p_min_kw=80.0), 0.1) == pytest.approx([5.0])


def test_a_named_battery_comes_before_a_set_and_a_set_before_an_unnamed_one() -> None:
    b = battery(200.0, 100.0, 100.0)
    day = replace(hospital(*[50.0] * 4), batteries=b)
    named = replace(day, batteries=replace(b, grid_forming=[True]))
    assert run_day(named, PHYSICAL).gensets["forms"].sum() == 0  # type: ignore[index]
    assert run_day(day, PHYSICAL).gensets["forms"].sum() == 2  # type: ignore[index]
    empty = replace(named, batteries=replace(named.batteries, soc_initial=b.soc_min))
    empty = replace(empty, grid_limit_kw=np.array([DARK, DARK, DARK, OPEN]))
    run = run_day(empty, PHYSICAL)
    assert served(run) == [1] * 4 and run.gensets["forms"].iloc[0]  # type: ignore[index]


class Idle:
    """Serves everyone and runs no set."""

    def __init__(self, site: Site) -> None:
        self.site = site

    def horizon_steps(self, t0: int) -> range:
        return range(t0, t0 + 1)

    def decide(self, observation: Observation) -> Decision:
        nothing = np.zeros(0)
        buses, lines = self.site.network.n_buses, self.site.network.n_lines
        return Decision(
            one_step(
                served=np.ones(1, dtype=bool),
                **dict.fromkeys(("pv_self_kw", "pv_export_kw", "pv_curtailed_kw"), nothing),
                **dict.fromkeys(("charge_kw", "discharge_kw", "batt_q_kvar", "pv_q_kvar"), nothing),
                soc=np.zeros((2, 0)),
                p_grid_kw=0.0,
                q_grid_kvar=0.0,
                v_pu=np.ones(buses),
                p_flow_kw=np.zeros(lines),
                q_flow_kvar=np.zeros(lines),
            )
        )


def test_a_set_starts_by_itself_where_nothing_else_forms_the_grid() -> None:
    """It gives what the customer takes, which no plan asked it for."""
    options = replace(PHYSICAL, guard=False)
    run = run_day(hospital(50.0, 50.0, 120.0, 50.0), options, controller=Idle)
    assert run.gensets is not None and served(run) == [1, 1, 0, 1]
    assert run.gensets["p_kw"].iloc[1] == pytest.approx(50.0, abs=0.1)
    assert run.steps["island_mismatch_kw"].iloc[1] == pytest.approx(50.0, abs=0.1)
    assert run.steps["dark_reason"].iloc[2] == SET_NO_BALANCE  # nothing is left for its least power


class Broken(Idle):
    """Has no answer."""

    def decide(self, observation: Observation) -> Decision:
        raise NumericalError("out of order")


def test_a_fallback_by_rule_starts_the_set_that_forms_the_grid() -> None:
    """Not while there is grid, and not for 20 kW, which are less than its least power."""
    run = run_day(hospital(50.0, 50.0, 120.0, 20.0, 50.0, bus=[1]), PHYSICAL, controller=Broken)
    assert (run.steps["fallback"] == "rule").all()
    assert run.gensets is not None and served(run) == [1, 1, 0, 0, 1]
    assert run.gensets["running"].astype(int).tolist() == [0, 1, 0, 0, 0]
    assert run.gensets["p_kw"].iloc[1] == pytest.approx(50.0, abs=0.1)
    assert run.steps["shed_kw"].sum() == 0.0


def test_by_rule_the_set_supplies_the_first_tier_first() -> None:
    """60 kW of each of two tiers: the set of 100 kW supplies one, at 60 kW."""
    day = two_buses([[60.0, 60.0]] * 2, [1.0, 10.0], [DARK, OPEN], r_ohm=0.05)
    tiers = replace(day.customers, tier=["low", "critical"])
    day = replace(day, customers=tiers, gensets=gensets(grid_forming=True))
    run = run_day(day, PHYSICAL, controller=Broken)
    first = run.customers["served"].to_numpy(int)[:2]
    assert first.tolist() == [0, 1] and run.gensets is not None
    assert run.gensets["p_kw"].iloc[0] == pytest.approx(60.0, abs=0.1)


def test_by_rule_a_battery_with_energy_forms_the_grid_and_no_set_starts() -> None:
    b = replace(battery(200.0, 100.0, 100.0), grid_forming=[True], soc_initial=[0.85])
    run = run_day(replace(hospital(*[50.0] * 4), batteries=b), PHYSICAL, controller=Broken)
    assert served(run) == [1] * 4 and run.gensets is not None and not run.gensets["running"].any()


def test_the_guard_refuses_supply_in_an_island_that_no_set_forms() -> None:
    run = run_day(hospital(50.0, 50.0, 50.0), PHYSICAL, controller=Idle)
    reason = run.steps["fallback_reason"].iloc[1]
    assert "balance" in reason and "island: no set forms the grid" in reason
    assert served(run) == [1] * 3


def test_by_rule_an_island_that_nothing_can_form_has_no_supply() -> None:
    """The customer's own PV power is enough for it, but gives no voltage."""
    day = with_pv(hospital(*[50.0] * 4), [80.0] * 4)
    day = replace(day, gensets=Gensets())
    run = run_day(day, PHYSICAL, controller=Broken)
    assert (run.steps["fallback"] == "rule").all()
    assert served(run) == [1, 0, 0, 1]
    assert run.steps["shed_kw"].sum() == 0.0
    assert run.pv["curtailed_kw"].tolist()[1:3] == [80.0, 80.0]


def windows(seed: int) -> tuple[Site, WindowData]:
    """A random window without battery that forms the grid, and with sets that do."""
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 47])
    sets = random_sets(rng, scenario)
    forming = rng.random(len(sets)) < 0.7
    forming[0] = True
    outage = np.arange(data.n_steps) >= rng.integers(0, 2)
    day = replace(scenario, gensets=replace(sets, grid_forming=forming))
    limits = np.where(outage, 0.0, data.grid_limit_kw)
    steps = range(data.n_steps)
    seen = SetsAhead.of(day, steps, GensetState.at_first(day.gensets))
    data = replace(data, grid_limit_kw=limits, ahead=KindsAhead({"gensets": seen}))
    site = Site.of(day)
    data, dark = formed_by_set(site, data, dark_steps(site, data), 0.1)
    lit = without_power(data, dark)
    return site, lossless(lit, physics_of(site, lit, 0.1))


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(50))
def test_methods_agree_on_random_windows(seed: int) -> None:
    assert_methods_agree(*windows(seed), always=False)


def test_most_random_windows_are_lit_by_a_set() -> None:
    """The fifty windows above say something."""
    formed = [windows(seed)[1].ahead.find(SetsAhead) for seed in range(50)]
    lit = [sets is not None and bool(sets.forms.any()) for sets in formed]
    assert sum(lit) >= 35


def test_the_duty_is_written_read_and_told(tmp_path: Path) -> None:
    day = hospital(50.0, 50.0, 50.0, power_factor=0.9)
    write_scenario(day, tmp_path / "day")
    read = load_scenario(tmp_path / "day").gensets
    assert read.grid_forming.tolist() == [True] and read.power_factor.tolist() == [0.9]
    assert former_words(day, "physical") == (
        "The island is formed by generating set g0 at bus 2 (100 kW), as long as it has fuel. "
        + ONE_FORMER
    )
    assert darkness(day, "physical") == ""
    empty = replace(day, gensets=replace(day.gensets, fuel_level_litres=[1.0]))
    assert darkness(empty, "physical").startswith(
        "No battery can form a grid, and no generating set with this duty has fuel for a step"
    )


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_a_set_that_forms_the_grid_follows_the_load_beyond_its_ramps(method: str) -> None:
    day = hospital(50.0, 80.0, 20.0, 80.0, 50.0, bus=[1], ramp_up_kw_per_h=5.0, p_min_kw=10.0)
    run = run_day(day, replace(PHYSICAL, method=method))
    assert served(run) == [1] * 5
    assert set(run.steps["status"]) == {"optimal"}


def test_no_door_limits_the_ramps_of_a_set_that_forms_the_grid() -> None:
    """Live decisions, the rule and the last check of set-points know none either."""
    loads_kw = (50.0, 80.0, 20.0, 80.0, 50.0)
    day = hospital(*loads_kw, bus=[1], ramp_up_kw_per_h=5.0, ramp_down_kw_per_h=5.0, p_min_kw=10.0)
    controller = Controller.of(day, PHYSICAL)
    for t in (1, 2, 3):
        step = controller.step(Measurement(day.grid.times[t]))
        assert step.gensets is not None and step.customers["served"].all()
        assert step.solve["fallback"] == "none"
        assert step.gensets["p_kw"].iloc[0] == pytest.approx(loads_kw[t], abs=0.5)
        assert refusals(tables_of(step, day), day, {}) == {}
    killed = FaultPlan({t: SolverOutage("killed") for t in range(5)})
    ruled = run_day(day, PHYSICAL, faults=killed)
    assert served(ruled) == [1] * 5 and set(ruled.steps["fallback"]) == {"rule"}
