"""The guard: every fallback is reached and named, and every answer can be carried out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.frame.random_feeders import random_window
from tests.support.dispatch_check import check_dispatch
from tests.support.made_up_runs import small_scenario
from tests.support.quiet_days import changed_by_the_guard, difference
from tests.support.set_points import decision
from tests.support.sets import gensets
from tests.support.small_windows import first_step, observed, two_buses
from vppres.contract.decision import Decider, Decision
from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.control.guard.balance import StepBefore, mismatch_kw
from vppres.control.guard.check import Tolerances, violations
from vppres.control.guard.estimation import Estimator
from vppres.control.guard.guard import GuardedController, GuardOptions
from vppres.control.guard.moved import Moved
from vppres.control.guard.reckoning import SocReckoning
from vppres.control.mpc import MPCController
from vppres.control.rules import best_subset, carry, rule_dispatch
from vppres.control.step_state import StepState
from vppres.core.arrays import Floats
from vppres.core.errors import InfeasibleError, LimitError
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.plant.plant import BatteryState, Plant
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution
from vppres.solve.whole import least_slack

TIERS = ("critical", "high", "low")
SEEDS = st.integers(0, 10_000)


# The rule.


def state_of(seed: int, stressed: bool = False) -> tuple[Scenario, StepState]:
    """The first step of a random window."""
    scenario, data = random_window(seed, stressed)
    return scenario, first_step(scenario, data)


@pytest.mark.daily
@settings(max_examples=50)
@given(seed=SEEDS, charge_kw=st.floats(-500.0, 500.0), stressed=st.booleans())
def test_rule_is_always_feasible_and_carried_out_as_it_is(
    seed: int, charge_kw: float, stressed: bool
) -> None:
    scenario, state = state_of(seed, stressed)
    plan = rule_dispatch(state, TIERS, np.full(len(scenario.batteries), charge_kw))
    # Inverters of stressed windows may be too small for what their owners consume themselves.
    found = {} if stressed else check_dispatch(scenario, state.now, plan).violations
    first = plan.served[0] & (scenario.customers.tier == "critical")
    alone = carry(state, first, np.zeros(len(scenario.batteries)))
    assert plan.no_worse_than(alone)
    exempt = {"voltage limits"}  # the rule goes by those of the AC voltages
    if plan.reactive_short_kvar > 1e-6:
        exempt |= {"reactive balance"}
    assert {
        name: value for name, value in found.items() if value > 1e-7 and name not in exempt
    } == {}
    steps = (scenario.grid.n_steps, 1)
    now = replace(
        scenario, load_kw=np.tile(state.load_kw, steps), pv_kw=np.tile(state.pv_kw, steps)
    )
    seen = state.now
    battery = BatteryState(seen.soc, seen.eta_charge, seen.eta_discharge, 25.0 + 0 * seen.soc)
    done = Plant(now).apply(0, Decision(plan), battery)
    assert done.clipped_kw < 1e-6
    assert -done.p_injection_kw.sum() == pytest.approx(plan.p_grid_kw[0], abs=1e-5)
    assert violations(Decision(plan), state, v_limits_pu=(0.0, 2.0)) == []


@settings(max_examples=100)
@given(
    weights=st.lists(st.sampled_from([1.0, 1.0, 1.5, 0.7]) | st.floats(0.1, 2.0), max_size=8),
    seed=SEEDS,
    share=st.floats(0.0, 1.2),
)
def test_best_subset_is_the_best(weights: list[float], seed: int, share: float) -> None:
    loads = np.random.default_rng(seed).uniform(1.0, 20.0, len(weights))
    w, capacity = np.array(weights), share * loads.sum()
    best = (
        max(
            (
                w @ chosen
                for chosen in map(np.array, itertools.product([0, 1], repeat=len(w)))
                if loads @ chosen <= capacity + 1e-9
            ),
            default=0.0,
        )
        if len(w)
        else 0.0
    )
    chosen = best_subset(w, loads, capacity)
    assert loads @ chosen <= capacity + 1e-6
    assert w @ chosen == pytest.approx(best, abs=1e-8)


def step(scenario: Scenario, t: int, soc: float = 0.5) -> StepState:
    """A step of a day with every battery at a state of charge."""
    forecast = Forecaster(scenario, ForecastErrors(), 0).at(t, range(t, t + 1))
    seen = observed(scenario, t, forecast, np.full(len(scenario.batteries), soc))
    return StepState.of(Site.of(scenario), seen)


def test_rule_in_an_island_by_hand() -> None:
    # 12 kW of sun, 0.1 x 100 kWh x 0.95 / 0.5 h = 19 kW of battery: a (10) and b (20) fit, not c.
    plan = rule_dispatch(step(small_scenario(), 1, soc=0.25), TIERS)
    assert plan.served[0].tolist() == [True, True, False]
    assert plan.pv_self_kw[0, 0] == 12.0
    assert plan.discharge_kw[0, 0] == pytest.approx(18.0)
    assert plan.soc[1, 0] == pytest.approx(0.25 - 18.0 / 0.95 * 0.5 / 100)
    assert plan.p_grid_kw[0] == 0.0
    assert plan.shortage == ""


def test_rule_serves_the_first_tier_from_an_empty_battery_by_sun_alone() -> None:
    plan = rule_dispatch(step(small_scenario(), 1, soc=0.15), TIERS)
    assert plan.served[0].tolist() == [True, False, False]
    assert (plan.charge_kw[0, 0], plan.pv_curtailed_kw[0, 0]) == (pytest.approx(2.0), 0.0)


def test_full_battery_leaves_the_surplus_curtailed() -> None:
    plan = carry(step(small_scenario(), 1, soc=0.85), np.array([True, False, False]), np.zeros(1))
    assert (plan.charge_kw[0, 0], plan.pv_curtailed_kw[0, 0]) == (0.0, pytest.approx(2.0))


def test_what_cannot_be_carried_is_none() -> None:
    assert carry(step(small_scenario(), 1, soc=0.15), np.ones(3, bool), np.zeros(1)) is None


def test_connected_rule_imports_and_leaves_the_batteries_alone() -> None:
    plan = rule_dispatch(step(small_scenario(), 0), TIERS)
    assert plan.served.all()
    assert plan.p_grid_kw[0] == pytest.approx(70.0 - 12.0)
    assert plan.charge_kw.sum() == plan.discharge_kw.sum() == 0.0


# The check.


def test_sound_decision_passes(tiny: Scenario) -> None:
    done = decision(tiny, battery_kw=[10.0, -10.0])
    assert violations(done, step(tiny, 0)) == []


@pytest.mark.parametrize(("t", "change", "text"), [
    (0, {"served": np.full((1, 3), 0.5)}, "a customer is supplied in part"),
    (0, {"served": np.ones((1, 2), bool)}, "served has shape (1, 2)"),
    (0, {"charge_kw": np.full((1, 2), np.nan)}, "charge_kw is not finite"),
    (0, {"charge_kw": np.array([[51.0, 0.0]])}, "battery power: big by 1 kVA"),
    (0, {"charge_kw": np.array([[-5.0, 0.0]])}, "battery power: big by 5 kVA"),
    (0, {"batt_q_kvar": np.array([[0.0, 36.0]])}, "battery power: small by 1 kVA"),
    (0, {"charge_kw": np.array([[30.0, 0.0]]), "discharge_kw": np.array([[30.0, 0.0]])},
        "battery power: big by 30 kVA"),
    (0, {"pv_curtailed_kw": np.array([[-3.0, 0.0]])}, "pv: roof by 3 kVA"),
    (0, {"pv_q_kvar": np.array([[0.0, -35.0]])}, "pv: field by 5 kVA"),
    (0, {"v_pu": np.array([[1.0, 0.9, 1.0, 1.0]])}, "voltage: 0.9000 pu"),
    (3, {}, "balance: 108.5 kW short"),
    (3, {"served": np.zeros((1, 3), bool)}, "balance: 47.5 kW surplus"),
])  # fmt: skip
def test_unsound_decision_is_refused(
    tiny: Scenario, t: int, change: dict[str, Floats], text: str
) -> None:
    done = decision(tiny)
    wrong = replace(done, dispatch=replace(done.dispatch, **change))
    assert violations(wrong, step(tiny, t, soc=0.3)) == [text]


def test_energy_and_missing_batteries_are_refused(tiny: Scenario) -> None:
    full = step(tiny, 0, soc=0.84)
    assert violations(decision(tiny, battery_kw=[40.0, 0.0]), full) == [
        "battery energy: big by 0.37 of capacity"
    ]
    out = replace(step(tiny, 0), online=np.array([False, True]))
    assert violations(decision(tiny, battery_kw=[5.0, 0.0]), out) == ["battery power: big by 5 kVA"]


@pytest.mark.parametrize(
    ("extra_kw", "losses", "refused"),
    [
        (0.0, True, []),
        (2.75, True, []),
        (6.4, True, []),  # twice the losses, and 1.02 kW of the balance
        (6.8, True, ["balance: 6.8 kW surplus"]),
        (0.9, False, []),
        (2.75, False, ["balance: 2.8 kW surplus"]),
    ],
)
def test_a_plan_sets_aside_what_its_set_points_lose(
    tiny: Scenario, extra_kw: float, losses: bool, refused: list[str]
) -> None:
    """The shop alone, 45 kW and 21.8 kvar, behind 121 ohm at 11 kV: 1 W for each kVA².

    45² + 21.8² lose 2.5 kW, with which the line carries 47.5 kW and loses 2.73 kW, and so on: 2.75.
    """
    ohm = [1e-9, 121.0, 1e-9]
    network = Network([1, 2, 2], [2, 3, 4], ohm, [0.0] * 3, slack_bus=1, base_kv=11.0)
    islanded = replace(tiny, network=network)
    done = decision(
        islanded,
        served=[False, True, False],
        curtailed_kw=islanded.pv_kw[3],
        battery_kw=[-30.0, -15.0 - extra_kw],
    )
    assert violations(done, step(islanded, 3, soc=0.8), Tolerances(losses=losses)) == refused


# The order of fallbacks.


class Scripted:
    """A controller that answers or raises as told, step by step."""

    def __init__(self, inner: Decider, script: dict[int, Exception]) -> None:
        self.inner, self.script = inner, script

    def horizon_steps(self, t0: int) -> range:
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        if observation.t0 in self.script:
            raise self.script[observation.t0]
        return self.inner.decide(observation)


def guarded(
    scenario: Scenario,
    script: dict[int, Exception],
    horizon_h: float = 2.0,
    solver_of: Callable[[Site], WindowSolver] = WindowSolver,
    protect: bool = False,
) -> GuardedController:
    def controller_of(site: Site) -> Decider:
        return Scripted(MPCController(WindowSolver(site), scenario.grid, horizon_h), script)

    return GuardedController(
        controller_of, solver_of, Site.of(scenario), GuardOptions(TIERS, protect)
    )


def played(scenario: Scenario, controller: Decider) -> Day:
    """A finished day."""
    day = Day(scenario, RunOptions())
    for t in range(scenario.grid.n_steps):
        day.step(controller, t)
    return day


def fallbacks(day: Day) -> list[str]:
    return [record.steps["fallback"] for record in day.recorder.records]


@pytest.mark.parametrize("kind", ["mpc", "full-horizon"])
def test_guard_changes_nothing_where_nothing_fails(tiny: Scenario, kind: str) -> None:
    options = RunOptions(controller=kind, horizon_h=2.0, errors=ForecastErrors(0.05, 0.05))
    runs = [run_day(tiny, replace(options, guard=guard)) for guard in (True, False)]
    assert (runs[0].steps["fallback"] == "none").all()
    gaps = runs[0].steps["gap_abs"]
    assert 0.0 <= gaps.max() <= runs[0].options["limits"]["gap_abs"]
    for name in ("customers", "pv", "batteries"):
        assert runs[0].tables[name].equals(runs[1].tables[name])


@pytest.mark.parametrize("error", [RuntimeError("segment"), LimitError("late"), ValueError()])
def test_dead_solver_is_answered_by_the_previous_plan(tiny: Scenario, error: Exception) -> None:
    day = played(tiny, guarded(tiny, {1: error, 2: error}))
    assert fallbacks(day) == ["none", "previous_plan", "previous_plan", "none", "none", "none"]
    undisturbed = played(tiny, guarded(tiny, {}))
    # Without forecast errors the old plan closes the balance as it is.
    for t in (1, 2):
        record = day.recorder.records[t]
        assert record.steps["fallback_reason"].startswith(type(error).__name__)
        assert (
            record.customers["served"].tolist()
            == undisturbed.recorder.records[t].customers["served"].tolist()
        )


def test_plan_that_is_used_up_is_followed_by_the_rule(tiny: Scenario) -> None:
    script = {t: RuntimeError("gone") for t in range(1, 6)}
    day = played(tiny, guarded(tiny, script))
    assert fallbacks(day) == ["none", "previous_plan", "previous_plan", "rule", "rule", "rule"]
    statuses = [record.steps["status"] for record in day.recorder.records]
    assert statuses == ["optimal", "previous_plan", "previous_plan", "rule", "rule", "rule"]
    assert fallbacks(played(tiny, guarded(tiny, {0: RuntimeError("gone")})))[0] == "rule"


def test_plan_that_cannot_be_carried_out_is_not_followed(tiny: Scenario) -> None:
    guard = guarded(tiny, {3: RuntimeError("gone")})
    day = Day(tiny, RunOptions())
    for t in range(3):
        day.step(guard, t)
    day.state = replace(day.state, soc=tiny.batteries.soc_min)
    day.battery_kw = None  # no measured power contradicts the readings
    day.step(guard, 3)
    assert fallbacks(day)[3] == "rule"
    assert day.recorder.records[3].customers["served"][0] == (
        tiny.load_kw[3, 0] <= tiny.pv_kw[3].sum()
    )


def with_slack(scenario: Scenario, v_slack_pu: float) -> Scenario:
    return replace(scenario, network=replace(scenario.network, v_slack_pu=v_slack_pu))


@pytest.mark.daily
@pytest.mark.parametrize(("v_slack_pu", "limits"), [
    (0.92, "0.920 .. 1.077"),
    pytest.param(0.945, "0.940 .. 1.060", marks=pytest.mark.nightly),
])  # fmt: skip
def test_voltage_limits_give_by_as_little_as_possible(v_slack_pu: float, limits: str) -> None:
    scenario = with_slack(small_scenario(), v_slack_pu).between(0, 2)
    day = played(scenario, guarded(scenario, {}, horizon_h=0.0))
    assert set(fallbacks(day)) == {"voltage"}
    reason = day.recorder.records[0].steps["fallback_reason"]
    assert reason.startswith("InfeasibleError: The window of 1 steps has no feasible dispatch.")
    assert f"voltage limits widened to {limits} pu, this step 0.0" in reason


def test_least_slack_by_hand() -> None:
    # Nobody served and nothing fed in: every voltage is the slack bus's.
    scenario = with_slack(small_scenario(), 0.92)
    site, net = Site.of(scenario), scenario.network
    data = step(scenario, 1, soc=0.15).now
    without_q = replace(data, pv_kw=0.0 * data.pv_kw)
    assert least_slack(site, without_q, 20.0) <= net.v_min_pu**2 - 0.92**2 + 1e-6
    assert least_slack(Site.of(small_scenario()), data, 20.0) == pytest.approx(0.0, abs=1e-6)


class OnlyOneStep(WindowSolver):
    """A solver that finds nothing feasible beyond one step."""

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        if data.n_steps > 1:
            raise InfeasibleError("The future has no feasible dispatch.")
        return super().solve(data, within_s)


@pytest.mark.daily
def test_service_is_let_go_where_wider_limits_do_not_help(tiny: Scenario) -> None:
    error = InfeasibleError("The rules of switching leave nothing.")
    evening = tiny.between(2, 5)
    day = played(evening, guarded(evening, {1: error}, solver_of=OnlyOneStep))
    assert fallbacks(day) == ["none", "service", "none"]
    reason = day.recorder.records[1].steps["fallback_reason"]
    assert reason.startswith(
        "InfeasibleError: The rules of switching leave nothing.; voltage: "
        "InfeasibleError: The future has no feasible dispatch."
    )
    assert "the step alone, voltage limits widened to 0.946 .. 1.054 pu" in reason


class Dead(WindowSolver):
    """A solver that never answers."""

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        raise RuntimeError("no solver")


def test_infeasible_window_without_any_solver_still_has_an_answer(tiny: Scenario) -> None:
    day = played(tiny, guarded(tiny, {0: InfeasibleError("nothing")}, solver_of=Dead))
    assert fallbacks(day) == ["rule"] + ["none"] * 5
    reason = day.recorder.records[0].steps["fallback_reason"]
    assert reason == "InfeasibleError: nothing; voltage, service: RuntimeError: no solver"


# Critical customers.


def rationed() -> Scenario:
    """An island of two steps in which saving pays: 10 kW now, or 4 kW and 5 kW of others later."""
    day = small_scenario()
    load = np.array([[9.0, 50.0, 50.0], [9.0, 50.0, 50.0], [4.0, 1.0, 4.0], [9.0, 50.0, 50.0]])
    b = replace(day.batteries, soc_initial=[0.15 + 0.05 / 0.95])
    grid_limit_kw = [0.0, 0.0, 0.0, np.inf]
    return replace(
        day, load_kw=load, pv_kw=np.zeros((4, 1)), batteries=b, grid_limit_kw=grid_limit_kw
    )


@pytest.mark.daily
@pytest.mark.parametrize("solver_of", [WindowSolver, pytest.param(Dead, marks=pytest.mark.nightly)])
def test_critical_customer_is_served_where_the_step_can(
    solver_of: Callable[[Site], WindowSolver],
) -> None:
    scenario = rationed()  # 5 kWh at the terminals, 4.5 kWh for the critical customer in a step
    free = played(scenario, guarded(scenario, {}, solver_of=solver_of))
    assert [bool(r.customers["served"][0]) for r in free.recorder.records[:3]] == [
        False,
        False,
        True,
    ]
    kept = played(scenario, guarded(scenario, {}, solver_of=solver_of, protect=True))
    assert [bool(r.customers["served"][0]) for r in kept.recorder.records[:3]] == [
        True,
        False,
        False,
    ]
    first, second = kept.recorder.records[:2]
    assert first.steps["fallback"] == "critical"
    assert first.steps["fallback_reason"].startswith(
        "the plan serves 0 of the critical weight, the step alone 1"
    )
    assert ("RuntimeError: no solver" in first.steps["fallback_reason"]) == (solver_of is Dead)
    assert second.steps["fallback"] == "none"  # what is left carries nobody


# Measurements and batteries that are out.


def seen_day(
    scenario: Scenario, change: Callable[[Observation], Observation], options: RunOptions
) -> Day:
    """A day whose controller sees changed observations."""

    class Veiled(Day):
        def observe(self, controller: Decider, t: int) -> Observation:
            return change(super().observe(controller, t))

    day, controller = Veiled(scenario, options), make_controller(scenario, options)
    for t in range(scenario.grid.n_steps):
        day.step(controller, t)
    return day


OPTIONS = RunOptions(horizon_h=2.0)
SOC_NOW = np.array([0.8, 0.5])


def same_service(one: Day, other: Day) -> bool:
    pairs = zip(one.recorder.records, other.recorder.records, strict=True)
    return all(
        (a.customers["served"] == b.customers["served"]).all()
        and np.allclose(a.batteries["soc_end"], b.batteries["soc_end"], atol=1e-6)
        for a, b in pairs
    )


def test_missing_soc_is_reckoned_exactly(tiny: Scenario) -> None:
    def without_soc(seen: Observation) -> Observation:
        return replace(seen, soc=np.full(2, np.nan)) if seen.t0 else seen

    blind = seen_day(tiny, without_soc, OPTIONS)
    assert same_service(blind, played(tiny, make_controller(tiny, OPTIONS)))
    assert [" (missing)" in r.steps["estimated"] for r in blind.recorder.records] == [False] + 5 * [
        True
    ]


def test_what_is_known_of_a_silent_battery_fades(tiny: Scenario) -> None:
    """By a hundredth an hour and a tenth of what was ordered, until it may be empty or full."""
    b = tiny.batteries
    reckoning = SocReckoning.start(Site.of(tiny))
    nothing = np.full(2, np.nan)
    assert reckoning.after(nothing, np.zeros(2), 0.0, Moved.nothing(2)).unknown.all()
    moved = Moved.nothing(2).ordered(0.0, np.array([0.0, 0.6]), (b.eta_charge, b.eta_discharge))
    heard = reckoning.after(np.array([0.5, 0.2]), np.zeros(2), 0.0, Moved.nothing(2))
    later = heard.after(nothing, np.zeros(2), 34.0, moved)
    assert later.band == pytest.approx([0.34, 0.34 * (1.0 + 0.1 * b.eta_charge[1])])
    assert later.soc == pytest.approx([0.5, 0.2 + 0.34 * b.eta_charge[1]])
    assert later.unknown.tolist() == [False, True]  # half of what lies between the limits is 0.35


def test_a_reading_that_comes_late_counts_from_when_it_was_read(tiny: Scenario) -> None:
    b = tiny.batteries
    eta = (b.eta_charge, b.eta_discharge)
    moved = Moved.nothing(2)
    for hour, power_kw in ((0.0, -10.0), (1.0, -20.0), (2.0, 0.0)):
        moved = moved.ordered(hour, np.array([power_kw, 0.0]), eta)
    heard = SocReckoning.start(Site.of(tiny)).after(SOC_NOW, np.zeros(2), 0.0, Moved.nothing(2))
    late = heard.after(np.array([0.75, 0.5]), np.array([0.5, 0.5]), 3.0, moved)
    assert late.soc[0] == pytest.approx(0.75 - (5.0 + 20.0) / b.eta_discharge[0] / 100.0)
    older = late.after(np.array([0.8, 0.5]), np.array([0.25, 0.25]), 3.5, moved)
    assert older.soc == pytest.approx(late.soc) and not older.trusted.any()


def test_a_reading_is_new_once_however_often_its_age_is_told(tiny: Scenario) -> None:
    """Each is 13 minutes before a step and told every minute; ages in hours are rounded."""
    moved = Moved.nothing(2)
    read_h = -13.0 / 60.0
    soc = SocReckoning.start(Site.of(tiny)).after(SOC_NOW, np.full(2, read_h), 0.0, moved)
    assert soc.trusted.all()
    for minute in range(1, 200):
        now_h = minute / 60.0
        age_h = (minute + 13) / 60.0
        soc = soc.after(SOC_NOW, np.full(2, now_h - age_h), now_h, moved)
        assert not soc.trusted.any()


@pytest.mark.parametrize(("then", "believed"), [(0.3, True), (0.36, False)])
def test_a_state_of_charge_that_jumps_is_believed_if_the_next_bears_it_out(
    tiny: Scenario, then: float, believed: bool
) -> None:
    """Both batteries rest, as their meters say; the first one's reading falls from 0.5 to 0.3."""
    rest = np.zeros(2)
    eta = (tiny.batteries.eta_charge, tiny.batteries.eta_discharge)
    moved = Moved.nothing(2)
    soc = SocReckoning.start(Site.of(tiny)).after(np.array([0.5, 0.5]), np.zeros(2), 0.0, moved)
    for hour, reading in ((1.0, 0.3), (2.0, then)):
        moved = moved.ordered(hour - 1.0, rest, eta).seen(hour - 1.0, rest, eta)
        soc = soc.after(np.array([reading, 0.5]), np.full(2, hour), hour, moved)
        assert soc.trusted[1]
        if hour == 1.0:
            assert soc.jumped[0] and soc.soc[0] == pytest.approx(0.5)
    assert soc.trusted[0] == believed
    assert soc.soc[0] == pytest.approx(then if believed else 0.5)


