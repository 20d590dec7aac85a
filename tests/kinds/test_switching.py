"""Switching rules: hand-solved windows, methods against each other, the state, real days."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_state, random_window
from tests.support.agreement import assert_agree, assert_holds
from tests.support.dispatch_check import check_dispatch
from tests.support.made_up_runs import without_devices
from tests.support.refusals import refusal
from tests.support.small_windows import (
    DARK,
    OPEN,
    battery,
    island,
    observed,
    two_buses,
    window,
)
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.moves import Moves
from vppres.contract.observation import Observation
from vppres.control.planner import OnePass, plan_with_rules
from vppres.core.errors import InfeasibleError
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer import rows as switching_rules
from vppres.kinds.customer.data import RuleSteps, SwitchingRules
from vppres.kinds.customer.physics import LongestOff, SwitchingData, SwitchingState
from vppres.kinds.customer.rows import SwitchingModel
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import WindowSolution

PAGE = Path(__file__).parents[2] / "docs" / "switching.md"
RANDOM = [
    (seed, stressed) for stressed, count in ((False, 30), (True, 20)) for seed in range(count)
]


def state_of(
    rules: SwitchingRules,
    served: Sequence[bool],
    since_h: Sequence[float],
    actions: Sequence[int] | None = None,
) -> SwitchingState:
    """A state in hourly steps."""
    return SwitchingState(
        rules,
        1.0,
        np.array(served),
        np.array(since_h, dtype=float),
        np.array(actions or [0] * len(served), dtype=float),
        np.full(len(served), np.inf),
    )


def solved(day: Scenario, state: SwitchingState, method: str) -> WindowSolution:
    """All steps of a scenario as one window with rules."""
    data = window(day)
    data = replace(data, switching=state.window(data.n_steps))
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert_holds(day, data, answer, state)
    return answer


NEVER = float("inf")


# Hand-solved windows.


ONE_ACTION = SwitchingRules(max_actions_per_customer=1)
ON, OFF = ([True], [NEVER], [0]), ([False], [5.0], [0])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("last_kw", "rules", "before", "step", "expected"), [
    # The third hour is supplied only if the customer may be on again.
    (10.0, SwitchingRules(), ON, 0, [True, False, True]),
    (10.0, SwitchingRules(min_unserved_h=2.0), ON, 0, [True, False, False]),
    # Who may not be dropped in the middle is restored in the last hour only.
    (9.0, SwitchingRules(), OFF, 0, [True, False, True]),
    (9.0, SwitchingRules(min_served_h=2.0), OFF, 0, [False, False, True]),
    (9.0, SwitchingRules(stay_restored=True), OFF, 0, [False, False, True]),
    (9.0, ONE_ACTION, OFF, 0, [False, False, True]),
    (9.0, SwitchingRules(max_actions_per_customer=3), OFF, 0, [True, False, True]),
    # The limit holds for each day of a window.
    (9.0, ONE_ACTION, ON, 0, [True, False, False]),  # one day: off is all that is left
    (9.0, ONE_ACTION, ON, 22, [True, False, True]),  # midnight before the last hour
    (9.0, ONE_ACTION, ([False], [NEVER], [1]), 22, [False, False, True]),  # today's is spent
    (9.0, ONE_ACTION, ON, 23, [True, False, False]),  # midnight before the middle: one day for both
])  # fmt: skip
def test_rules_say_who_is_on_of_three_hours(
    method: str,
    last_kw: float,
    rules: SwitchingRules,
    before: tuple[list[bool], list[float], list[int]],
    step: int,
    expected: list[bool],
) -> None:
    """21 kWh carry the first and the last hour, but not the one of 100 kW in the middle."""
    day = island([[10.0], [100.0], [last_kw]], [1.0], 21.0)
    answer = solved(day, replace(state_of(rules, *before), step=step), method)
    assert answer.dispatch.served[:, 0].tolist() == expected


def test_actions_of_yesterday_do_not_count() -> None:
    state = SwitchingState.start(SwitchingRules(max_actions_per_customer=2), 6.0, 1)
    left = []
    for served in (False, True, True, True, True, False):
        left.append(state.window(1).actions_left[0, 0])
        state = state.advance(np.array([served]))
    # Steps of six hours: off and on in the first two, midnight after the fourth.
    assert left == [2.0, 1.0, 0.0, 0.0, 2.0, 2.0]
    assert state.window(6).day.tolist() == [0, 0, 1, 1, 1, 1]
    assert state.window(6).actions_left[:, 0].tolist() == [1.0, 2.0]


def test_a_window_within_a_day_has_one_limit() -> None:
    """Rules without a limit of actions never look at days, so that they compile nothing more."""
    for rules, days in (
        (SwitchingRules(min_served_h=1.0), 1),
        (SwitchingRules(max_actions_per_customer=2), 2),
    ):
        state = replace(SwitchingState.start(rules, 1.0, 2), step=20)
        assert (state.window(4).steps.days, state.window(5).steps.days) == (1, days)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("price", "actions"), [(0.0, 4), (0.04, 4), (0.06, 2)])
def test_price_refuses_what_gains_less_than_it_costs(
    method: str, price: float, actions: int
) -> None:
    # Serving the customer for one more hour gains 0.1; it takes another off/on pair.
    day = island([[10.0], [100.0], [10.0], [100.0], [10.0]], [0.1], 31.0)
    day = replace(day, grid_limit_kw=np.array([DARK] * 4 + [OPEN]))
    answer = solved(day, state_of(SwitchingRules(price_per_action=price), [True], [NEVER]), method)
    on_off = np.abs(np.diff([1, *answer.dispatch.served[:, 0]])).sum()
    assert (on_off, answer.terms.f6) == (actions, pytest.approx(actions * price))
    assert answer.dispatch.served[:, 0].sum() == (3 if actions == 4 else 2)


@pytest.mark.parametrize("method", METHODS)
def test_price_leaves_nobody_in_the_dark(method: str) -> None:
    # The one hour gains 0.02 and the restoration was paid for with the interruption.
    day = two_buses([[10.0]], [0.02], [OPEN])
    answer = solved(day, state_of(SwitchingRules(price_per_action=1.0), [False], [3.0]), method)
    assert (answer.dispatch.served.all(), answer.terms.f6) == (True, 0.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("factor", "served"), [(1.0, True), (1.6, True), (1.7, False)])
def test_cold_load_needs_more_energy(method: str, factor: float, served: bool) -> None:
    # 41 kWh for a customer of 25 kW: enough for 1.64 times as much.
    day = island([[25.0]], [1.0], 41.0)
    state = state_of(SwitchingRules(cold_load_factor=factor, cold_load_h=1.0), [False], [1.0])
    answer = solved(day, state, method)
    assert answer.dispatch.served[0, 0] == served
    assert answer.dispatch.discharge_kw.sum() == pytest.approx(25.0 * factor * served, abs=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_cold_load_of_an_earlier_restoration_lasts(method: str) -> None:
    rules = SwitchingRules(cold_load_factor=2.0, cold_load_h=3.0)
    day = island([[10.0]] * 4, [1.0], 100.0)
    answer = solved(day, state_of(rules, [True], [1.0]), method)
    assert answer.dispatch.discharge_kw.sum(axis=1) == pytest.approx([20, 20, 10, 10], abs=1e-3)


def test_half_a_restoration_is_half_as_cold(tiny: Scenario) -> None:
    site = Site.of(tiny)
    W, C = 4, len(site.customers)
    x = cp.Variable((W, C))
    rules = switching_rules.SwitchingModel(site, x, RuleSteps(1, 1, 2))
    cold = rules.cold
    rules.x_before.value = np.ones(C)
    rules.x_min.value, rules.x_max.value = np.zeros((W, C)), np.ones((W, C))
    rules.actions_left.value = np.full((1, C), 2.0 * W)
    rules.cold_before.value = np.zeros((W, C))
    shares = np.array([1.0, 0.25, 0.75, 0.75])[:, None]
    held = [*rules.constraints.values(), x == np.tile(shares, C)]
    problem = cp.Problem(cp.Minimize(cp.sum(cold.z)), held)
    problem.solve(solver=cp.HIGHS)
    # Restored two steps ago or less are the half that was off at the second step.
    assert cold.z.value[:, 0] == pytest.approx([0.0, 0.0, 0.5, 0.5])


def test_interruption_that_cannot_be_ended_is_not_shortened() -> None:
    # The grid is back, but the customer was switched off an hour ago and has two hours to go.
    day = two_buses([[10.0]] * 3, [1.0], [OPEN] * 3)
    answer = solved(day, state_of(SwitchingRules(min_unserved_h=3.0), [False], [1.0]), "decomposed")
    assert answer.dispatch.served[:, 0].tolist() == [False, False, True]


def test_minimum_times_count_in_steps_of_any_length() -> None:
    rules = SwitchingRules(min_served_h=0.6, min_unserved_h=0.25)
    data = replace(state_of(rules, [True], [0.25]), dt_h=0.25).window(4)
    assert data.steps == RuleSteps(served=3, unserved=1, cold=0)
    # One of the three quarters of an hour is over.
    assert data.served_min[:, 0].tolist() == [True, True, False, False]


# Duties that cannot be met.


def seen(day: Scenario, state: SwitchingState) -> Observation:
    """All steps of a scenario, as a controller sees them."""
    b = day.batteries
    forecast = Forecast(
        day.load_kw,
        day.pv_kw,
        day.price_gbp_per_kwh,
        day.grid_limit_kw,
        day.temperature_c,
        out=day.out_of_service(range(day.grid.n_steps)),
    )
    return replace(observed(day, 0, forecast, b.soc_initial), switching=state)


@pytest.mark.parametrize(("rules", "idle"), [
    (SwitchingRules(min_served_h=1.0, min_unserved_h=0.3), True),
    (SwitchingRules(max_actions_per_customer=3), True),
    (SwitchingRules(max_actions_per_customer=2), False),
    (SwitchingRules(min_served_h=1.1), False),
    (SwitchingRules(min_unserved_h=1.1), False),
    (SwitchingRules(price_per_action=0.01), False),
    (SwitchingRules(cold_load_factor=1.5), False),
    (SwitchingRules(stay_restored=True), False),
])  # fmt: skip
def test_rules_that_say_nothing_in_a_window_do_not_join_its_steps(
    rules: SwitchingRules, idle: bool
) -> None:
    day = island([[10.0], [100.0], [9.0]], [1.0], 21.0)
    observation = seen(day, SwitchingState.start(rules, 1.0, 1))
    assert (observation.rules is None) == idle


def test_duties_and_waiting_times_are_rules_yet() -> None:
    """The end of a restoration's duty, or of a time unserved, reaches into a window of one step."""
    day = island([[10.0]], [1.0], 21.0)
    for served, rules in ((True, {"min_served_h": 3.0}), (False, {"min_unserved_h": 3.0})):
        late = seen(day, state_of(SwitchingRules(**rules), [served], [3.0]))
        early = seen(day, state_of(SwitchingRules(**rules), [served], [1.0]))
        assert late.rules is None and early.rules is not None


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("energy_kwh", "served", "let_go"), [(15.0, [False, True], True), (35.0, [True, False], False)]
)
def test_duty_is_let_go_only_where_it_cannot_be_met(
    method: str, energy_kwh: float, served: list[bool], let_go: bool
) -> None:
    # With 35 kWh the duty costs the critical customer: 30 go to the one that was just restored.
    day = island([[30.0, 10.0]], [0.1, 1.0], energy_kwh)
    state = state_of(SwitchingRules(min_served_h=2.0), [True, True], [1.0, NEVER])
    planner = OnePass(WindowSolver(Site.of(day), method))
    answer = plan_with_rules(planner, seen(day, state))
    assert (answer.switching_relaxed, answer.dispatch.served[0].tolist()) == (let_go, served)


