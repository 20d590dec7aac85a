"""Generating sets: known answers, plant and plan; and sets that form the grid of an island."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.builders import known, planned_kw, solved
from tests.support.faulted import faulted_day, faulted_window
from tests.support.rated_windows import formed_by_sets
from tests.support.sets import ahead, gensets, random_sets
from tests.support.small_windows import DARK, OPEN, battery, two_buses, with_pv
from vppres import RunOptions, load_scenario, run_day, write_scenario
from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.core.errors import NumericalError
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.trajectory import Trajectory
from vppres.kinds.gensets import Gensets, Refuels
from vppres.kinds.gensets.physics import Engines, headroom_kw, moved_too_fast_kw
from vppres.kinds.kind import UnitPlan
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.data import WindowData
from vppres.model.numerics import objective_scale
from vppres.model.parts import at_items
from vppres.model.site import Site
from vppres.plant.island import SET_NO_BALANCE
from vppres.scenario.faults import LineFault
from vppres.scenario.remarks import ONE_FORMER, darkness, former_words
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.plans.document import tables_of
from vppres.service.plans.gate import refusals
from vppres.solve.cache import shared_cache
from vppres.solve.forms import Form, window_problem
from vppres.solve.ladder import METHODS
from vppres.solve.solvers import find_solver, run, run_conic

HALF_AN_HOUR = pd.Timedelta(minutes=30)


def plants(*cost: float, **more: Any) -> Gensets:
    """Power stations that have no tank to speak of and cost so much per MWh."""
    return gensets(
        len(cost),
        **{
            "fuel_price_gbp_per_litre": np.array(cost),
            "litres_per_kwh": 1.0,
            "litres_per_h_idle": 0.0,
            "tank_litres": 1e6,
            "fuel_level_litres": 1e6,
            "only_in_outage": False,
        }
        | more,
    )


def island(load_kw: list[float], sets: Gensets, steps_h: float = 1.0) -> Scenario:
    """One customer without grid."""
    steps = len(load_kw)
    day = two_buses([[kw] for kw in load_kw], [1.0], [DARK] * steps, r_ohm=1e-6)
    grid = TimeGrid(day.grid.start, 60.0 * steps_h, steps)
    return replace(day, grid=grid, gensets=sets)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("sets", "cost"), [
    (plants(20.0, 70.0, p_max_kw=[10e3, 1e3], p_min_kw=[3e3, 100.0]), 356_000.0),
    (plants(20.0, 70.0, p_max_kw=[10e3, 1e3], p_min_kw=[1e3, 0.0], start_cost_gbp=[3000.0, 1000.0],
        on_before_h=[-9.0, 9.0]), 359_000.0),
])  # fmt: skip
def test_unit_commitment_costs_what_is_published(method: str, sets: Gensets, cost: float) -> None:
    """Coal, coal, coal, gas."""
    answer = solved(island([4000.0, 6000.0, 5000.0, 800.0], sets), method)
    assert answer.dispatch.served.all()
    assert answer.terms.f2 == pytest.approx(cost, abs=1.0)


@pytest.mark.parametrize("method", METHODS)
def test_least_times_on_and_off_as_published(method: str) -> None:
    more: dict[str, Any] = {"p_max_kw": [10e3, 1e3], "p_min_kw": [1e3, 100.0]}
    day = island([4000.0, 800.0, 5000.0, 3000.0], plants(20.0, 70.0, min_on_h=[0.0, 3.0], **more))
    expected = [[3900.0, 100.0], [0.0, 800.0], [4900.0, 100.0], [3000.0, 0.0]]
    assert -planned_kw(day, method) == pytest.approx(np.array(expected), abs=1e-2)
    more = {"p_max_kw": [10e3, 4e3], "p_min_kw": [3e3, 100.0], "on_before_h": [-1.0, -1.0]}
    day = island([3000.0, 800.0, 3000.0, 8000.0], plants(20.0, 70.0, min_off_h=[2.0, 0.0], **more))
    expected = [[0.0, 3000.0], [0.0, 800.0], [3000.0, 0.0], [8000.0, 0.0]]
    assert -planned_kw(day, method) == pytest.approx(np.array(expected), abs=1e-2)


REOPT = {"litres_per_kwh": 0.2889, "litres_per_h_idle": 0.0}
"""REopt's default, an efficiency of 0.322 at any load: 200 l are 692 kWh."""


