"""Windows of phased feeders: against a plain statement, and balanced feeders stated in phases."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from experiments.studies.phased_feeders import (
    decided,
    in_phases,
    plainly,
    random_phased,
    with_a_former,
)
from tests.support.faulted import faulted_day
from tests.support.homes import homes
from tests.support.phased_feeder import CIRCUIT, day_of, phased_day
from tests.support.sets import gensets, random_sets
from tests.support.vans import with_random_vehicles
from tests.support.whole_statement import whole_problem
from vppres.contract.decision import Decision
from vppres.control.converged import ConvergedPlanner
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.priority import site_of
from vppres.day.simulate import Day
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.beyond_paper.ratings import loading_of_phases
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.own_state import COLLAPSED_PU2, giving_way
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.violations import broken
from vppres.scenario.phases import PhaseShunt
from vppres.scenario.scenario import ControllerDefaults, Scenario
from vppres.solve.fleet.masters import fleets_of
from vppres.solve.fleet.relaxation import fleet_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution
from vppres.solve.solvers import find_solver, run

BINDING = (15, 18)
"""Seeds of windows in which voltages by phase bind, and the phases of an island's former."""

WITHOUT_GRID = (3, 11, 4431)
"""Seeds of windows with weights that are multiples of nothing: the whole problem decides them. In
the last batteries would waste energy, and which of them charge is decided with the set."""

IN_NETWORK = 12
"""Seed of a window in parts whose set is decided in the network."""


def first_plan(scenario: Scenario) -> Decision:
    """What the first window of a day decides for all of its steps."""
    hours = (scenario.grid.n_steps - 1) * scenario.grid.dt_h
    options = RunOptions(horizon_h=hours).on(scenario)
    controller = make_controller(scenario, options)
    return controller.decide(Day(scenario, options).observe(controller, 0))


def nearest(site: Site, data: WindowData, found: WindowSolution) -> float:
    """How near an answer is to a limit of the phases: in pu², or as a share of the former's."""
    model, phased = phased_model(site), data.phased
    u, former = model.linear(data, *model.drawn(data, found.dispatch))
    u = (phased.u_offset + u)[lit_steps(data)][:, model.limited]
    low, high = (each[lit_steps(data)][:, model.limited] for each in (phased.u_min, phased.u_max))
    island = data.dark & lit_steps(data)
    kva = np.abs(phased.former_offset + former)[island].max(axis=1)
    rooms = (u - low, high - u, 1.0 - kva / phased.room_kva[island, 0])
    return min(float(np.min(room, initial=1.0)) for room in rooms)


def assert_between(site: Site, data: WindowData, found: WindowSolution, gap: float) -> None:
    """The answer lies between plain statements with polygons inside and around the discs."""
    inside, around = plainly(site, data, inside=True), plainly(site, data, inside=False)
    assert inside - gap <= found.objective <= around + 1e-6
    assert found.bound >= inside - 1e-6


BY_COST = (4443,)
"""Seeds of windows in which everyone is served, and prices alone decide."""


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [*BINDING, *WITHOUT_GRID, *BY_COST])
def test_windows_equal_a_plain_statement_of_the_whole_problem(seed: int) -> None:
    site, data, found = decided(random_phased(seed))
    assert seed not in BINDING or nearest(site, data, found) < 0.01
    assert_between(site, data, found, gap=max(5e-3, 1e-4 * abs(found.objective)))


@pytest.mark.daily
@pytest.mark.parametrize("seed", [2, 9, 15, IN_NETWORK])
def test_windows_in_parts_equal_a_plain_statement_of_the_whole_problem(seed: int) -> None:
    """Each part that something forms has its own balance and phases of its own former."""
    day = faulted_day(seed, steps=3)
    known = tuple(replace(fault, known=True) for fault in day.faults)
    physical = replace(day, faults=known, controller=ControllerDefaults(mode="physical"))
    site, data, found = decided(in_phases(physical, np.random.default_rng([seed, 62])))
    assert data.parts.forms.any()
    in_network = [stage for stage in found.stages if stage.startswith("network_service")]
    assert bool(in_network) == (seed == IN_NETWORK)
    assert_between(site, data, found, gap=max(5e-3, 1e-4 * abs(found.objective)))


@pytest.mark.parametrize("seed", [10, 58])
def test_sun_on_a_phase_of_the_former_needs_no_search_of_the_whole_problem(seed: int) -> None:
    """Without the network too, each phase has its own PV power."""
    found = decided(random_phased(seed))[2]
    assert found.status == "optimal"
    assert not [stage for stage in found.stages if stage.startswith("full")]