def test_frozen_soc_is_noticed_once_the_battery_has_moved(tiny: Scenario) -> None:
    def frozen(seen: Observation) -> Observation:
        return replace(seen, soc=tiny.batteries.soc_initial)

    day = seen_day(tiny, frozen, OPTIONS)
    assert same_service(day, played(tiny, make_controller(tiny, OPTIONS)))
    assert day.recorder.records[0].steps["estimated"] == ""
    assert "(frozen)" in day.recorder.records[3].steps["estimated"]


@pytest.mark.parametrize("name", ["load_kw", "pv_kw"])
def test_missing_series_come_from_the_forecast_of_the_step_before(
    tiny: Scenario, name: str
) -> None:
    def missing(seen: Observation) -> Observation:
        rows = np.array(getattr(seen.forecast, name))
        if seen.t0 in (1, 4):
            rows[0, 0] = np.nan
        return replace(seen, forecast=replace(seen.forecast, **{name: rows}))

    day = seen_day(tiny, missing, OPTIONS)
    assert same_service(day, played(tiny, make_controller(tiny, OPTIONS)))
    words = {"load_kw": "load hospital 62.00 kW (missing)", "pv_kw": "pv roof 28.00 kW (missing)"}
    assert [r.steps["estimated"] for r in day.recorder.records][:3] == ["", words[name], ""]


