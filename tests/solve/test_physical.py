"""Physical mode: AC points, windows with losses against the monolith, days that AC agrees with."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from benchmarks.cases import physical_window
from benchmarks.frame.random_feeders import Window, random_scenario, random_window
from benchmarks.hard_days import hard_day, hard_window
from experiments.studies.islands import claims_of, imbalance_kw, random_day
from tests.support.agreement import assert_agree, both_methods
from tests.support.dispatch_check import check_dispatch
from tests.support.injections import in_network
from tests.support.refusals import refusal
from tests.support.small_windows import CHECKER_TOLERANCE, observed, window
from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.contract.observation import Observation
from vppres.control.converged import (
    FIRST_SHARE,
    SOC_NUDGE,
    ConvergedPlanner,
    dark_steps,
    physics_of,
)
from vppres.control.linearisation import (
    DEFAULT_PASSES,
    LOSS_TOLERANCE_KW,
    VOLTAGE_TOLERANCE_PU,
    BalancedLinearisation,
)
from vppres.control.passes import Passes
from vppres.core.errors import InputError, ModelError, NumericalError
from vppres.day.metrics import cautions, resilience, summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.io import find_scenario, read_scenario, write_scenario
from vppres.model.beyond_paper.losses import Sweeps, injections, linearised, lossless
from vppres.model.beyond_paper.physical import PhysicalMode
from vppres.model.data import Physics, WindowData
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.network import Network
from vppres.scenario.remarks import remarks
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Deadline
from vppres.solve.dispatch import least_reactive
from vppres.solve.fleet.relaxation import fleet_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.netting import net_modes
from vppres.solve.network.cheapest import CheapestDispatch
from vppres.solve.network.master import applies
from vppres.solve.network.reactive import LeastReactive
from vppres.solve.programs import Program
from vppres.solve.result import SolveLimits, Status, WindowSolution
from vppres.solve.selection import Sheet

WINDOWS = [(seed, stressed) for stressed in (False, True) for seed in range(16)]
DAYS = tuple(range(14))
PAPER_R = 0.9207
TIME_S = 20.0


# AC points.


@pytest.mark.parametrize("seed", range(6))
def test_sweeps_meet_newtons_method_from_the_grid_and_from_any_bus(seed: int) -> None:
    day = random_scenario(seed, stressed=seed % 2 == 1, n_steps=3)
    net, rng = day.network, np.random.default_rng(seed)
    p = rng.uniform(-60.0, 40.0, (3, net.n_buses))
    q = rng.uniform(-20.0, 20.0, (3, net.n_buses))
    newton = ACPowerFlow(net)
    for reference in (0, 1, net.n_buses - 1):
        points = Sweeps(net, reference).solve(p, q)
        assert points.converged.all()
        for t in range(3):
            exact = newton.solve(p[t], q[t], reference)
            assert points.v_pu[t] == pytest.approx(exact.v_pu, abs=1e-8)
            assert points.p_flow_kw[t] == pytest.approx(exact.p_from_kw, abs=1e-4)
            assert points.q_flow_kvar[t] == pytest.approx(exact.q_from_kvar, abs=1e-4)
            assert points.loss_kw[t] == pytest.approx(exact.p_from_kw - exact.p_to_kw, abs=1e-4)


def test_sweeps_say_where_there_is_no_solution() -> None:
    net = Network([1], [2], [100.0], [100.0], slack_bus=1, base_kv=1.0)
    points = Sweeps(net).solve(np.array([[0.0, -100.0], [0.0, -0.1]]), np.zeros((2, 2)))
    assert points.converged.tolist() == [False, True]


def test_linear_voltages_meet_the_point_they_are_linearised_at(tiny: Scenario) -> None:
    points = Sweeps(tiny.network, 1).solve(np.array([[0.0, 30.0, -45.0, -20.0]]), np.zeros((1, 4)))
    net, u = tiny.network, points.v_pu**2
    drop = 2 * (net.r_pu2_per_kw * points.p_flow_kw + net.x_pu2_per_kvar * points.q_flow_kvar)
    assert u[:, net.parent] - drop + points.offset_pu2(net) == pytest.approx(u[:, 1:], abs=1e-14)


# Windows.


@cache
def physical_answers(seed: int, stressed: bool) -> tuple[Window, list[WindowSolution]]:
    case = physical_window(seed, stressed)
    site = Site.of(case.scenario)
    return case, both_methods(site, case.data)


@pytest.mark.monolith
@pytest.mark.parametrize(("seed", "stressed"), WINDOWS)
def test_decomposed_equals_monolithic_with_losses_and_headroom(seed: int, stressed: bool) -> None:
    case, answers = physical_answers(seed, stressed)
    assert_agree(case.scenario, case.data, answers)


@pytest.mark.nightly
def test_windows_have_losses_islands_and_headroom() -> None:
    windows = [physical_answers(*key)[0].data for key in WINDOWS]
    physics = [w.physics for w in windows]
    assert sum(w.loss_kw.max() > 1.0 for w in windows) >= 10
    assert sum((p.reference > 0).any() for p in physics) >= 10
    assert sum((p.soc_reserve > 0).any() for p in physics) >= 10


@pytest.mark.nightly
def test_least_reactive_power_knows_losses_headroom_and_who_holds_the_voltage(
    nightly: bool,
) -> None:
    less = islands = 0
    for seed in range(12 if nightly else 5):
        case = physical_window(seed, stressed=True)
        site, data = Site.of(case.scenario), case.data
        if not applies(site, data):
            continue
        master = in_network(site, data)
        served = WindowSolver(site).solve(data).dispatch.served
        before = CheapestDispatch(site, data, master.network).of(served, Deadline(TIME_S))[1]
        if before is None:
            continue
        before, _ = net_modes(site, data, before)
        outcome, after = least_reactive(ModelCache(site), data, before, Deadline(TIME_S))
        assert outcome.status == Status.OPTIMAL
        assert check_dispatch(case.scenario, data, after).worst[1] < CHECKER_TOLERANCE
        np.testing.assert_array_equal(after.p_flow_kw, before.p_flow_kw)
        flows = [(d.q_flow_kvar**2 @ site.network.r_ohm).sum() for d in (before, after)]
        less += flows[1] < 0.5 * flows[0]
        islands += (data.physics.reference > 0).any()
    assert islands >= (3 if nightly else 1)
    assert less >= (3 if nightly else 1)


@pytest.mark.parametrize("kind", ["tight", "no_batteries"])
def test_least_reactive_power_weighs_flows_and_inverters_as_the_objective(kind: str) -> None:
    site = Site.of(hard_day(kind, 0).scenario)
    net, w = site.network, site.weights
    rng = np.random.default_rng(0)
    shapes = {"Q_flow": net.n_lines, "Q_pv": len(site.pv), "Q_batt": len(site.batteries)}
    x = {name: rng.normal(size=size) for name, size in shapes.items()}
    flows = net.r_ohm @ np.square(x["Q_flow"])
    used = np.square(x["Q_pv"] / site.pv.s_max_kva).sum()
    used += np.square(x["Q_batt"] / site.batteries.s_max_kva).sum()
    about_kw = 1000.0 * net.base_kv**2 * max(w.lambda_l, w.lambda_q)
    weighed = (w.lambda_l * flows + w.lambda_q * used) / about_kw
    problem = LeastReactive(site, Sheet(site, 1))
    squares = problem.selection.squares
    assert sum(squares[name] @ np.square(x[name]) for name in x) == pytest.approx(weighed)


def test_checker_finds_what_a_lossless_or_greedy_plan_would_do() -> None:
    case, (answer, _) = next(
        found
        for found in (physical_answers(*key) for key in WINDOWS)
        if (found[0].data.physics.soc_reserve > 0).any() and found[0].data.loss_kw.max() > 1.0
    )
    paper = check_dispatch(
        case.scenario, replace(case.data, physics=Physics.absent()), answer.dispatch
    )
    assert paper.violations["active balance"] > CHECKER_TOLERANCE
    physics = case.data.physics
    greedy = replace(case.data, physics=replace(physics, soc_reserve=physics.soc_reserve + 1.0))
    assert check_dispatch(case.scenario, greedy, answer.dispatch).violations["soc limits"] > 0.1
    powerless = replace(
        case.data, physics=replace(physics, headroom_kw=np.full_like(physics.headroom_kw, 1e4))
    )
    assert check_dispatch(case.scenario, powerless, answer.dispatch).violations["headroom"] > 1.0


def test_physical_problem_refuses_a_window_of_the_papers_mode(tiny: Scenario) -> None:
    site = Site.of(tiny)
    statement = Statement(site, 1, ((PhysicalMode, True),))
    data = random_window(0).data
    with pytest.raises(ModelError, match="filled with a window of the paper's mode"):
        statement.additions[0].fill(site, replace(data, physics=Physics.absent()))


def test_battery_that_is_empty_but_for_rounding_leaves_numbers_solvers_can_work_with(
    tiny: Scenario,
) -> None:
    site, data = Site.of(tiny), island_window(tiny, 0.85, 0, 3)
    empty = replace(data, soc=np.array([0.15 + 1e-16, 0.5]))
    for lumped in (True, False):
        problem = fleet_problem(ModelCache(site), empty, lumped, integer=True, goal="weighted")
        problem.write(empty)
        assert np.abs(problem.numbers().rows.data).max() < 1e6
    assert WindowSolver(site).solve(empty).status == "optimal"


# What the plan keeps free.


def island_window(tiny: Scenario, soc: float, first: int, n_steps: int) -> WindowData:
    return window(tiny, slice(first, first + n_steps), soc)


def test_reserve_pays_the_headroom_of_the_island_steps_that_remain(tiny: Scenario) -> None:
    physics = physics_of(Site.of(tiny), island_window(tiny, 0.85, 2, 4), 0.1)
    # 6 kW of a 60 kVA inverter for two hours, then one: 12 / 0.95 and 6 / 0.95 of 100 kWh.
    assert physics.headroom_kw.tolist() == [[0, 0], [6, 0], [6, 0], [0, 0]]
    assert physics.soc_reserve[:, 0] == pytest.approx([0.12 / 0.95, 0.06 / 0.95, 0, 0])
    assert physics.reference.tolist() == [0, 1, 1, 0]


def test_reserve_asks_for_nothing_that_cannot_be_there(tiny: Scenario) -> None:
    site = Site.of(tiny)
    inside = physics_of(site, island_window(tiny, 0.15 + 0.05, 3, 2), 0.1)
    assert inside.soc_reserve[:, 0] == pytest.approx([0.05, 0.05])
    before = physics_of(site, island_window(tiny, 0.15, 2, 3), 0.1)
    assert before.soc_reserve[0, 0] == pytest.approx(0.12 / 0.95)
    slow = replace(tiny, batteries=replace(tiny.batteries, p_max_kw=np.array([8.0, 8.0])))
    late = physics_of(Site.of(slow), island_window(slow, 0.15, 2, 3), 0.1)
    assert late.soc_reserve[0, 0] == pytest.approx(0.95 * 8.0 / 100.0)


def test_an_outage_without_a_known_end_keeps_the_headroom_of_each_step(tiny: Scenario) -> None:
    data = replace(island_window(tiny, 0.85, 2, 4), open_ended=True)
    kept = physics_of(Site.of(tiny), data, 0.1).soc_reserve[:, 0]
    assert kept == pytest.approx([0, 0.06 / 0.95, 0.06 / 0.95, 0])


def test_steps_that_nobody_can_hold_are_dark(tiny: Scenario) -> None:
    site = Site.of(tiny)
    assert dark_steps(site, island_window(tiny, 0.15, 3, 3)).tolist() == [True, True, False]
    assert dark_steps(site, island_window(tiny, 0.16, 3, 3)).tolist() == [False] * 3
    # With the grid there first, the battery can be charged.
    assert dark_steps(site, island_window(tiny, 0.15, 2, 3)).tolist() == [False] * 3


# Days.


@cache
def physical_day(seed: int) -> Trajectory:
    return run_day(*random_day(seed))


@pytest.mark.parametrize("seed", DAYS)
def test_record_keeps_its_claims(seed: int) -> None:
    run = physical_day(seed)
    claims = claims_of(run)
    assert claims.kept, claims
    assert claims.outside_steps == 0
    # Plan and AC agree where the passes sufficed.
    steps = run.steps[
        (run.steps["passes"] < DEFAULT_PASSES)
        & ~run.steps["corrected"]
        & (run.steps["dark"] == 0)
        & (run.steps["status"] != "planned")
    ]
    assert not (steps["v_error_pu"] > 2 * VOLTAGE_TOLERANCE_PU).any()
    mpc = run.options["controller"] == "mpc"
    assert not mpc or not (steps["island_mismatch_kw"].abs() > LOSS_TOLERANCE_KW).any()
    assert not mpc or not run.steps["shed_kw"].any()


@pytest.mark.nightly
def test_days_have_dark_steps_islands_and_corrections() -> None:
    runs = [physical_day(seed) for seed in DAYS]
    assert sum((run.steps["dark"] > 0).any() for run in runs) >= 3
    assert sum((run.steps["island_mismatch_kw"] != 0).any() for run in runs) >= 5
    assert any(run.steps["corrected"].any() for run in runs)
    assert max(run.steps["passes"].max() for run in runs) >= 3


def test_claims_are_held_against_the_tables() -> None:
    run = physical_day(next(s for s in DAYS if physical_day(s).scenario.outage.any()))
    bought = run.steps.assign(p_grid_kw=run.steps["p_grid_kw"] + 1.0)
    assert not claims_of(replace(run, steps=bought)).kept
    assert np.abs(imbalance_kw(replace(run, steps=bought))).max() == pytest.approx(1.0, abs=1e-4)
    low = replace(run, buses=run.buses.assign(v_ac_pu=run.buses["v_ac_pu"] - 0.2))
    assert claims_of(low).voltage_steps > 0


@pytest.fixture(scope="module")
def packaged_day() -> Trajectory:
    return run_day(read_scenario(find_scenario("uk-heatwave-2022")), RunOptions(mode="physical"))


@pytest.mark.nightly
def test_packaged_day_costs_the_losses_and_no_more(packaged_day: Trajectory) -> None:
    found = resilience(packaged_day)
    assert found is not None and PAPER_R - 0.01 <= found <= PAPER_R
    figures = summarise(packaged_day)
    assert figures["island_import_max_kw"] == 0.0
    net = packaged_day.scenario.network
    assert figures["v_min_ac_pu"] >= net.v_min_pu - VOLTAGE_TOLERANCE_PU
    assert figures["v_max_ac_pu"] <= net.v_max_pu + VOLTAGE_TOLERANCE_PU
    assert figures["v_error_max_pu"] <= VOLTAGE_TOLERANCE_PU
    assert claims_of(packaged_day).kept
    assert packaged_day.steps["gap"].max() <= 1e-4


def test_agreement_is_of_every_step(tiny: Scenario) -> None:
    site = Site.of(tiny)
    data = island_window(tiny, 0.85, 0, 3)
    start = lossless(data, physics_of(site, data, 0.1))
    solver = WindowSolver(site)
    passes = Passes(solver, BalancedLinearisation(site), 4, Deadline(60.0))
    dispatch = solver.solve(start).dispatch
    points = Sweeps(tiny.network).solve(*injections(site, start, dispatch))
    exact = linearised(start, tiny.network, points)
    met = replace(dispatch, v_pu=points.v_pu)
    assert passes.agree(exact, met, points)
    one_off = met.v_pu.copy()
    one_off[2, 3] += 2 * VOLTAGE_TOLERANCE_PU
    assert not passes.agree(exact, replace(met, v_pu=one_off), points)
    none = replace(points, converged=np.zeros(3, dtype=bool))
    assert not passes.agree(exact, met, none)


def test_an_outage_that_finds_the_former_empty_is_blacked_out_from_its_first_step() -> None:
    day = read_scenario(find_scenario("uk-heatwave-2022"))
    run = run_day(day.between(8, 14), RunOptions(mode="physical", outages="none"))
    dark = run.steps["dark"] > 0
    assert dark.tolist() == [False] * 4 + [True] * 2
    assert ((run.steps["status"] == "blacked_out") == dark).all()
    assert run.steps["shed_kw"].tolist() == [0.0] * 6
    assert not any("promised" in words for words in cautions(run))


def with_capacitor(day: Scenario, share: float) -> Scenario:
    """The day with a capacitor at its last bus, as a share of all batteries' inverters."""
    net = day.network
    kvar = np.zeros(net.n_buses)
    kvar[-1] = -share * float(day.batteries.s_max_kva.sum())
    network = replace(net, drawing_bus=net.buses, q_shunt_kvar=kvar)
    return replace(day, network=network)