@pytest.mark.daily
def test_a_capacitor_that_only_customers_balance_needs_no_search_of_the_whole_problem() -> None:
    """The former carries it only beside some customers; their price is that of a proof."""
    day = random_phased(181)
    capacitor = PhaseShunt("8", "a b c", day.network.base_kv / np.sqrt(3.0), 0.0, -399.5)
    site, data, found = decided(replace(day, phases=replace(day.phases, shunts=(capacitor,))))
    assert found.status == "optimal"
    assert "network_service[highs]" in found.stages
    assert not [stage for stage in found.stages if stage.startswith("full")]
    assert_between(site, data, found, gap=1e-6)


def with_kinds(seed: int) -> Scenario:
    """The random day on an unbalanced feeder with vehicles, sets, rooms and dimmed customers."""
    day = with_random_vehicles(with_a_former(random_scenario(seed)), seed)
    rng = np.random.default_rng([seed, 77])
    count = len(day.customers)
    day = replace(
        day,
        gensets=random_sets(rng, day),
        thermal_loads=homes(*day.customers.id[:2], p_max_kw=20.0, r_c_per_kw=1.0),
        temperature_c=day.temperature_c + 12.0,
        customers=replace(day.customers, share_min=np.where(rng.random(count) < 0.5, 0.4, 1.0)),
    )
    return in_phases(day, np.random.default_rng([seed, 44]))


@pytest.mark.daily
@pytest.mark.parametrize("seed", [4, pytest.param(5, marks=pytest.mark.nightly), 14, 15])
def test_windows_with_all_kinds_equal_the_whole_problem_with_all_rows(seed: int) -> None:
    site, data, found = decided(with_kinds(seed))
    whole = whole_problem(site, data)
    gap = max(5e-3, 1e-4 * abs(whole.value))
    assert whole.value - gap <= found.objective <= whole.bound + gap
    assert found.bound >= whole.value - 1e-6
    assert not broken(site, data, found.dispatch)


@pytest.mark.nightly
def test_ratings_that_cannot_be_kept_give_way_no_further_than_need_be(tmp_path: Path) -> None:
    """A capacitor's current is beyond the rating of its line, whoever is served.

    Three tenths of what the plan without ratings has beyond them leave no dispatch, four tenths do.
    """
    file = tmp_path / "small.dss"
    large = CIRCUIT.replace("kvar=150", "kvar=900")
    file.write_text(large.replace("length=0.6 units=km", "length=0.6 units=km normamps=40"))
    day = phased_day(file)
    day = replace(day, controller=replace(day.controller, ratings="limit"))
    site, data, found = decided(day.between(8, 10))
    unrated = WindowSolver(site, limits=SolveLimits())._decided(data, SolveLimits())
    kept, free = (
        loading_of_phases(site, data, *phased_model(site).drawn(data, each.dispatch)).max() - 1.0
        for each in (found, unrated)
    )
    assert found.status == "optimal"
    assert 0.3 * free < kept < 0.51 * free


def first_window(day: Scenario, headroom: float) -> tuple[ConvergedPlanner, WindowData]:
    """The first window of a day with so much headroom, as it is solved first."""
    options = RunOptions(horizon_h=0.0).on(day)
    planner = ConvergedPlanner(WindowSolver(site_of(day, options.as_record())), headroom)
    seen = Day(day, options).observe(make_controller(day, options), 0)
    return planner, planner.begun(seen)[2]


def test_limits_of_phases_give_way_to_no_voltage_that_a_feeder_cannot_have(tmp_path: Path) -> None:
    day = day_of(CIRCUIT, tmp_path).between(9, 10)
    usual, far = (
        first_window(replace(day, load_kw=factor * day.load_kw), headroom=0.0)[1].phased
        for factor in (1.0, 1000.0)
    )
    assert far.u_min.min() == COLLAPSED_PU2 < usual.u_min.min()