def test_infeasible_window_without_rules_stays_so() -> None:
    day = two_buses([[10.0]], [1.0], [OPEN])
    day = replace(day, network=replace(day.network, v_slack_pu=0.94))
    observation = seen(day, state_of(SwitchingRules(), [True], [NEVER]))
    with pytest.raises(InfeasibleError, match="no feasible dispatch"):
        plan_with_rules(OnePass(WindowSolver(Site.of(day))), observation)


def test_nobody_has_a_duty_in_the_dark() -> None:
    state = state_of(SwitchingRules(min_served_h=3.0), [True], [1.0])
    data = state.window(3)
    assert data.served_min[:, 0].tolist() == [True, True, False]
    dark = data.in_the_dark(np.array([True, False, False]))
    assert (dark.served_min.any(), dark.served_max[:, 0].tolist()) == (False, [False, True, True])


# Methods against each other and against the checker.


@pytest.mark.monolith
@pytest.mark.parametrize(("seed", "stressed"), RANDOM)
def test_decomposed_equals_monolithic_with_rules(seed: int, stressed: bool) -> None:
    case = random_window(seed, stressed)
    state = random_state(seed, case.scenario)
    data = replace(case.data, switching=state.window(case.data.n_steps))
    answers = []
    for method in METHODS:
        try:
            answers.append(WindowSolver(Site.of(case.scenario), method).solve(data))
        except InfeasibleError:
            continue
    assert len(answers) in (0, 2)
    assert_agree(case.scenario, data, answers, state)