@pytest.mark.daily
@pytest.mark.parametrize("share", [3.0, pytest.param(0.8, marks=pytest.mark.nightly)])
def test_an_island_with_a_capacitor_is_held_or_planned_dark(tiny: Scenario, share: float) -> None:
    day = with_capacitor(tiny, share).between(2, 5)
    run = run_day(day, RunOptions(mode="physical", horizon_h=2.0))
    steps = run.steps
    # What no set of customers and batteries can hold is promised to nobody.
    assert (steps["dark"] > 0).any() == (share > 1.0)
    assert steps.loc[steps["dark"] > 0, "shed_kw"].tolist() == [0.0] * int(steps["dark"].sum())
    assert ((steps["status"] == "blacked_out") == (steps["dark"] > 0)).all()
    assert any("blacked out in" in words for words in cautions(run)) == (share > 1.0)
    # Points know the capacitor: model and AC agree at once, but for losses before the first one.
    assert (steps["passes"].iloc[1:] == 1).all()


@pytest.mark.nightly
def test_an_island_without_its_capacitor_is_that_of_a_feeder_without_any(tiny: Scenario) -> None:
    day = with_capacitor(tiny, 3.0)
    assert any("bus 4 the value no" in remark for remark in remarks(day))
    day = replace(day, network=replace(day.network, island=np.arange(4) < 3))
    assert not any("capacitor" in remark for remark in remarks(day))
    outage = tiny.outage
    served = [
        run_day(each, RunOptions(mode="physical", horizon_h=5.0)).customers["served"].to_numpy()
        for each in (day, tiny)
    ]
    in_outage = np.repeat(outage, len(tiny.customers))
    assert served[1][in_outage].any()
    np.testing.assert_array_equal(served[0][in_outage], served[1][in_outage])