def frozen_load(day: Scenario, first: int, last: int) -> Callable[[Observation], Observation]:
    """Demand is read as it was in one step until another."""

    def frozen(seen: Observation) -> Observation:
        rows = np.array(seen.forecast.load_kw)
        if first <= seen.t0 <= last:
            rows[0] = day.load_kw[first]
        return replace(seen, forecast=replace(seen.forecast, load_kw=rows))

    return frozen


FALLING = np.linspace(1.0, 0.5, 6)
DIP = np.array([1.0, 1.0, 0.6, 0.6, 1.0, 1.0])


@pytest.mark.parametrize(
    ("share", "first", "last", "replaced"),
    [
        (FALLING, 0, 5, [2, 3, 4, 5]),  # two forecasts are needed to see that it should move
        # Step 2 reads what is no longer true, and steps 3 and 4 know by the import before.
        (FALLING, 1, 4, [3, 4]),
        (DIP, 0, 5, [3]),  # the forecast of step 4 says what is read
    ],
)
def test_frozen_load_is_replaced_until_it_moves_or_is_true(
    tiny: Scenario, share: Floats, first: int, last: int, replaced: list[int]
) -> None:
    load = np.tile(tiny.load_kw[0], (6, 1)) if share is DIP else tiny.load_kw
    limit_kw = np.full(6, np.inf) if share is DIP else tiny.grid_limit_kw
    day = replace(tiny, load_kw=load * share[:, None], grid_limit_kw=limit_kw)
    done = seen_day(day, frozen_load(day, first, last), OPTIONS)
    assert [r.steps["estimated"] for r in done.recorder.records] == [
        f"load of all 3, {day.load_kw[t].sum():.1f} kW (frozen)" if t in replaced else ""
        for t in range(6)
    ]