@pytest.mark.parametrize(
    ("power_kw", "line", "hours"),
    [(100.0, {}, 6.06), (50.0, {}, 9.66), (30.0, {}, 12.66), (100.0, REOPT, 6.92)],
)
def test_a_tank_lasts_for_known_hours(
    power_kw: float, line: dict[str, float], hours: float
) -> None:
    day = island([power_kw] * 1300, gensets(**line), steps_h=0.01)
    engines = Engines(day)
    done = 0
    while True:
        on, given_kw = engines.possible(done, np.array([True]), np.array([power_kw]))
        if not on[0] or given_kw[0] < power_kw - 1e-6:
            break
        engines.state = engines.after(done, -given_kw, on)
        done += 1
    assert done * 0.01 == pytest.approx(hours, abs=0.011)


def test_a_battery_beside_a_set_makes_the_fuel_last_longer() -> None:
    """50 kW: at full power 6.06 h, then 273 kWh of the battery; 11.53 h instead of 9.66 h."""
    alone = solved(island([50.0] * 13, gensets()))
    assert alone.dispatch.served.sum() == 9
    day = replace(island([50.0] * 13, gensets()), batteries=battery(600.0, 100.0, 100.0))
    assert solved(day).dispatch.served.sum() == 11


@pytest.mark.parametrize("method", METHODS)
def test_a_set_follows_its_ramps_and_stops_from_any_power(method: str) -> None:
    sets = gensets(ramp_up_kw_per_h=40.0, ramp_down_kw_per_h=30.0, tank_litres=1e4)
    day = two_buses([[kw] for kw in (40.0, 80.0, 100.0, 70.0, 40.0)], [1.0], [DARK] * 5)
    assert -planned_kw(replace(day, gensets=sets), method)[:, 0] == pytest.approx(
        [40.0, 80.0, 100.0, 70.0, 40.0], abs=1e-4
    )
    back = two_buses([[40.0], [80.0], [100.0], [50.0]], [1.0], [DARK] * 3 + [OPEN])
    assert -planned_kw(replace(back, gensets=sets), method)[3, 0] == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_a_set_runs_on_after_the_outage_for_its_least_time_alone(method: str) -> None:
    day = two_buses([[50.0]] * 5, [1.0], [OPEN, DARK, OPEN, OPEN, OPEN], price=9.0)
    plan = solved(replace(day, gensets=gensets(min_on_h=3.0)), method).dispatch
    assert plan.running["gensets"][:, 0].tolist() == [False, True, True, True, False]
    always = solved(replace(day, gensets=gensets(only_in_outage=False)), method).dispatch
    assert always.running["gensets"].all()


def test_plant_and_plan_agree_on_what_random_sets_can_do() -> None:
    """What the plant makes of any wish is allowed by the window's rules, with the same fuel."""
    rng = np.random.default_rng(3)
    day = island([1000.0] * 40, gensets())
    sets = random_sets(rng, day)
    times = day.grid.times
    refuels = Refuels([sets.id[0]] * 2, [times[9] - HALF_AN_HOUR, times[20]], [150.0, 1e4])
    day = replace(day, gensets=sets, refuels=refuels)
    engines = Engines(day)
    on, power_kw, fuel_litres = [], [], []
    for t in range(40):
        wanted = rng.random(len(sets)) < 0.7
        wish_kw = sets.p_max_kw * rng.uniform(0.0, 1.2, len(sets))
        served = np.ones(1, dtype=bool)
        engines.advance(t, *engines.follow(t, -wish_kw, wanted, served))
        state = engines.state
        on.append(state.on)
        power_kw.append(state.power_kw)
        fuel_litres.append(state.fuel_litres)
    free = replace(day.gensets, min_on_h=np.zeros(len(sets)))  # the plant stops when it is told
    seen = ahead(replace(day, gensets=free), 40).without_duties()
    runs, given_kw = np.array(on), np.array(power_kw)
    outage = np.repeat(day.outage[:, None], len(sets), axis=1)
    assert runs.any() and not seen.wrongly_switched(runs, outage).any()
    plan = UnitPlan(-given_kw, runs, runs)
    assert moved_too_fast_kw(seen, plan).max() < 1e-6
    left = seen.fuel_litres(plan)
    assert np.abs(left - np.array(fuel_litres)).max() < 1e-9
    assert left[9, 0] > left[8, 0] and left[20, 0] > left[19, 0]