@pytest.mark.parametrize("seed", range(40))
def test_rules_are_judged_as_the_checker_judges_them(seed: int) -> None:
    """Random service, most of it against some rule: the package's own check finds the same."""
    case = random_window(seed)
    state, rng = random_state(seed, case.scenario), np.random.default_rng(seed)
    answer = WindowSolver(Site.of(case.scenario)).solve(case.data).dispatch
    data = state.window(answer.n_steps)
    for _ in range(5):
        served = rng.random(answer.served.shape) < 0.6
        found = check_dispatch(case.scenario, case.data, replace(answer, served=served), state)
        kinds = ("min served", "min unserved", "stay restored", "actions")
        assert data.broken(served).any() == any(found.violations[kind] > 0 for kind in kinds)


@pytest.mark.parametrize("seed", range(10))
def test_cold_load_lasts_for_its_steps_after_each_restoration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rules = SwitchingRules(cold_load_factor=1.5, cold_load_h=float(rng.uniform(0.0, 2.0)))
    lasts = max(ceil(rules.cold_load_h / 0.5), 1)
    ahead = rng.random((12, 6)) < 0.7
    factors = np.ones((12, 6))
    for c, on in enumerate(ahead.T):
        for first in np.flatnonzero(np.diff(np.concatenate([[True], on]).astype(int)) == 1):
            still_on = np.cumprod(on[first : first + lasts]).sum()
            factors[first : first + still_on, c] = 1.5
    state = SwitchingState.start(rules, 0.5, 6)
    for t, served in enumerate(ahead):
        assert state.demand_factor(served).tolist() == factors[t].tolist()
        assert state.window(12 - t).demand_factor(ahead[t:]).tolist() == factors[t:].tolist()
        state = state.advance(served)


