"""The weighted objective in one solve: its units, its squares, and what its gap leaves open."""

from __future__ import annotations

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from experiments.jobs import Job
from experiments.runner import simulate
from experiments.units import dispatch_in_kw, site_in_unit, window_in_unit
from experiments.weighted import OPTIONS, WeightedChoices, WeightedSolver, squares_of
from experiments.weighted_model import WeightedModel, largest_flow, under_square
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
from vppres.contract.terminal import Terminal
from vppres.core.errors import InfeasibleError, SolveError
from vppres.day.options import RunOptions
from vppres.model.site import Site
from vppres.scenario.scenario import ObjectiveWeights, Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

SHARP = 1e-9
UNITS_KW = (1.0, 1000.0, 1e4)


def solve(
    day: Scenario,
    gap: float = SHARP,
    unit_kw: float = 1.0,
    solver: str = "highs",
    terminal: Terminal | None = None,
) -> WindowSolution:
    """All steps of a scenario as one window."""
    data = replace(window(day), terminal=terminal)
    limits = SolveLimits(gap_rel=gap)
    choices = WeightedChoices(unit_kw=unit_kw)
    return WeightedSolver(Site.of(day), solver, limits, choices).solve(data)


def two_customers() -> Scenario:
    """An outage hour between two with grid; the sun serves one of the two customers."""
    day = two_buses([[30.0, 40.0]] * 3, [0.1, 1.0], [OPEN, DARK, OPEN])
    with_sun = with_pv(day, [20.0, 25.0, 10.0])
    return replace(with_sun, batteries=battery(soc=0.5))


@pytest.mark.parametrize("unit_kw", UNITS_KW)
def test_units_change_numbers_and_nothing_else(unit_kw: float) -> None:
    """A dispatch has the same objective in any unit, term by term."""
    day = two_customers()
    site = Site.of(day)
    data = window(day)
    other = site_in_unit(site, unit_kw)
    model = WeightedModel(other, 3, (), 16, "exact")
    model.fill(window_in_unit(data, unit_kw))
    answer = solve(day)
    found = answer.dispatch
    assert dispatch_in_kw(found, 1.0 / unit_kw).p_grid_kw == pytest.approx(
        found.p_grid_kw / unit_kw
    )
    # The objective is evaluated where the variables are put, nothing is solved.
    for variable, value in (
        (model.v.x_served, found.served),
        (model.v.P_grid, found.p_grid_kw / unit_kw),
        (model.v.P_curt, found.pv_curtailed_kw / unit_kw),
        (model.v.P_flow, found.p_flow_kw / unit_kw),
        (model.v.Q_flow, found.q_flow_kvar / unit_kw),
        (model.v.Q_pv, found.pv_q_kvar / unit_kw),
        (model.v.Q_batt, found.batt_q_kvar / unit_kw),
    ):
        variable.value = np.asarray(value, dtype=float)
    assert model.problem.objective.value == pytest.approx(answer.objective, rel=1e-12)
    assert other.network.r_pu2_per_kw == pytest.approx(unit_kw * site.network.r_pu2_per_kw)


@pytest.mark.parametrize("unit_kw", UNITS_KW)
def test_a_sharp_gap_finds_the_levelled_answer(unit_kw: float) -> None:
    day = two_customers()
    levelled = WindowSolver(Site.of(day)).solve(window(day))
    answer = solve(day, unit_kw=unit_kw)
    assert answer.dispatch.served.tolist() == levelled.dispatch.served.tolist()
    assert answer.objective == pytest.approx(levelled.objective, abs=1e-6)
    assert check_dispatch(day, window(day), answer.dispatch).worst[1] <= CHECKER_TOLERANCE
    assert [stage.partition("[")[0] for stage in answer.stages] == ["weighted"]
    assert answer.bound >= levelled.objective - 1e-6


@pytest.mark.nightly
@pytest.mark.parametrize("solver", ["highs", "scip"])
def test_sharp_answers_of_random_windows_are_those_of_the_ladder(solver: str) -> None:
    wrong = []
    for seed in range(4):
        scenario, data = random_window(seed, stressed=False)
        site = Site.of(scenario)
        ladder = WindowSolver(site).solve(data)
        limits = SolveLimits(gap_rel=1e-6)
        weighted = WeightedSolver(site, solver, limits).solve(data)
        margin = 1e-5 * max(ladder.objective, 1.0)
        if abs(weighted.objective - ladder.objective) > ladder.gap_abs + margin:
            wrong.append((seed, ladder.objective, weighted.objective))
    assert not wrong