@pytest.mark.parametrize(("failures", "mark"), [(0, ""), (1, "nudged"), (2, "lossless")])
def test_window_without_answer_is_tried_again_and_says_so(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch, failures: int, mark: str
) -> None:
    solver = WindowSolver(Site.of(tiny))
    solve, windows = solver.solve, list[WindowData]()

    def failing(data: WindowData, within_s: float) -> WindowSolution:
        windows.append(data)
        if len(windows) <= failures:
            raise NumericalError("gave up")
        return solve(data, within_s)

    monkeypatch.setattr(solver, "solve", failing)
    forecast = Forecaster(tiny, ForecastErrors(), 0).at(2, range(2, 5))
    seen = observed(tiny, 2, forecast, np.full(2, 0.5))
    answer = ConvergedPlanner(solver).plan(seen)
    assert ([s for s in answer.stages if s in ("nudged", "lossless")] or [""]) == [mark]
    assert np.ptp([w.soc[0] for w in windows]) == pytest.approx(0.0 if not mark else SOC_NUDGE)
    if failures == 2:
        monkeypatch.setattr(
            solver, "solve", lambda *_: (_ for _ in ()).throw(NumericalError("gave up"))
        )
        with pytest.raises(NumericalError, match="gave up"):
            ConvergedPlanner(solver).plan(seen)