@pytest.mark.nightly
def test_the_fleet_knows_what_active_power_each_phase_of_the_former_carries(tmp_path: Path) -> None:
    """Reactive power of customers is known with them, that of batteries and PV widens the room."""
    (tmp_path / "small.dss").write_text(CIRCUIT)
    planner, data = first_window(phased_day(tmp_path / "small.dss").between(13, 14), headroom=0.1)
    site = planner.solver.site
    model = phased_model(site)
    statement = Statement(site, 1, beyond_paper(site, data))
    statement.write(data)
    rng = np.random.default_rng(44)
    served = rng.random((1, len(site.customers))) < 0.5
    curtailed = 0.4 * data.pv_kw
    charged, discharged = (rng.uniform(0.0, 50.0, (1, len(site.batteries))) for _ in range(2))
    letters = {"x_served": served, "P_curt": curtailed, "P_ch": charged, "P_dch": discharged}
    statement.put({name: value.astype(float) for name, value in letters.items()})
    pv, batteries = data.pv_kw - curtailed, discharged - charged
    drawn = model.powers(
        model.sources(data), data.load_kw * served, (pv, 0.0 * pv), (batteries, 0.0 * batteries)
    )
    given_kw = (data.phased.former_offset + model.linear(data, *drawn)[1]).real
    slopes = np.abs(model.supplies[1].slopes.former_q.real[:, len(site.customers) :])
    kva = np.append(
        site.pv.s_max_kva, np.where(site.batteries.grid_forming, 0.0, site.batteries.s_max_kva)
    )
    room_kw = np.cos(np.pi / 32) * data.phased.room_kva[0] + slopes @ kva
    for name, sign in (("former_phase_most", 1.0), ("former_phase_least", -1.0)):
        missed = statement.implied[name].args
        found = np.asarray(missed[0].value - missed[1].value)
        np.testing.assert_allclose(found, sign * given_kw - room_kw, atol=1e-6)


def test_the_fleet_serves_no_set_that_crowds_a_phase(tmp_path: Path) -> None:
    day = day_of(CIRCUIT, tmp_path).between(13, 14)
    of_a = day.customers.id == "ca"
    b = day.batteries
    full = replace(b, soc_initial=np.where(b.grid_forming, b.soc_max, b.soc_min))
    load_kw = np.where(of_a, 0.6 * b.p_max_kw[b.grid_forming], 1.0)[None, :]
    day = replace(day, batteries=full, load_kw=load_kw, pv_kw=0.0 * day.pv_kw)
    planner, data = first_window(day, headroom=0.1)
    cache = planner.solver.cache
    served = {}
    for rooms in (1.0, 100.0):
        phased = data.phased
        wider = replace(data, phased=replace(phased, room_kva=rooms * phased.room_kva))
        problem = fleet_problem(cache, wider, lumped=False, integer=True, goal="service")
        problem.write(wider)
        assert run(problem, find_solver("highs"), 0.0, 60.0).status == "optimal"
        served[rooms] = problem.value_of("x_served")[0] > 0.5
    assert served[100.0].all() and not served[1.0][of_a]
    assert served[1.0][~of_a].all()


@pytest.mark.nightly
def test_a_plan_without_headroom_leaves_a_phase_what_passes_may_be_off_by(tmp_path: Path) -> None:
    day = day_of(CIRCUIT, tmp_path)
    full = replace(day.batteries, soc_initial=day.batteries.soc_max)
    island = replace(day, batteries=full).between(13, 14)
    planner, data = first_window(island, headroom=0.0)
    phased = data.phased
    rating = island.batteries.s_max_kva[island.batteries.grid_forming][0] / 3.0
    assert phased.room_kva == pytest.approx(0.999 * rating)
    at, plan = planner.linearisation, planner.solver.solve(data).dispatch
    points = at.points(data, plan)
    for share, agrees in ((0.9995, True), (1.0005, False)):
        kva = np.full((1, 3), share * rating, dtype=complex)
        given = replace(points, source_kva=kva)
        assert at.agrees(at.closer(data, plan, given, passes=1), plan, given) is agrees


def test_limits_that_give_way_to_those_of_ac_leave_what_passes_may_be_off_by(
    tmp_path: Path,
) -> None:
    (tmp_path / "small.dss").write_text(CIRCUIT)
    planner, data = first_window(phased_day(tmp_path / "small.dss").between(8, 9), 0.1)
    high = np.full_like(data.phased.u_max, 1.10**2)
    ways = giving_way(planner.solver.site, replace(data, phased=replace(data.phased, u_max=high)))
    most = [np.sqrt(each.phased.u_max.max()) for each in ways]
    assert most[:2] == pytest.approx([1.053, 1.0599])