@pytest.mark.parametrize("method", METHODS)
def test_fuel_that_is_delivered_in_time_is_planned_with(method: str) -> None:
    """25 l are one step of 50 kW; a delivery within the second step counts from the third on."""
    day = island([50.0] * 4, gensets(fuel_level_litres=25.0))
    late = day.grid.times[1] + HALF_AN_HOUR
    day = replace(day, refuels=Refuels(["g0"], [late], [40.0]))
    served = solved(day, method).dispatch.served[:, 0]
    assert served[2:].all() and served.sum() == 3


def test_interior_points_find_the_bound_of_the_largest_weights() -> None:
    """A weight of 1e6, the most of strict order: Clarabel alone calls the window unbounded."""
    day = two_buses([[90.0, 30.0]] * 6, [1e6, 1.0], [OPEN, *[DARK] * 4, OPEN], price=0.3)
    day = replace(day, batteries=battery(60.0, 20.0, 20.0, soc=0.85, count=4))
    day = replace(day, gensets=gensets(2), objective=replace(day.objective, lambda_grid=1e-9))
    site, data = Site.of(day), known(day)
    form = Form("service", "relaxed", "relaxed", 16, outer=True)
    bounds = []
    for conic in (True, False):
        problem = window_problem(shared_cache(site), data, form, conic)
        problem.fill(data)
        scale = objective_scale(site)
        spec = find_solver("highs")
        found = run_conic(problem, 60.0, scale) if conic else run(problem, spec, 0.0, 60.0, scale)
        assert found.status == "optimal"
        bounds.append(found.bound)
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-4)


def test_sets_are_switched_as_for_one_battery_and_the_dispatch_costs_as_little() -> None:
    """Four batteries alike; the whole problem finds no cheaper use of the sets."""
    day = two_buses([[90.0]] * 6, [1.0], [OPEN, DARK, DARK, DARK, DARK, OPEN], price=0.3)
    day = replace(day, batteries=battery(60.0, 20.0, 20.0, soc=0.85, count=4))
    day = replace(day, gensets=gensets(2, p_max_kw=[60.0, 80.0], start_cost_gbp=[3.0, 1.0]))
    answer, whole = (solved(day, method) for method in METHODS)
    stages = [stage.partition("[")[0] for stage in answer.stages]
    assert "switched" in stages and "aggregate" not in stages
    assert answer.dispatch.served.all() and answer.status == "optimal"
    assert answer.terms.f2 == pytest.approx(whole.terms.f2, rel=1e-3)


# Sets that form the grid of an island.

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
    assert served(run) == [1] * 5 and not steps["dark"].any()
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


@pytest.mark.daily
@pytest.mark.parametrize("only_in_outage", [True, False])
def test_sets_supply_the_parts_that_faults_cut_off(only_in_outage: bool) -> None:
    """Each its own, without batteries: the grid that others have is no grid there."""
    day = faulted_day(1)
    faults = tuple(
        LineFault(day.grid.times[1], day.grid.times[3], bus) for bus in day.network.to_bus[-3:-1]
    )
    sets = gensets(2, bus=[fault.line for fault in faults], p_min_kw=0.0, grid_forming=True)
    day = replace(
        day,
        batteries=hospital(50.0, 50.0).batteries,
        gensets=replace(sets, only_in_outage=np.full(2, only_in_outage)),
        faults=faults,
    )
    run = run_day(day, replace(PHYSICAL, mode="paper"))
    assert run.gensets.groupby("time")["running"].sum().tolist() == [0, 2, 2, 0]
    assert run.customers["served"].all() and not run.steps["dark"].any()