def lossy_day(tiny: Scenario) -> tuple[Scenario, Observation]:
    """66.5 kWh at the terminals for 66.4 kW of demand behind a line that loses more than 1 kW."""
    day = replace(
        tiny,
        network=Network(
            [1, 2, 2], [2, 3, 4], [0.3, 50.0, 5.0], [0.2, 9.0, 3.0], slack_bus=1, base_kv=11.0
        ),
        load_kw=np.tile([0.0, 60.0, 6.4], (6, 1)),
        pv_kw=np.zeros((6, 2)),
        batteries=replace(
            tiny.batteries, p_max_kw=np.array([90.0, 1.0]), s_max_kva=np.array([120.0, 1.0])
        ),
    )
    forecast = Forecaster(day, ForecastErrors(), 0).at(3, range(3, 4))
    return day, observed(day, 3, forecast, np.array([0.85, 0.15]))


@pytest.mark.parametrize("stored", [0.3, pytest.param(0.8, marks=pytest.mark.nightly)])
def test_batteries_that_lose_sun_in_turns_keep_them_until_ac_agrees(stored: float) -> None:
    """Each pass found other turns as good, and a step was refused for a surplus of 20 kW."""
    hard = hard_day("small_former", 7203)
    day, b = hard.scenario, hard.scenario.batteries
    forecast = Forecaster(day, hard.errors, 7203).at(10, range(10, 16))
    soc = b.soc_min + stored * (b.soc_max - b.soc_min)
    seen = observed(day, 10, forecast, soc)
    planner = ConvergedPlanner(WindowSolver(Site.of(day)))
    plan = planner.plan(seen)
    assert plan.status == Status.OPTIMAL
    assert plan.passes < planner.passes
    site = planner.solver.site
    whole = WindowData.of(seen, site, "none")
    data = lossless(whole, physics_of(site, whole, planner.headroom))
    points = planner.linearisation.points(data, plan.dispatch)
    off_kw = points.loss_kw.sum(axis=1) - plan.loss_kw
    assert np.abs(off_kw).max() <= LOSS_TOLERANCE_KW