def test_reported_trip_takes_the_battery_out_of_the_plan(tiny: Scenario) -> None:
    def tripped(seen: Observation) -> Observation:
        return replace(seen, online=np.array([seen.t0 < 3, True]))

    records = seen_day(tiny, tripped, OPTIONS).recorder.records
    assert [r.steps["estimated"] for r in records] == [""] * 3 + ["battery big is out"] * 3
    assert [r.steps["fallback"] for r in records] == ["none"] * 6
    assert all(
        r.batteries["charge_kw"][0] == r.batteries["discharge_kw"][0] == 0.0 for r in records[3:]
    )
    assert any(r.batteries["discharge_kw"][1] > 1.0 for r in records[3:])


# Days without faults.


@pytest.mark.daily
def test_guard_changes_no_decision_of_a_day_without_faults(nightly: bool) -> None:
    seeds = range(1000, 1040) if nightly else (1002, 1004, 1006)
    changed, steps, values = zip(*map(changed_by_the_guard, seeds), strict=True)
    assert [text for each in changed for text in each] == []
    assert sum(steps) > 3.75 * len(steps)
    assert {*values} == {"moving", "repeated", "constant"}


def test_constant_demand_under_noisy_forecasts_is_believed(tiny: Scenario) -> None:
    still = replace(
        tiny, load_kw=np.tile(tiny.load_kw[0], (6, 1)), pv_kw=np.tile(tiny.pv_kw[0], (6, 1))
    )
    run = run_day(still, RunOptions(horizon_h=2.0, errors=ForecastErrors(0.3, 0.3, -0.3, 0.3)))
    assert set(run.steps["estimated"]) == {""}
    assert set(run.steps["fallback"]) == {"none"}


