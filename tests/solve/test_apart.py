"""Windows whose steps nothing joins: solved one by one, and equal to what one problem finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
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
from vppres.core.errors import InfeasibleError
from vppres.io import find_scenario, read_scenario
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import SwitchingState
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.apart import falls_apart, solve_apart
from vppres.solve.cache import shared_cache
from vppres.solve.dispatch import cheapest
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import SolveLimits, Status, WindowSolution
from vppres.solve.solvers import find_solver
from vppres.solve.task import WindowTask
from vppres.studies.sweep_parameters import scenario_changes

RANDOM = [(seed, stressed) for stressed in (False, True) for seed in range(60)]
"""Of these, the windows without batteries are taken."""


def two_dark_steps() -> Scenario:
    """PV of 10 kW at noon and of 4 kW later; customers of 3, 4 and 6 kW."""
    day = two_buses([[3.0, 4.0, 6.0], [3.0, 4.0, 6.0], [3.0, 4.0, 6.0]], [1.0, 0.9, 0.8], [0, 0, 0])
    return replace(with_pv(day, [10.0, 4.0, 0.0]), grid_limit_kw=np.array([DARK, DARK, OPEN]))


def test_each_step_serves_what_its_own_sun_carries() -> None:
    scenario = two_dark_steps()
    answer = WindowSolver(Site.of(scenario)).solve(window(scenario))
    # 10 kW: 4 + 6 loses nothing and serves 1.7; 3 + 6 would lose a kW (0.1) for 1.8, which is equal,
    # 3 + 4 serve 1.9 and lose 3 kW (0.3). 4 kW: the second alone (0.9) beats the first less its
    # lost kW (1.0 - 0.1) by nothing. With the grid everyone is served.
    assert answer.status == Status.OPTIMAL
    assert answer.objective == pytest.approx(1.7 + 0.9 + 2.7, abs=1e-5)
    assert answer.bound == pytest.approx(answer.objective, abs=1e-5)
    assert answer.dispatch.served[2].all()
    assert answer.dispatch.soc.shape == (4, 0)
    assert check_dispatch(scenario, window(scenario), answer.dispatch).worst[1] < CHECKER_TOLERANCE


def test_gaps_of_steps_that_gain_and_lose_are_closed_for_their_sum() -> None:
    # 2.7 served and 4.4 of sun lost at noon; 0.9 later; 2.7 with the grid: 1.9 of 5.3 in all.
    scenario = replace(two_dark_steps(), pv_kw=np.array([[57.0], [4.0], [0.0]]))
    solver = WindowSolver(Site.of(scenario))
    asked = list[float]()

    def leaving(part: WindowData, limits: SolveLimits) -> WindowSolution:
        """The best answer with a bound that leaves most of the gap open."""
        found = solver.solve(part)
        asked.append(limits.gap_at(found.objective))
        return replace(found, bound=found.objective + 0.9 * asked[-1])

    limits = SolveLimits()
    answer = solve_apart(window(scenario), limits, leaving)
    assert answer.objective == pytest.approx(1.9, abs=1e-4)
    assert 0.9 * sum(asked[:3]) > limits.gap_at(answer.objective)  # each was within its own gap
    assert answer.status == Status.OPTIMAL
    assert 3 < len(asked) <= 6


def test_batteries_and_rules_join_steps() -> None:
    scenario = two_dark_steps()
    data = window(scenario)
    assert falls_apart(Site.of(scenario), data)
    assert not falls_apart(Site.of(scenario), data.first(1))
    stored = replace(scenario, batteries=battery())
    assert not falls_apart(Site.of(stored), window(stored))
    rules = SwitchingRules(min_served_h=2.0)
    state = SwitchingState.start(rules, scenario.grid.dt_h, len(scenario.customers))
    assert not falls_apart(Site.of(scenario), replace(data, switching=state.window(3)))


def test_batteries_of_a_watt_are_none() -> None:
    scenario = two_dark_steps()
    watt = replace(scenario, batteries=battery(p_max_kw=1e-3, s_max_kva=1e-3))
    assert falls_apart(Site.of(watt), window(watt))
    without, with_them = (WindowSolver(Site.of(s)).solve(window(s)) for s in (scenario, watt))
    assert with_them.objective == pytest.approx(without.objective, abs=1e-6)
    assert (with_them.dispatch.served == without.dispatch.served).all()
    assert not with_them.dispatch.charge_kw.any()
    assert not with_them.dispatch.discharge_kw.any()
    check = check_dispatch(watt, window(watt), with_them.dispatch)
    assert check.worst[1] < CHECKER_TOLERANCE


@pytest.mark.parametrize("idle", [False, True])
def test_under_rules_nothing_stored_is_searched_with_all_terms(idle: bool) -> None:
    scenario = two_dark_steps()
    if idle:
        scenario = replace(scenario, batteries=battery(p_max_kw=1e-3, s_max_kva=1e-3))
    rules = SwitchingRules(min_unserved_h=2.0)
    state = SwitchingState.start(rules, scenario.grid.dt_h, len(scenario.customers))
    data = replace(window(scenario), switching=state.window(3))
    answer, whole = (WindowSolver(Site.of(scenario), method).solve(data) for method in METHODS)
    assert answer.stages[0] == "aggregate[highs]"
    assert answer.status == Status.OPTIMAL
    gap = SolveLimits().gap_at(whole.objective)
    assert answer.objective == pytest.approx(whole.objective, abs=2 * gap)
    assert answer.bound >= whole.objective - 1e-6
    check = check_dispatch(scenario, data, answer.dispatch, state)
    assert check.worst[1] < CHECKER_TOLERANCE


@pytest.mark.daily
@pytest.mark.monolith
def test_random_windows_without_batteries_equal_the_monolith(nightly: bool) -> None:
    cases = [case for case in (random_window(*key) for key in RANDOM) if not len(case.data.soc)]
    assert len(cases) >= 10
    wrong = []
    for case in cases if nightly else cases[:4]:
        site = Site.of(case.scenario)
        apart, whole = (
            WindowSolver(site, method).solve(case.data) for method in ("decomposed", "monolithic")
        )
        gap = SolveLimits().gap_at(whole.objective)
        sound = (
            apart.status == Status.OPTIMAL
            and apart.bound >= whole.objective - 1e-6
            and abs(apart.objective - whole.objective) <= 2 * gap
        )
        if not sound:
            wrong.append((case.scenario.name, apart.objective, whole.objective))
    assert not wrong


def test_a_step_without_dispatch_is_told() -> None:
    scenario = two_dark_steps()
    # What an owner uses of its own power is an equality: 10 kW do not pass an inverter of 2 kVA.
    narrow = with_pv(scenario, [10.0, 4.0, 0.0], s_max_kva=2.0)
    heavy = replace(narrow, pv_kw=np.full((3, 1), 10.0))
    low = replace(heavy.network, v_slack_pu=0.5)
    with pytest.raises(InfeasibleError):
        WindowSolver(Site.of(replace(heavy, network=low))).solve(window(heavy))


def test_the_packaged_day_without_batteries_is_certified_in_the_outage() -> None:
    day = read_scenario(find_scenario("uk-heatwave-2022"))
    packaged = scenario_changes(day)["scale.batteries"](day, 0.0)
    data = window(packaged, slice(11, 14))
    answer = WindowSolver(Site.of(packaged)).solve(data)
    assert answer.status == Status.OPTIMAL
    assert answer.gap_abs <= SolveLimits().gap_at(answer.objective)


def test_modes_are_dispatched_where_rounding_took_their_energy() -> None:
    # 10 kWh at the terminals take 10 / 0.95 of the battery; 1e-6 kWh of it are gone.
    needed_kwh = 10.0 / battery().eta_discharge[0]
    soc = 0.15 + (needed_kwh - 1e-6) / 100.0
    scenario = replace(two_buses([[10.0]], [1.0], [DARK]), batteries=battery(soc=soc))
    cache = shared_cache(Site.of(scenario))
    modes = {"delta": np.zeros((1, 1))}
    served = np.ones((1, 1), dtype=bool)
    limits, highs = SolveLimits(time_s=10.0), find_solver("highs")
    task = WindowTask(window(scenario), cache, limits, highs, 0)
    found = cheapest(task, served, modes=modes)
    assert found.dispatch.discharge_kw[0, 0] == pytest.approx(10.0)
    less = replace(scenario, batteries=battery(soc=soc - 1e-6))
    task = WindowTask(window(less), cache, limits, highs, 0)
    assert cheapest(task, served, modes=modes) is None