@pytest.mark.nightly
@pytest.mark.parametrize("keeps_turns", [True, False])
def test_turns_of_a_plan_before_are_kept_where_they_allow_a_dispatch(keeps_turns: bool) -> None:
    """In any case, or because sun is lost in turns here, which would have to be searched for."""
    hard = hard_window("surplus", 12)
    solver = WindowSolver(hard.site, limits=SolveLimits(time_s=30.0))
    plan = solver.solve(hard.data).dispatch
    kept = solver.solve_served(hard.data, plan.served, plan, keeps_turns)
    assert not (kept.dispatch.charge_kw * (plan.charge_kw <= plan.discharge_kw) > 1e-6).any()
    assert not (kept.dispatch.discharge_kw * (plan.charge_kw > plan.discharge_kw) > 1e-6).any()
    turned = replace(plan, charge_kw=plan.discharge_kw, discharge_kw=plan.charge_kw)
    other = solver.solve_served(hard.data, plan.served, turned, keeps_turns)
    assert other.objective == pytest.approx(kept.objective, rel=1e-3)


def test_set_that_losses_leave_no_dispatch_is_decided_again(tiny: Scenario) -> None:
    day, seen = lossy_day(tiny)
    planner = ConvergedPlanner(WindowSolver(Site.of(day)), headroom=0.0)
    assert planner.plan(seen).dispatch.served.tolist() == [[True, True, False]]
    lossless_plan = ConvergedPlanner(planner.solver, headroom=0.0, passes=0).plan(seen)
    assert lossless_plan.dispatch.served.all()