# Real days.


def broken_rules(run: Trajectory, rules: SwitchingRules) -> int:
    """Actions of a day that break a rule, counted along the record."""
    x = run.customers["served"].to_numpy(bool).reshape(len(run.steps), -1)
    dt_h, count = run.scenario.grid.dt_h, 0
    for c in range(x.shape[1]):
        at = np.flatnonzero(np.diff(np.concatenate([[True], x[:, c]]).astype(int)))
        lengths_h = np.diff(at) * dt_h
        least = np.where(x[at[:-1], c], rules.min_served_h, rules.min_unserved_h)
        count += int((lengths_h < least - 1e-9).sum())
        count += int(rules.stay_restored) * int(len(at) > 2)
    return count


@pytest.mark.nightly
@pytest.mark.parametrize(("controller", "rules"), [
    ("mpc", SwitchingRules(min_served_h=2.0, min_unserved_h=2.0)),
    ("full-horizon", SwitchingRules(min_unserved_h=3.0, stay_restored=True)),
])  # fmt: skip
def test_real_day_obeys_the_rules(
    packaged: Scenario, nightly: bool, controller: str, rules: SwitchingRules
) -> None:
    day = packaged if nightly else packaged.between(10, 19)
    options = RunOptions(controller, switching=rules, errors=ForecastErrors(pv_bias=0.3))
    run = run_day(day, options)
    assert not run.steps["switching_relaxed"].any()
    assert broken_rules(run, rules) == 0
    free = run_day(day, replace(options, switching=SwitchingRules()))
    assert broken_rules(free, rules) > 0