@pytest.mark.nightly
def test_voltages_of_a_plan_are_those_of_the_window_that_was_solved(tmp_path: Path) -> None:
    """After a single pass plan and power flow differ, and the plan shows it."""
    day = day_of(CIRCUIT, tmp_path).between(8, 9)
    options = RunOptions(horizon_h=0.0).on(day)
    planner = ConvergedPlanner(WindowSolver(site_of(day, options.as_record())), passes=1)
    seen = Day(day, options).observe(make_controller(day, options), 0)
    plan = planner.plan(seen).dispatch
    data = planner.begun(seen)[2]
    points = planner.linearisation.points(data, plan)
    assert plan.v_node_pu is not None
    off_pu = np.abs(plan.v_node_pu - np.sqrt(points.u_pu2)).max()
    assert 1e-6 < off_pu < 1e-2


def formed_by_a_set(day: Scenario) -> Scenario:
    """The day with a set that forms its islands, of half the peak demand, and no battery that does.

    It has fuel for days.
    """
    peak_kw, b = float(day.load_kw.sum(axis=1).max()), day.batteries
    fuel = {"tank_litres": 50.0 * peak_kw, "fuel_level_litres": 50.0 * peak_kw}
    kw = {"p_max_kw": 0.5 * peak_kw, "p_min_kw": 0.05 * peak_kw, "power_factor": 0.8}
    one = gensets(bus=day.customers.bus[0], grid_forming=True, **kw, **fuel)
    none = np.zeros(len(b), dtype=bool)
    return replace(day, gensets=one, batteries=replace(b, grid_forming=none))


@pytest.mark.parametrize(
    ("seed", "former"), [(1, "battery"), (3, "battery"), (0, "set"), (5, "set")]
)
def test_a_balanced_feeder_stated_in_phases_has_the_balanced_plan(seed: int, former: str) -> None:
    balanced = with_a_former(random_scenario(seed))
    balanced = formed_by_a_set(balanced) if former == "set" else balanced
    plan = first_plan(balanced).dispatch
    found = first_plan(in_phases(balanced)).dispatch
    assert (found.served == plan.served).all()
    for kind, taken_kw in plan.taken_kw.items():
        assert taken_kw.min() < -100.0
        np.testing.assert_allclose(found.taken_kw[kind], taken_kw, atol=1.0)
    np.testing.assert_allclose(found.p_grid_kw, plan.p_grid_kw, atol=0.5)
    np.testing.assert_allclose(found.v_pu, plan.v_pu, atol=1e-4)


@pytest.mark.daily
@pytest.mark.parametrize(("size", "hours"), [(1.0, 1), (1.4, 1), (1.4, 2)])
def test_batteries_do_not_change_hours_of_the_same_price_from_pass_to_pass(
    tmp_path: Path, size: float, hours: int
) -> None:
    """All six hours before an outage cost the same: the first pass with turns is the last one."""
    day = day_of(CIRCUIT, tmp_path)
    n_steps, b = day.grid.n_steps, day.batteries
    sized = {name: size * getattr(b, name) for name in ("p_max_kw", "energy_kwh", "s_max_kva")}
    hard = replace(
        day,
        load_kw=size * day.load_kw,
        pv_kw=0.0 * day.pv_kw,
        price_gbp_per_kwh=np.full(n_steps, 0.3),
        grid_limit_kw=np.where(np.arange(n_steps) < 6, np.inf, 0.0),
        batteries=replace(b, **sized, soc_initial=b.soc_max),
    )
    decision = first_plan(hard.between(0, 6 + hours))
    assert (decision.info.status, decision.info.passes) == ("optimal", 3)
    assert decision.dispatch.discharge_kw[:6].max() > 1.0


@pytest.mark.daily
def test_one_battery_bounds_all_of_a_phased_feeder(tmp_path: Path) -> None:
    """Thousands by themselves take a minute to bound."""
    day = day_of(CIRCUIT, tmp_path).between(13, 14)
    b = day.batteries
    empty = replace(b, soc_initial=np.where(b.grid_forming, b.soc_max, b.soc_min))
    day = replace(day, batteries=empty, load_kw=4.0 * day.load_kw, pv_kw=0.0 * day.pv_kw)
    planner, data = first_window(day, headroom=0.1)
    most = []
    for lumped in (True, False):
        problem = fleet_problem(planner.solver.cache, data, lumped, integer=True, goal="service")
        problem.write(data)
        most.append(run(problem, find_solver("highs"), 0.0, 60.0).value)
    assert fleets_of(data) == (True, False)
    assert most[1] <= most[0] + 1e-6