def test_all_decisions_of_a_window_share_its_time(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    day, seen = lossy_day(tiny)
    solver = WindowSolver(Site.of(day))
    solve, spans = solver.solve, list[float]()
    solve_served, spans_of_passes = solver.solve_served, list[float]()

    def watched(data: WindowData, within_s: float) -> WindowSolution:
        spans.append(within_s)
        return solve(data, within_s)

    def watched_pass(*args: Any, within_s: float, **options: Any) -> WindowSolution | None:
        spans_of_passes.append(within_s)
        return solve_served(*args, within_s=within_s, **options)

    monkeypatch.setattr(solver, "solve", watched)
    monkeypatch.setattr(solver, "solve_served", watched_pass)
    ConvergedPlanner(solver, headroom=0.0).plan(seen)
    first_s, second_s = spans
    limit_s = solver.limits.time_s
    assert first_s == pytest.approx(FIRST_SHARE * limit_s, abs=0.1)
    assert 0.5 * limit_s < second_s < limit_s  # what the first one left, of the whole
    assert spans_of_passes
    assert spans_of_passes == sorted(spans_of_passes, reverse=True)
    assert spans_of_passes[0] < limit_s


# Options and files.


@pytest.mark.parametrize(("options", "message"), [
    ({"mode": "real"}, "options, mode = real: is not known. Use one of: paper, physical."),
    ({"headroom": 1.0}, "options, headroom = 1.0: must be a share from 0 to below 1. Give a share "
        "of the inverter's rating, for example 0.1."),
])  # fmt: skip
def test_options_that_make_no_sense(options: dict[str, object], message: str) -> None:
    assert refusal(RunOptions, **options) == message


def test_named_batteries_and_mode_survive_the_files(tiny: Scenario, tmp_path: Path) -> None:
    named = replace(
        tiny,
        batteries=replace(tiny.batteries, grid_forming=np.array([False, True])),
        controller=replace(tiny.controller, mode="physical"),
    )
    write_scenario(named, tmp_path / "named")
    read = read_scenario(tmp_path / "named")
    assert read.batteries.grid_forming.tolist() == [False, True]
    assert read.batteries.formers.tolist() == [False, True]
    assert read.controller.mode == "physical"
    write_scenario(tiny, tmp_path / "unnamed")
    assert "grid_forming" not in (tmp_path / "unnamed" / "batteries.csv").read_text("utf-8")
    file = tmp_path / "named" / "batteries.csv"
    file.write_text(file.read_text("utf-8").replace("yes", "maybe"), "utf-8")
    with pytest.raises(InputError, match=r"batteries\.csv, row 3, grid_forming = maybe: must be"):
        read_scenario(tmp_path / "named")


def test_problem_that_the_solver_refuses_is_an_error_and_no_crash() -> None:
    one = np.ones(1)
    program = Program(
        one, 0.0 * one, one, sp.csc_array([[1e16]]), 0.0 * one, one, np.zeros(0, dtype=np.int64)
    )
    with pytest.raises(NumericalError) as error:
        program.loaded()
    assert str(error.value) == (
        "HiGHS refuses a problem: its coefficients are not finite or too "
        "large. Check the data for extreme values."
    )