@pytest.mark.parametrize("load_bias", [-0.95, 0.0, 15.0])
def test_demand_ten_times_off_its_forecast_is_believed_in_a_day_without_a_profile(
    tiny: Scenario, load_bias: float
) -> None:
    steep = replace(tiny, load_kw=tiny.load_kw * np.array([[1.0], [0.05], [1.0]] * 2))
    run = run_day(steep, RunOptions(horizon_h=1.0, errors=ForecastErrors(load_bias)))
    assert set(run.steps["estimated"]) == {""}


def test_a_changed_decision_is_seen(tiny: Scenario) -> None:
    plain = decision(tiny)
    assert difference(plain, plain) == ""
    moved = replace(plain.dispatch, charge_kw=plain.dispatch.charge_kw + 1e-12)
    assert difference(replace(plain, dispatch=moved), plain) == "charge_kw"
    named = replace(plain, fallback_reason="late", estimated="soc")
    assert difference(named, plain) == "late; soc"


@pytest.mark.nightly
def test_state_of_charge_in_whole_per_cent_is_believed(tiny: Scenario) -> None:
    def rounded(seen: Observation) -> Observation:
        return replace(seen, soc=np.round(seen.soc, 2))

    quarters = replace(tiny, grid=TimeGrid(tiny.grid.start, 2.0, 6))
    day = seen_day(quarters, rounded, OPTIONS)
    assert [r.steps["estimated"] for r in day.recorder.records] == [""] * 6


