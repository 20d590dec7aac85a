"""An answer is one that keeps every row of its window, whatever a solver calls it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import Window, random_state, random_window
from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import CHECKER_TOLERANCE, OPEN, two_buses, window
from vppres.control.converged import physics_of
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken, excesses
from vppres.scenario.network import Network
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution

CALLED_SOLVED = 121
"""A window without dispatch that interior points solve "inaccurately", 6e-4 pu² outside."""


def infeasible(seed: int) -> tuple[Site, Window]:
    """A random window under rules whose voltage limits miss a dispatch by a hair."""
    rng = np.random.default_rng([seed, 98])
    form = rng.choice(["paper", "rules", "physical"])
    scenario, data = random_window(seed, stressed=True)
    site = Site.of(scenario)
    net = scenario.network
    scale = 10 ** rng.uniform(-2.5, -1)
    offset = rng.normal(0, scale, net.n_lines)
    data = replace(data, delta_pu2=np.tile(offset, (data.n_steps, 1)))
    if form == "rules":
        data = replace(data, switching=random_state(seed, scenario).window(data.n_steps))
    if form == "physical":
        data = replace(data, physics=physics_of(site, data, 0.1))
    slack = WindowSolver(site).least_slack(data)
    assert slack >= 1e-6
    given = slack * (1 - 10 ** rng.uniform(-6, -1))
    network = replace(
        net,
        v_min_pu=np.sqrt(net.v_min_pu**2 - given),
        v_max_pu=np.sqrt(net.v_max_pu**2 + given),
    )
    return replace(site, network=network), Window(replace(scenario, network=network), data)


def answer(site: Site, data: WindowData) -> WindowSolution | None:
    try:
        return WindowSolver(site, limits=SolveLimits(time_s=20.0)).solve(data)
    except SolveError:
        return None


@pytest.mark.parametrize("seed", [CALLED_SOLVED, 7, 37, 56])
def test_no_answer_breaks_a_row_of_its_window(seed: int) -> None:
    site, (scenario, data) = infeasible(seed)
    solution = answer(site, data)
    if solution is not None:
        served = solution.dispatch.served
        state = None if data.switching is None else random_state(seed, scenario)
        check = check_dispatch(scenario, data, solution.dispatch, state)
        assert check.worst[1] <= 10 * CHECKER_TOLERANCE, check.worst
        assert broken(site, data.for_service(served), solution.dispatch) == []


def test_an_inaccurate_solution_is_no_answer() -> None:
    assert not Status.INACCURATE.has_answer


# The check itself: every row of a dispatch is found when it is broken, and none else is.

BREAKS: dict[str, set[str]] = {
    "charge_kw": {"state of charge", "active balance"},
    "discharge_kw": {"state of charge", "active balance"},
    "soc": {"state of charge"},
    "batt_q_kvar": {"reactive balance"},
    "pv_q_kvar": {"reactive balance"},
    "pv_self_kw": {"self-consumption", "pv balance", "active balance"},
    "pv_export_kw": {"pv balance", "active balance"},
    "pv_curtailed_kw": {"pv balance"},
    "p_grid_kw": {"active balance"},
    "q_grid_kvar": {"reactive balance"},
    "v_pu": {"voltage drop"},
    "p_flow_kw": {"active balance", "voltage drop"},
    "q_flow_kvar": {"reactive balance", "voltage drop"},
    "served": {"active balance", "reactive balance"},
}
ALL_DEVICES = 24
"""A seed whose feeder has batteries and PV systems."""


def test_the_check_finds_every_array_that_is_changed() -> None:
    scenario, data = random_window(ALL_DEVICES)
    site = Site.of(scenario)
    solution = WindowSolver(site).solve(data)
    right = solution.dispatch
    assert max(excesses(site, data, right).values()) < 0.1
    assert right.arrays().keys() == BREAKS.keys()
    for name, rows in BREAKS.items():
        value = getattr(right, name)
        wrong = value.copy()
        wrong[-1] = ~value[-1] if name == "served" else value[-1] + 10.0
        found = broken(site, data, replace(right, **{name: wrong}))
        assert rows <= set(found), (name, found)


def test_a_value_that_is_no_number_breaks_its_rows() -> None:
    scenario, data = random_window(ALL_DEVICES)
    site = Site.of(scenario)
    right = WindowSolver(site).solve(data).dispatch
    wrong = np.full_like(right.v_pu, np.nan)
    assert "voltage drop" in broken(site, data, replace(right, v_pu=wrong))


def test_voltages_are_judged_by_the_powers_and_not_by_what_a_solver_reports() -> None:
    """Each line's drop misses by less than its tolerance: at the end of 30 lines it is too much."""
    day = two_buses([[40.0]], [1.0], [OPEN])
    n = 30
    net = Network([*range(1, n + 1)], [*range(2, n + 2)], [4.0] * n, [4.0] * n, 1, base_kv=11.0)
    day = replace(day, network=net, customers=replace(day.customers, bus=[n + 1]))
    right = WindowSolver(Site.of(day)).solve(window(day)).dispatch
    low = float(right.v_pu.min())
    tight = replace(net, v_min_pu=np.sqrt(low**2 + 1e-4))
    site = replace(Site.of(day), network=tight)
    reported = np.sqrt(right.v_pu**2 + 9e-6 * np.arange(n + 1))
    told = replace(right, v_pu=reported)
    assert reported.min() > tight.v_min_pu
    assert broken(site, window(day), told) == ["lowest voltage"]


@pytest.mark.parametrize("seed", [43, 45, 46, 50, 51, 53, 55, 67, 83, 97])
def test_a_state_of_charge_outside_by_rounding_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng([seed, 97])
    scenario, data = random_window(seed, stressed=bool(seed % 2))
    site = Site.of(scenario)
    b = scenario.batteries
    empty = rng.random(len(b)) < 0.5
    at_limit = replace(data, soc=np.where(empty, b.soc_min, b.soc_max))
    outside = replace(data, soc=np.where(empty, b.soc_min - 1e-9, b.soc_max + 1e-9))
    solver = WindowSolver(site)
    one = solver.solve(at_limit)
    other = solver.solve(outside)
    assert other.status == one.status == "optimal"
    assert other.objective == pytest.approx(one.objective, abs=1e-6)