@pytest.mark.parametrize("options", [None, RunOptions(), RunOptions(switching=SwitchingRules())])
def test_rules_of_a_scenario_hold_unless_a_run_has_its_own(
    tiny: Scenario, options: RunOptions | None
) -> None:
    rules = SwitchingRules(min_unserved_h=3.0)
    run = run_day(replace(tiny, switching=rules), options)
    followed = options is None or options.switching is None
    assert (broken_rules(run, rules) == 0) == followed


@pytest.mark.parametrize("controller", ["mpc", "perfect"])
def test_limit_of_actions_that_an_outage_breaks_is_let_go(tiny: Scenario, controller: str) -> None:
    none_at_all = SwitchingRules(max_actions_per_customer=0)
    run = run_day(without_devices(tiny), RunOptions(controller, switching=none_at_all))
    assert set(run.steps["fallback"]) == {"none"}
    assert run.steps["switching_relaxed"][0]
    served = run.customers["served"].to_numpy(bool).reshape(6, 3)
    assert served[:3].all()


@pytest.mark.daily
def test_recorded_demand_is_higher_after_a_restoration(tiny: Scenario) -> None:
    rules = SwitchingRules(cold_load_factor=1.5, cold_load_h=1.0)
    run = run_day(tiny, RunOptions(horizon_h=2.0, switching=rules))
    x = run.customers["served"].to_numpy(bool).reshape(6, 3)
    load = run.customers["p_load_kw"].to_numpy().reshape(6, 3)
    before = np.vstack([np.ones(3, bool), x[:-1]])
    assert (x & ~before).any()
    assert load == pytest.approx(tiny.load_kw * np.where(x & ~before, 1.5, 1.0))


# Moves away from the plan before.


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_batteries_follow_the_plan_before_where_nothing_else_decides(weight: float) -> None:
    # Two equal batteries at one bus share 30 kW anyhow; the plan before had 25 and 5.
    day = replace(two_buses([[30.0]], [1.0], [DARK]), batteries=battery(soc=0.85, count=2))
    data = window(day)
    if weight:
        data = replace(data, moves=Moves(np.array([[-25.0, -5.0]]), weight))
    answer = WindowSolver(Site.of(day)).solve(data)
    assert answer.dispatch.discharge_kw.sum() == pytest.approx(30.0, abs=1e-3)
    near = np.abs(answer.dispatch.discharge_kw[0] - [25.0, 5.0]).max() < 0.01
    assert near == (weight > 0)


def test_steps_that_the_plan_before_did_not_reach_are_free() -> None:
    before = Moves.of(np.array([[1.0, 2.0], [3.0, 4.0]]), 1, 2, 0.25)
    factor, value = before.targets(np.array([10.0, 5.0]))
    assert factor == pytest.approx(np.array([[0.05, 0.1], [0.0, 0.0]]))
    assert value == pytest.approx(np.array([[0.15, 0.4], [0.0, 0.0]]))


