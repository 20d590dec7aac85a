"""One window: hand-solved cases, statuses, and methods and solvers against each other."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import cvxpy as cp
import numpy as np
import pytest

from benchmarks.frame.random_feeders import Window, random_state, random_window
from tests.support.agreement import BOUND_TOLERANCE, assert_agree, assert_sound, both_methods
from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import (
    CHECKER_TOLERANCE,
    DARK,
    OPEN,
    battery,
    two_buses,
    window,
    with_pv,
)
from vppres.core.errors import InfeasibleError, InputError, LimitError, ModelError
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve import solvers, whole
from vppres.solve.fleet.reach import everyone_in_reach
from vppres.solve.forms import Form
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import Outcome, SolveLimits, Status, WindowSolution
from vppres.solve.solvers import SolverSpec, run
from vppres.solve.task import WindowTask

RANDOM_WINDOWS = [(seed, stressed) for stressed in (False, True) for seed in range(100)]
NEGATIVE_PRICES = [(seed, stressed) for stressed in (False, True) for seed in range(0, 36, 3)]
CONE_WINDOWS = [(seed, True) for seed in range(11, 22)]
WRONGLY_INFEASIBLE = (10, True)
"""A window that SCIP calls infeasible, although each of its four steps alone is feasible for it."""
PACKAGED_WINDOWS = [  # SCIP takes long over several steps
    pytest.param(t0, steps, soc, marks=() if steps == 1 and t0 >= 12 else pytest.mark.nightly)
    for steps in (1, 2, 3)
    for t0, soc in ((2, 0.15), (12, 0.5), (12 - steps, 0.85), (16, 0.3))
]


def solve(
    scenario: Scenario,
    method: str = "decomposed",
    solver: str = "highs",
    limits: SolveLimits | None = None,
) -> WindowSolution:
    """All steps of a scenario as one window."""
    return WindowSolver(Site.of(scenario), method, solver, limits).solve(window(scenario))


# Hand-solved cases.


@pytest.mark.parametrize("method", METHODS)
def test_energy_for_one_customer_goes_to_the_critical_one(method: str) -> None:
    # 70 kWh between the SoC limits give 66.5 kWh at the terminals: one customer of 66 kW.
    day = replace(
        two_buses([[66.0, 66.0]], [0.1, 1.0], [DARK]),
        batteries=battery(p_max_kw=200.0, s_max_kva=200.0, soc=0.85),
    )
    answer = solve(day, method)
    assert answer.dispatch.served.tolist() == [[False, True]]
    assert answer.objective == pytest.approx(1.0, abs=1e-9)
    assert answer.dispatch.discharge_kw[0, 0] == pytest.approx(66.0, abs=1e-4)
    assert answer.dispatch.soc[1, 0] == pytest.approx(0.85 - 66.0 / 0.95 / 100.0, abs=1e-6)
    short = replace(day, load_kw=[[66.6, 66.6]])  # by a hair
    assert not solve(short, method).dispatch.served.any()


@pytest.mark.parametrize("missing_kwh, count", [(0.0, 2), (5e-7, 2), (1.5e-6, 2), (1e-3, 1)])
def test_rounding_costs_nobody_the_service(missing_kwh: float, count: int) -> None:
    """Two customers of 33.25 kW in the dark; 70 kWh between the limits give 66.5 kWh for them."""
    day = replace(
        two_buses([[33.25, 33.25]], [1.0, 1.0], [DARK]),
        batteries=battery(p_max_kw=200.0, s_max_kva=200.0, soc=0.85 - missing_kwh / 0.95 / 100.0),
    )
    answer = solve(day)
    assert answer.dispatch.served.sum() == count
    assert answer.status == Status.OPTIMAL
    assert check_dispatch(day, window(day), answer.dispatch).worst[1] < CHECKER_TOLERANCE


def test_many_low_customers_outweigh_a_larger_one() -> None:
    # 1.0 for the large customer alone, 0.6 + 0.6 for the two small ones: 60 kW either way.
    day = replace(
        two_buses([[60.0, 30.0, 30.0]], [1.0, 0.6, 0.6], [DARK]),
        batteries=battery(p_max_kw=200.0, s_max_kva=200.0, soc=0.85),
    )
    assert solve(day).dispatch.served.tolist() == [[False, True, True]]


@pytest.mark.parametrize("method", METHODS)
def test_arbitrage_earns_what_the_efficiencies_leave(method: str) -> None:
    # 50 kWh bought at 0.1 come back as 45.125 kWh that need not be bought at 0.5.
    day = replace(
        two_buses([[100.0], [100.0]], [1.0], [OPEN, OPEN], [0.1, 0.5]), batteries=battery()
    )
    answer = solve(day, method)
    assert answer.dispatch.charge_kw[:, 0] == pytest.approx([50.0, 0.0], abs=1e-3)
    assert answer.dispatch.discharge_kw[:, 0] == pytest.approx([0.0, 45.125], abs=1e-3)
    assert answer.terms.f2 == pytest.approx(0.1 * 150.0 + 0.5 * (100.0 - 45.125), abs=1e-3)


@pytest.mark.parametrize(
    ("second_price", "cost_gbp"),
    [(0.33, 0.3 * 100.0 + 0.33 * 100.0), (0.34, 0.3 * 150.0 + 0.34 * (100.0 - 45.125))],
)
def test_arbitrage_starts_where_prices_differ_by_more_than_the_losses(
    second_price: float, cost_gbp: float
) -> None:
    # 0.95² = 0.9025: it pays from 0.3 / 0.9025 = 0.3324 GBP/kWh. The tie-breakers may spend 1e-6
    # of the cost and 1e-5 GBP.
    day = replace(
        two_buses([[100.0], [100.0]], [1.0], [OPEN, OPEN], [0.3, second_price]), batteries=battery()
    )
    assert solve(day).terms.f2 == pytest.approx(cost_gbp, abs=1e-4)


def test_half_hours_move_half_the_energy_and_weigh_half() -> None:
    day = replace(
        two_buses([[100.0], [100.0]], [1.0], [OPEN, OPEN], [0.1, 0.5]), batteries=battery()
    )
    halves = replace(day, grid=replace(day.grid, step_minutes=30.0))
    whole, half = solve(day), solve(halves)
    assert half.terms.f1 == pytest.approx(0.5 * whole.terms.f1)
    assert half.terms.f2 == pytest.approx(0.5 * whole.terms.f2, abs=1e-3)
    assert half.dispatch.soc[1, 0] - 0.15 == pytest.approx(0.5 * 0.475, abs=1e-5)


@pytest.mark.parametrize(
    ("neighbour_kw", "soc", "curtailed_kw"),
    [(0.0, 0.85, 10.0), (10.0, 0.85, 0.0), (4.0, 0.85, 10.0 - 4.0), (0.0, 0.5, 0.0)],
)
def test_curtailment_only_where_nothing_can_take_the_power(
    neighbour_kw: float, soc: float, curtailed_kw: float
) -> None:
    # The owner takes 20 of 30 kW; 10 kW are left for a neighbour or a battery with room.
    day = with_pv(two_buses([[20.0, neighbour_kw]], [1.0, 0.1], [DARK]), [30.0])
    answer = solve(replace(day, batteries=battery(soc=soc)))
    assert answer.dispatch.served.all()
    assert answer.terms.f3 == pytest.approx(curtailed_kw, abs=1e-4)


def test_pv_above_the_inverters_rating_is_curtailed_even_with_a_grid() -> None:
    day = with_pv(two_buses([[20.0, 50.0]], [1.0, 0.1], [OPEN]), [30.0], s_max_kva=25.0)
    answer = solve(day)
    assert answer.dispatch.served.all()
    assert answer.terms.f3 == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_owner_whose_self_consumption_exceeds_the_inverter_cannot_be_served(method: str) -> None:
    day = with_pv(two_buses([[40.0, 50.0]], [1.0, 0.1], [OPEN]), [30.0], s_max_kva=25.0)
    assert solve(day, method).dispatch.served.tolist() == [[False, True]]


@pytest.mark.parametrize("method", METHODS)
def test_a_battery_never_charges_another(method: str) -> None:
    # Free energy now, dear energy later: still only import can fill a battery, and there is none.
    day = two_buses([[0.0], [50.0]], [1.0], [DARK, DARK])
    two = battery(count=2)
    day = replace(day, batteries=replace(two, soc_initial=np.array([0.15, 0.85])))
    answer = solve(day, method)
    assert answer.dispatch.charge_kw == pytest.approx(np.zeros((2, 2)), abs=1e-6)
    assert answer.dispatch.served.tolist() == [[True], [True]]


# u = 1 - 2 r P / (1000 kV²) >= 0.947² allows 623.9 kW through 10 ohm at 11 kV.
VOLTAGE_LIMIT_KW = (1.0 - 0.947**2) * 1000.0 * 11.0**2 / (2 * 10.0)


@pytest.mark.parametrize("method", METHODS)
def test_voltage_limit_forces_shedding(method: str) -> None:
    day = two_buses([[400.0, 400.0]], [0.1, 1.0], [OPEN], r_ohm=10.0)
    assert solve(day, method).dispatch.served.tolist() == [[False, True]]


@pytest.mark.parametrize(("share", "served"), [(0.999, True), (1.001, False)])
def test_voltage_limit_binds_where_the_formula_says(share: float, served: bool) -> None:
    day = two_buses([[share * VOLTAGE_LIMIT_KW]], [1.0], [OPEN], r_ohm=10.0)
    assert bool(solve(day).dispatch.served[0, 0]) is served


def test_battery_beyond_the_weak_line_keeps_everybody_served() -> None:
    day = two_buses([[400.0, 400.0]], [0.1, 1.0], [OPEN], r_ohm=10.0)
    answer = solve(
        replace(
            day, batteries=battery(energy_kwh=1000.0, p_max_kw=200.0, s_max_kva=200.0, soc=0.85)
        )
    )
    assert answer.dispatch.served.all()
    assert answer.dispatch.v_pu[0, 1] >= 0.947 - 1e-6


@pytest.mark.parametrize(("method", "solver"), [
    ("decomposed", "highs"),
    ("decomposed", "scip"),
    ("monolithic", "highs"),
    ("monolithic", "scip"),
])  # fmt: skip
def test_bound_holds_between_polygon_and_disc(method: str, solver: str) -> None:
    # 99.5 kVA at the middle of a side of the 16-gon: inside the disc of 100 kVA, whose dispatch
    # serves the customer, outside the polygon, which reaches 98.1 kVA there.
    angle = np.pi / 16
    day = two_buses([[99.5 * np.cos(angle)]], [1.0], [DARK])
    day = replace(
        day,
        customers=replace(day.customers, power_factor=np.array([np.cos(angle)])),
        batteries=battery(energy_kwh=1000.0, p_max_kw=200.0, soc=0.5),
    )
    assert solve(day, method, solver).bound >= 1.0 - BOUND_TOLERANCE


@pytest.mark.parametrize(
    "names",
    [["lambda_grid"], ["lambda_curt"], ["lambda_l"], ["lambda_q"], ["lambda_l", "lambda_q"]],
)
def test_weight_of_zero_switches_a_term_off(names: list[str]) -> None:
    day = two_buses([[10.0]], [1.0], [OPEN])
    weights = replace(day.objective, **dict.fromkeys(names, 0.0))
    answer = solve(replace(day, objective=weights))
    assert answer.dispatch.served.all()
    cost = 0.0 if names == ["lambda_grid"] else 1e-6 * 3.0
    assert answer.objective == pytest.approx(1.0 - cost, abs=1e-9)


@pytest.mark.parametrize("seed", [2, 5, 8])
def test_answer_does_not_depend_on_what_was_solved_before(seed: int) -> None:
    """Bit by bit: a run must be the same in a fresh process and after other runs."""
    case = random_window(seed)
    solver = WindowSolver(Site.of(case.scenario))
    first = solver.solve(case.data)
    solver.solve(replace(case.data, load_kw=1.3 * case.data.load_kw))
    again = solver.solve(case.data)
    for name, value in first.dispatch.arrays().items():
        assert (value == getattr(again.dispatch, name)).all(), name


def test_compiled_problems_are_kept() -> None:
    full, poor = (
        replace(
            two_buses([[66.0, 66.0]], [0.1, 1.0], [DARK]),
            batteries=battery(p_max_kw=200.0, soc=soc),
        )
        for soc in (0.85, 0.5)
    )
    solver = WindowSolver(Site.of(full))
    first = solver.solve(window(full))
    compiled = solver.cache.compilations
    problems = solver.cache.problems
    poorer = WindowSolver(Site.of(poor)).solve(window(poor))
    assert first.dispatch.served.any() and not poorer.dispatch.served.any()
    assert solver.cache.compilations == compiled
    assert all(a is b for a, b in zip(solver.cache.problems, problems, strict=True))


# Statuses.


@pytest.mark.parametrize(("asked", "installed", "message"), [
    ({"method": "magic"}, None,
        r"method = magic: is not a known method\. Use one of: decomposed, monolithic\.$"),
    ({"solver": "gluroby"}, None,
        r"solver = gluroby: is not a known solver \(highs, scip\)\. Installed here: .*highs.*scip"),
    ({"solver": "scip"}, [cp.HIGHS],
        r"solver = scip: is not installed\. Install it, or use one of: highs\.$"),
])  # fmt: skip
def test_unknown_method_is_named(
    asked: dict[str, str],
    installed: list[str] | None,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """So are solvers, with those that work."""
    if installed is not None:
        monkeypatch.setattr(solvers, "_installed", lambda: frozenset(installed))
    with pytest.raises(InputError, match=f"^options, {message}"):
        WindowSolver(Site.of(two_buses([[1.0]], [1.0], [OPEN])), **asked)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("solver", ["highs", "scip"])
def test_infeasible_window_says_so(method: str, solver: str) -> None:
    day = two_buses([[10.0]], [1.0], [OPEN])
    day = replace(day, network=replace(day.network, v_slack_pu=0.94))
    with pytest.raises(InfeasibleError) as error:
        solve(day, method, solver)
    assert str(error.value) == (
        "The window of 1 steps has no feasible dispatch. The voltage limits or the PV owners' "
        "self-consumption leave nothing; widen the limits or check the PV inverters' ratings."
    )


def test_time_limit_returns_the_best_answer_with_its_bound(
    packaged: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search ends at a wide gap, as it would by time, and time is up then."""
    limits = SolveLimits(time_s=60.0)
    clock_s = [0.0]
    monkeypatch.setattr(
        "vppres.solve.deadline.time", SimpleNamespace(perf_counter=lambda: clock_s[0])
    )

    def ended_by_time(
        problem: cp.Problem, spec: SolverSpec, gap_abs: float, time_s: float, scale: float = 1.0
    ) -> Outcome:
        found = run(problem, spec, 5.0, time_s, scale)
        clock_s[0] = limits.time_s
        return replace(found, status=Status.TIME_LIMIT)

    monkeypatch.setattr("vppres.solve.whole.run", ended_by_time)
    data = window(packaged, slice(12, 15), soc=0.5)
    answer = WindowSolver(Site.of(packaged), "monolithic", "highs", limits).solve(data)
    assert answer.status == "time_limit"
    assert answer.stages[0] == "full_outer[highs]:time_limit"
    assert answer.gap > limits.gap_rel
    assert check_dispatch(packaged, data, answer.dispatch).worst[1] <= CHECKER_TOLERANCE
    whole = WindowSolver(Site.of(packaged), "decomposed").solve(data)
    assert answer.objective < whole.objective < answer.bound