def test_frozen_load_is_kept_where_the_forecast_is_further_off(tiny: Scenario) -> None:
    falling = replace(tiny, load_kw=tiny.load_kw * np.linspace(1.0, 0.7, 6)[:, None])
    wild = replace(OPTIONS, errors=ForecastErrors(load_bias=0.9))
    words = [
        r.steps["estimated"]
        for r in seen_day(falling, frozen_load(falling, 0, 5), wild).recorder.records
    ]
    assert words[2:] == [f"load of all 3, {falling.load_kw[0].sum():.1f} kW (frozen, kept)"] * 4


def test_without_a_measured_import_nothing_is_frozen(tiny: Scenario) -> None:
    falling = replace(tiny, load_kw=tiny.load_kw * FALLING[:, None])
    frozen = frozen_load(falling, 0, 5)
    for blind in ("import_kw", "battery_kw", "one battery"):

        def veiled(seen: Observation, blind: str = blind) -> Observation:
            if blind == "one battery":
                partly = None if seen.battery_kw is None else seen.battery_kw * [np.nan, 1.0]
                return replace(frozen(seen), battery_kw=partly)
            return replace(frozen(seen), **{blind: None})

        words = [r.steps["estimated"] for r in seen_day(falling, veiled, OPTIONS).recorder.records]
        assert words == [""] * 6