def test_what_weighs_less_than_the_gap_is_left_open_and_recorded() -> None:
    """To hold 20 kWh more costs GBP 6.32, which weigh 6e-6 of an objective of 2: below 1e-4."""
    day = two_buses([[10.0]] * 2, [1.0], [OPEN, OPEN])
    day = replace(day, batteries=battery(p_max_kw=1e3, s_max_kva=1e3, soc=0.3))
    wish = Terminal(0.5, 10.0)
    levelled = WindowSolver(Site.of(day)).solve(replace(window(day), terminal=wish))
    loose = solve(day, gap=1e-4, terminal=wish)
    assert loose.status == "optimal"
    worse_gbp = loose.terms.f2 - levelled.terms.f2
    # 2 weighted customer hours at a gap of 1e-4, over the weight of a GBP: all there is is open.
    assert 0.0 <= worse_gbp <= loose.cost_gap_gbp
    open_gbp = loose.terms.f2 - (loose.terms.f1 - loose.bound) / day.objective.lambda_grid
    assert loose.cost_gap_gbp == pytest.approx(min(open_gbp, loose.terms.f2))
    assert loose.service_gap >= 0.0


def test_an_infeasible_window_is_called_so() -> None:
    """The sun exceeds its inverter at an owner who uses more than the inverter takes."""
    day = with_pv(two_buses([[90.0]], [1.0], [OPEN]), [80.0], s_max_kva=50.0)
    data = replace(window(day), delta_pu2=np.full((1, 1), -0.5))
    with pytest.raises(InfeasibleError):
        WeightedSolver(Site.of(day)).solve(data)


# Squares.


def test_tangents_lie_below_the_square_and_near_it() -> None:
    values = np.linspace(-1.0, 1.0, 401)
    y = cp.Variable(len(values), value=values)
    below = values**2 - under_square(y).value
    assert below.min() >= -1e-15
    assert below.max() <= 0.03


def test_the_largest_flow_is_demand_and_devices_behind_a_line() -> None:
    """30 + 40 kW of demand, a PV system of 100 kVA and a battery of 100 kVA."""
    day = two_customers()
    assert largest_flow(Site.of(day), window(day)) == pytest.approx([270.0])


@pytest.mark.parametrize(
    ("lambda_l", "lambda_q", "cones", "expected"),
    [
        (1e-14, 1e-15, False, "none"),
        (1e-14, 1e-15, True, "exact"),
        # 2 lambda_l r P = 2 * 2e-8 * 0.01 * 270 = 1.08e-7 is above a tolerance of 1e-7,
        (2e-8, 1e-15, False, "tangents"),
        # 0.97e-7 below it.
        (1.8e-8, 1e-15, False, "none"),
        # 2 lambda_q / S = 2 * 6e-6 / 100 = 1.2e-7.
        (1e-14, 6e-6, False, "tangents"),
    ],
)
def test_squares_are_left_out_where_no_solver_sees_them(
    lambda_l: float, lambda_q: float, cones: bool, expected: str
) -> None:
    day = two_customers()
    weights = ObjectiveWeights(lambda_l=lambda_l, lambda_q=lambda_q)
    site = Site.of(replace(day, objective=weights))
    assert squares_of(site, window(day), cones, 1e-7) == expected


def test_tangents_bring_the_losses_into_the_objective() -> None:
    """With a weight that a solver sees, the reactive power of a load comes from nearby."""
    day = two_customers()
    weights = ObjectiveWeights(lambda_l=1e-4, lambda_q=1e-15)
    seen = solve(replace(day, objective=weights))
    unseen = solve(day)
    assert seen.terms.f4 < unseen.terms.f4
    assert seen.bound >= seen.objective


# Options.


@pytest.mark.parametrize("solver", OPTIONS)
def test_each_solver_is_told_all_choices(solver: str) -> None:
    told = dict(OPTIONS[solver](3e-4, WeightedChoices(tolerance=2e-8, seed=7), 11.0))
    told |= told.pop("scip_params", {})
    assert {3e-4, 2e-8, 7, 11.0} <= set(told.values())


def test_the_seed_and_the_gap_reach_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[float, WeightedChoices]] = []
    ask = OPTIONS["highs"]

    def listen(gap: float, choices: WeightedChoices, time_s: float) -> object:
        told.append((gap, choices))
        return ask(gap, choices, time_s)

    monkeypatch.setitem(OPTIONS, "highs", listen)
    day = two_buses([[10.0]], [1.0], [OPEN])
    choices = WeightedChoices(seed=3)
    limits = SolveLimits(gap_rel=1e-3)
    WeightedSolver(Site.of(day), limits=limits, choices=choices).solve(window(day))
    assert set(told) == {(1e-3, choices)}


def test_a_day_whose_fallbacks_hide_a_mistake_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def solve(*_: object) -> WindowSolution:
        raise TypeError("no dict")

    monkeypatch.setattr(WeightedSolver, "solve", solve)
    job = Job(options=RunOptions(horizon_h=0.0), weighted=WeightedChoices())
    with pytest.raises(SolveError, match=r"horizon_h = 0\.0.*TypeError: no dict"):
        simulate(job)