def solve_without_any_grace(method: str, monkeypatch: pytest.MonkeyPatch) -> WindowSolution:
    """A window whose voltage limit refuses the first served set, with no time at all."""
    monkeypatch.setattr("vppres.solve.task.GRACE_S", 0.0)
    monkeypatch.setattr("vppres.solve.task.GRACE_S_PER_BUS", 0.0)
    day = two_buses([[400.0, 400.0]], [0.1, 1.0], [OPEN], r_ohm=10.0)
    return solve(day, method, limits=SolveLimits(time_s=1e-6))


@pytest.mark.parametrize("method", METHODS)
def test_running_out_of_time_is_not_called_infeasible(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(LimitError) as error:
        solve_without_any_grace(method, monkeypatch)
    assert str(error.value) == (
        "The window of 1 steps was not solved before the time limit. Raise "
        "--time-limit, or use --method decomposed."
    )


def test_a_parameter_takes_only_what_it_is_declared_for() -> None:
    load = cp.Parameter((1, 2), name="P_load", nonneg=True)
    write(load, np.array([[1, -1e-9]]))
    assert load.value.tolist() == [[1.0, -1e-9]]
    with pytest.raises(ModelError, match=r"P_load has the shape \(1, 2\), not \(2,\)\."):
        write(load, [1.0, 2.0])
    with pytest.raises(ModelError, match=r"P_load is never negative, but -0\.5 was given\."):
        write(load, [[1.0, -0.5]])


# Methods and solvers against each other, and against the checker.


@cache
def random_answer(
    seed: int, stressed: bool, method: str, solver: str
) -> tuple[Window, WindowSolution]:
    case = random_window(seed, stressed)
    return case, WindowSolver(Site.of(case.scenario), method, solver).solve(case.data)


@pytest.fixture(scope="module")
def packaged_solvers(packaged: Scenario) -> dict[tuple[str, str], WindowSolver]:
    return {
        key: WindowSolver(Site.of(packaged), *key)
        for key in (("decomposed", "highs"), ("monolithic", "highs"), ("monolithic", "scip"))
    }


@pytest.mark.monolith
@pytest.mark.parametrize(("t0", "steps", "soc"), PACKAGED_WINDOWS)
def test_solvers_and_methods_agree_on_the_packaged_day(
    packaged: Scenario,
    packaged_solvers: dict[tuple[str, str], WindowSolver],
    t0: int,
    steps: int,
    soc: float,
) -> None:
    data = window(packaged, slice(t0, t0 + steps), soc)
    assert_agree(packaged, data, [s.solve(data) for s in packaged_solvers.values()])


@pytest.mark.monolith
@pytest.mark.parametrize(("seed", "stressed"), RANDOM_WINDOWS)
def test_decomposed_equals_monolithic(seed: int, stressed: bool) -> None:
    case, answer = random_answer(seed, stressed, "decomposed", "highs")
    _, other = random_answer(seed, stressed, "monolithic", "highs")
    assert_agree(*case, [answer, other])
    if answer.dispatch.served.all():
        assert everyone_in_reach(Site.of(case.scenario), case.data)


@pytest.mark.monolith
@pytest.mark.parametrize(("seed", "stressed"), CONE_WINDOWS)
def test_decomposed_equals_the_problem_with_cones(seed: int, stressed: bool) -> None:
    case, answer = random_answer(seed, stressed, "decomposed", "highs")
    _, other = random_answer(seed, stressed, "monolithic", "scip")
    assert_agree(*case, [answer, other])


def test_solver_that_wrongly_claims_infeasibility_is_not_believed() -> None:
    """Without batteries nothing couples the steps: the window is feasible since its steps are."""
    case = random_window(*WRONGLY_INFEASIBLE)
    assert len(case.scenario.batteries) == 0
    whole = random_answer(*WRONGLY_INFEASIBLE, "monolithic", "highs")[1]
    alone = [
        WindowSolver(Site.of(case.scenario), "decomposed").solve(case.data.part(slice(t, t + 1)))
        for t in range(case.data.n_steps)
    ]
    assert whole.objective == pytest.approx(sum(a.objective for a in alone), abs=2e-4)
    assert_sound(*case, WindowSolver(Site.of(case.scenario), "decomposed", "scip").solve(case.data))


# Certificates: what status and bounds mean.


def test_optimal_means_within_both_gaps_of_the_objective() -> None:
    """A window of 10 weighted customer hours in which 1 can be served: 1e-4 of 1, not of 10."""
    limits = SolveLimits(gap_rel=1e-4, gap_abs=5e-3)
    assert limits.met(bound=1.00009, objective=1.0)
    assert not limits.met(bound=1.0002, objective=1.0)
    assert not limits.met(bound=100.006, objective=100.0)
    assert limits.met(bound=1e-6, objective=0.0)
    assert not limits.met(bound=2e-6, objective=0.0)


def test_search_goes_on_to_the_gap_of_what_can_be_served() -> None:
    """Gap 1.4e-4 of the objective, 4e-5 of what everyone would be worth, was called optimal."""
    case = random_window(13)
    state = random_state(13, case.scenario)
    data = replace(case.data, switching=state.window(case.data.n_steps))
    answer = WindowSolver(Site.of(case.scenario), "monolithic").solve(data)
    assert answer.status == "optimal"
    assert answer.gap <= SolveLimits().gap_rel
    assert answer.stages.count("full_outer[highs]") == 2


@pytest.mark.parametrize(("seed", "stressed"), NEGATIVE_PRICES)
def test_bounds_hold_where_prices_are_below_zero(seed: int, stressed: bool) -> None:
    case = random_window(seed, stressed)
    data = replace(case.data, price_gbp_per_kwh=case.data.price_gbp_per_kwh - 0.35)
    answers = both_methods(Site.of(case.scenario), data)
    assert_agree(case.scenario, data, answers)
    for answer in answers:
        assert answer.cost_gap_gbp >= 0.0


def test_import_that_is_paid_for_lowers_the_cost_below_zero() -> None:
    # The battery has room for 50 kW and is paid for it; the customer's 100 kW are paid for too.
    day = replace(two_buses([[100.0]], [1.0], [OPEN], price=-0.2), batteries=battery())
    answer = solve(day)
    assert answer.terms.f2 == pytest.approx(-0.2 * 150.0, abs=1e-3)
    assert answer.bound == pytest.approx(answer.objective, abs=1e-6)
    assert answer.cost_gap_gbp == pytest.approx(0.0, abs=1e-2)


# Solvers and stages.


def test_stages_name_the_solver_of_each(packaged: Scenario) -> None:
    """Continuous problems with cones do not follow the flag, and the record says so."""
    data = window(packaged, slice(12, 15), soc=0.5)
    answer = WindowSolver(Site.of(packaged), "decomposed", "scip").solve(data)
    solvers = dict(
        re.fullmatch(r"(\w+)\[(\w+)\](?::\w+)?", stage).groups() for stage in answer.stages
    )
    assert solvers["service"] == solvers["least_cost"] == solvers["cost"] == "scip"
    assert solvers["tie_breakers"] == "clarabel"


@pytest.mark.nightly
def test_random_windows_cover_what_they_are_meant_to() -> None:
    cases = [random_window(*key) for key in RANDOM_WINDOWS]
    dark = [(case.data.grid_limit_kw <= 0).mean() for case in cases]
    assert {len(case.scenario.batteries) for case in cases} >= {0, 1, 2, 3}
    assert {len(case.scenario.pv) == 0 for case in cases} == {True, False}
    assert 0.0 in dark and 1.0 in dark and any(0.0 < share < 1.0 for share in dark)
    assert {case.scenario.grid.step_minutes for case in cases} == {15.0, 30.0, 60.0}
    assert any(np.ptp(case.data.price_gbp_per_kwh) == 0 for case in cases)
    limits = np.concatenate([case.data.grid_limit_kw for case in cases])
    assert ((limits > 0) & np.isfinite(limits)).any()
    lowest = [
        random_answer(*key, "decomposed", "highs")[1].dispatch.v_pu.min() for key in RANDOM_WINDOWS
    ]
    assert sum(v < 0.94701 for v in lowest) >= 2


def has_everything(case: Window) -> bool:
    """Whether PV, batteries and an outage are all there."""
    s = case.scenario
    return len(s.pv) > 0 and len(s.batteries) > 0 and bool((case.data.grid_limit_kw <= 0).any())


def test_checker_finds_a_fault_in_every_equation() -> None:
    """A dispatch that is spoilt in one place fails the equation of that place."""
    case, answer = next(
        random_answer(*key, "decomposed", "highs")
        for key in RANDOM_WINDOWS
        if has_everything(random_window(*key))
    )
    good = answer.dispatch
    spoilt = {
        "exclusivity": replace(
            good, charge_kw=good.charge_kw + 1.0, discharge_kw=good.discharge_kw + 1.0
        ),
        "soc dynamics": replace(good, soc=good.soc + np.linspace(0, 1e-3, len(good.soc))[:, None]),
        "self-consumption": replace(good, pv_self_kw=good.pv_self_kw + 1.0),
        "pv balance": replace(good, pv_export_kw=good.pv_export_kw + 1.0),
        "active balance": replace(good, p_grid_kw=good.p_grid_kw + 1.0),
        "reactive balance": replace(good, q_grid_kvar=good.q_grid_kvar + 1.0),
        "grid limit": replace(good, p_grid_kw=good.p_grid_kw + 1.0),
        "voltage drop": replace(good, p_flow_kw=good.p_flow_kw + 1.0),
        "voltage limits": replace(good, v_pu=good.v_pu * 0.94),
        "battery disc": replace(good, batt_q_kvar=good.batt_q_kvar + 1e3),
        "pv disc": replace(good, pv_q_kvar=good.pv_q_kvar + 1e3),
        "circular charging": replace(good, charge_kw=good.charge_kw + 1e3),
    }
    for name, dispatch in spoilt.items():
        assert check_dispatch(*case, dispatch).violations[name] > CHECKER_TOLERANCE, name


def test_polygons_are_refined_only_if_there_are_inverters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without any the sides grew until memory ran out, if the network refused the answer."""
    searched = []

    def ended(_: object, name: str, form: Form) -> bool:
        searched.append((name, form.polygon_sides))
        return True

    monkeypatch.setattr(whole, "_search", ended)
    loads = SimpleNamespace(batteries=(), pv=())
    task = SimpleNamespace(sides=16, goes_on=True, data=SimpleNamespace(n_steps=6), site=loads)
    whole.with_binaries(cast(WindowTask, task))
    assert searched == [("full_outer", 16), ("full", 16)]