@pytest.mark.daily
@pytest.mark.parametrize("seed", [16, 7, 3])
def test_methods_agree_on_several_sets_in_parts(seed: int) -> None:
    """The largest with fuel gives its part reactive power, while it runs."""
    day = faulted_day(seed)
    rng = np.random.default_rng([seed, 7])
    count = int(rng.integers(2, 4))
    lines = [fault.line for fault in day.faults if fault.line is not None]
    sets = gensets(
        count,
        bus=np.sort(rng.choice(np.array([*lines, day.network.to_bus[-1]]), count))[::-1],
        p_max_kw=rng.uniform(40.0, 150.0, count),
        fuel_level_litres=rng.uniform(10.0, 200.0, count),
        only_in_outage=rng.random(count) < 0.6,
        grid_forming=True,
        power_factor=0.9,
    )
    named = np.zeros(len(day.batteries), dtype=bool)
    day = replace(day, gensets=sets, batteries=replace(day.batteries, grid_forming=named))
    site, data = Site.of(day), faulted_window(day)
    data = replace(data, ahead=KindsAhead({"gensets": ahead(day)})).in_parts(site, data.parts)
    holds = data.ahead.known("gensets").holds
    beyond = at_items(data.parts.beyond, site.unit_bus["gensets"])
    assert holds.any() and beyond[holds].all()
    assert_methods_agree(site, data)


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


@pytest.mark.daily
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
            Dispatch.one_step(
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
    assert served(run) == [1, 1, 0, 1]
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
    assert served(run) == [1, 1, 0, 0, 1]
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
    assert first.tolist() == [0, 1]
    assert run.gensets["p_kw"].iloc[0] == pytest.approx(60.0, abs=0.1)


def test_by_rule_a_battery_with_energy_forms_the_grid_and_no_set_starts() -> None:
    b = replace(battery(200.0, 100.0, 100.0), grid_forming=[True], soc_initial=[0.85])
    run = run_day(replace(hospital(*[50.0] * 4), batteries=b), PHYSICAL, controller=Broken)
    assert served(run) == [1] * 4 and not run.gensets["running"].any()


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


def forming_windows(seed: int) -> tuple[Site, WindowData]:
    """A random window without battery that forms the grid, and with sets that do."""
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 47])
    sets = random_sets(rng, scenario)
    forming = rng.random(len(sets)) < 0.7
    forming[0] = True
    day = replace(scenario, gensets=replace(sets, grid_forming=forming))
    return formed_by_sets(day, data, rng)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(50))
def test_methods_agree_on_random_windows_of_islands(seed: int) -> None:
    assert_methods_agree(*forming_windows(seed), always=False)


def test_most_random_windows_are_lit_by_a_set() -> None:
    """The fifty forming_windows above say something."""
    formed = [forming_windows(seed)[1].ahead.known("gensets") for seed in range(50)]
    lit = [sets is not None and bool(sets.forms.any()) for sets in formed]
    assert sum(lit) >= 35


def test_the_duty_is_written_read_and_told(tmp_path: Path) -> None:
    day = hospital(50.0, 50.0, 50.0, power_factor=0.9)
    write_scenario(day, tmp_path / "day")
    read = load_scenario(tmp_path / "day").gensets
    assert read.grid_forming.tolist() == [True] and read.power_factor.tolist() == [0.9]
    assert former_words(day, "physical") == (
        "In an island generating set g0 at bus 2 (100 kW) forms the grid, as long as it has fuel. "
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
        assert step.customers["served"].all()
        assert step.solve["fallback"] == "none"
        assert step.gensets["p_kw"].iloc[0] == pytest.approx(loads_kw[t], abs=0.5)
        assert refusals(tables_of(step, day), day, {}) == {}
    killed = FaultPlan({t: SolverOutage("killed") for t in range(5)})
    ruled = run_day(day, PHYSICAL, faults=killed)
    assert served(ruled) == [1] * 5 and set(ruled.steps["fallback"]) == {"rule"}