def test_frozen_soc_without_measured_power_is_no_alarm(tiny: Scenario) -> None:
    def still(seen: Observation) -> Observation:
        return replace(seen, soc=tiny.batteries.soc_initial, battery_kw=None)

    words = [r.steps["estimated"] for r in seen_day(tiny, still, OPTIONS).recorder.records]
    assert words == [""] * 6


def test_batteries_of_a_feeder_that_is_off_are_not_silent(tiny: Scenario) -> None:
    estimator = Estimator(Site.of(tiny))
    estimator.commanded(decision(tiny, battery_kw=[20.0, -20.0]))
    day = Day(tiny, OPTIONS)
    seen = day.observe(make_controller(tiny, OPTIONS), 1)
    idle = replace(seen, battery_kw=np.zeros(2))
    flows = np.zeros(3)
    none_out = np.zeros(3, dtype=bool)
    off = OperatingPoint(np.ones(4), flows, flows, np.zeros(4), np.zeros(4), lines_out=none_out)
    on = replace(off, p_injection_kw=np.array([0.0, -5.0, 0.0, 0.0]))
    assert estimator.known(idle).online.all()  # dark: no operating point
    assert estimator.known(replace(idle, operating_point=off)).online.all()
    assert not estimator.known(replace(idle, operating_point=on)).online.any()