@pytest.mark.nightly
def test_fewer_moves_cost_no_service(packaged: Scenario) -> None:
    errors = ForecastErrors(load_alpha_per_h=0.1, pv_alpha_per_h=0.1)
    found = [
        summarise(
            run_day(
                packaged, RunOptions(errors=errors, switching=SwitchingRules(move_weight=weight))
            )
        )
        for weight in (0.0, 10.0)
    ]
    assert found[1]["setpoint_moves_kw"] < 0.9 * found[0]["setpoint_moves_kw"]
    assert found[1]["resilience"] >= found[0]["resilience"] - 0.002


# The rules themselves.


@pytest.mark.parametrize(
    ("rules", "left"),
    [
        pytest.param(rules, left, marks=() if left == n % 2 else pytest.mark.nightly)
        for n, rules in enumerate([(1, 1, 1), (1, 1, 3), (2, 1, 2), (2, 1, 4), (3, 2, 2)])
        for left in (0, 1)
    ],
)
def test_demand_is_higher_just_where_the_state_says_so(
    tiny: Scenario, rules: tuple[int, int, int], left: int
) -> None:
    """Of every service of five steps that obeys the rules, least and most of it in the model."""
    steps, W = RuleSteps(*rules), 5
    past = SwitchingData(
        steps,
        served_before=np.full(3, left > 0),
        served_min=np.zeros((W, 3), dtype=bool),
        served_max=np.ones((W, 3), dtype=bool),
        actions_left=np.full((1, 3), 10.0),
        price_per_action=0.0,
        cold_factor=2.0,
        cold_before=np.repeat(np.arange(W)[:, None] < left, 3, axis=1),
        day=np.zeros(W, dtype=int),
        longest_off=LongestOff.of(np.full(3, np.inf), np.zeros(3), 1.0, W),
    )
    x = cp.Parameter((W, 3), nonneg=True)
    model = SwitchingModel(Site.of(tiny), x, steps)
    model.fill(model.site, replace(window(tiny).first(W), switching=past))
    cold = model.cold
    bounds = [
        cp.Problem(sense(cp.sum(cold.z)), list(model.constraints.values()))
        for sense in (cp.Minimize, cp.Maximize)
    ]
    obeying = 0
    for service in itertools.product([False, True], repeat=W):
        served = np.repeat(np.array(service)[:, None], 3, axis=1)
        if past.broken(served).any():
            continue
        obeying += 1
        x.value = served.astype(float)
        truth = past.demand_factor(served) - 1.0
        for bound in bounds:
            bound.solve(cp.HIGHS)
            assert cold.z.value == pytest.approx(truth, abs=1e-6)
    assert obeying >= 8


def test_values_out_of_range_are_named() -> None:
    assert refusal(
        SwitchingRules, min_served_h=-1.0, cold_load_factor=0.5, max_actions_per_customer=-1
    ).splitlines() == [
        "options, switching.min_served_h = -1.0: must be zero or positive. Give hours.",
        "options, switching.max_actions_per_customer = -1: must not be negative. Give a whole "
        "number from zero.",
        "options, switching.cold_load_factor = 0.5: must be at least 1. Give a factor, for example "
        "1.5.",
    ]


def test_equations_are_those_of_the_page(tiny: Scenario) -> None:
    rows = re.findall(r"^\|[^|]*\|[^|]*\| `(\w+)` \| `([\w]+)` \|", PAGE.read_text("utf-8"), re.M)
    site, steps = Site.of(tiny), RuleSteps(1, 2, 2)
    ruled = Statement(site, 3, ((SwitchingModel, steps),))
    assert {name for _, name in rows} == ruled.rules
    assert ruled.rules == set(ruled.families) - set(Statement(site, 3).families)
    for function, name in rows:
        assert name in getattr(switching_rules, function)(ruled.additions[0])