def unexplained_kw(day: Scenario) -> float:
    """Import of the first step beyond what its readings explain."""
    options = replace(OPTIONS, isolate=False)
    decider, run = make_controller(day, options), Day(day, options)
    done = decider.decide(run.observe(decider, 0))
    run.settle(0, done)
    site = Site.of(day)
    read = replace(StepBefore.nothing(site), load_kw=day.load_kw[0], pv_kw=day.pv_kw[0])
    return mismatch_kw(site, read.decided(done), run.observe(decider, 1))


def test_readings_are_checked_with_what_a_set_gives() -> None:
    """The import is less by what a set gives, and that contradicts no reading of a customer."""
    day = two_buses([[150.0], [150.0]], [1.0], [np.inf, np.inf], price=9.0)
    day = replace(day, gensets=gensets(only_in_outage=False))
    assert unexplained_kw(day) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("bus", [1, 3])
def test_readings_are_checked_with_what_the_network_draws_itself(tiny: Scenario, bus: int) -> None:
    """Also at the slack bus, which no line leads to."""
    nothing = {"p_shunt_kw": [], "q_shunt_kvar": [], "q_fixed_kvar": [], "island": []}
    network = replace(tiny.network, drawing_bus=[bus], p_fixed_kw=[30.0], **nothing)
    assert unexplained_kw(replace(tiny, network=network)) == pytest.approx(0.0, abs=1e-6)
