"""Controllers: no look-ahead, the plan followed, and a reason for every correction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from tests.support.refusals import refusal
from tests.support.set_points import decision
from tests.support.small_windows import observed
from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.observation import Observation
from vppres.control.full_horizon import FullHorizonController, PVCheck
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.model.site import Site
from vppres.plant.plant import BatteryState, Plant
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import ModelCache
from vppres.solve.ladder import WindowSolver

ERRORS = ForecastErrors(0.1, 0.05, -0.1, 0.05)


@pytest.fixture
def own_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every solver compiles its own problems, so that runs share nothing but their observations."""
    monkeypatch.setattr("vppres.solve.ladder.shared_cache", ModelCache)


def same(one: Decision, other: Decision) -> bool:
    """Whether two decisions carry out the same step."""
    return all(
        (values[one.row] == getattr(other.dispatch, name)[other.row]).all()
        for name, values in one.dispatch.arrays().items()
    )


def other_truth(scenario: Scenario, known: range) -> Scenario:
    """The scenario with everything changed outside the known steps."""
    rows = np.isin(np.arange(scenario.grid.n_steps), list(known))
    return replace(
        scenario,
        load_kw=np.where(rows[:, None], scenario.load_kw, 1.7 * scenario.load_kw + 3.0),
        pv_kw=np.where(rows[:, None], scenario.pv_kw, 0.4 * scenario.pv_kw),
        price_gbp_per_kwh=np.where(rows, scenario.price_gbp_per_kwh, 0.01),
        grid_limit_kw=np.where(rows, scenario.grid_limit_kw, 0.0),
    )


# No look-ahead.


@pytest.mark.usefixtures("own_problems")
@pytest.mark.parametrize("seed", [0, 3, 6])
def test_mpc_does_not_see_beyond_its_window(seed: int) -> None:
    truth = random_scenario(seed, n_steps=6)
    options = RunOptions(horizon_h=2 * truth.grid.dt_h, errors=ERRORS)
    decisions = []
    for scenario in (truth, other_truth(truth, range(3))):
        controller, day = make_controller(scenario, options), Day(scenario, options)
        decisions.append(controller.decide(day.observe(controller, 0)))
    assert same(*decisions)


@pytest.mark.usefixtures("own_problems")
@pytest.mark.parametrize("kind", ["mpc", "full-horizon"])
def test_controller_knows_only_its_observation(kind: str) -> None:
    """A controller that was made from another truth decides the same on the same observation."""
    truth = random_scenario(5, n_steps=4)
    options = RunOptions(controller=kind, horizon_h=3.0, errors=ERRORS)
    maker, day = make_controller(truth, options), Day(truth, options)
    seen = day.observe(maker, 0)
    stranger = make_controller(other_truth(truth, range(0)), options)
    assert same(maker.decide(seen), stranger.decide(seen))


@pytest.mark.usefixtures("own_problems")
def test_full_horizon_sees_nothing_but_the_step_once_it_has_planned() -> None:
    truth = random_scenario(5, n_steps=4)
    options = RunOptions(controller="full-horizon", errors=ForecastErrors(load_bias=0.2))
    decisions = []
    for future in (truth, other_truth(truth, range(2))):
        controller, day = make_controller(truth, options), Day(truth, options)
        assert controller.horizon_steps(0) == range(4)
        day.step(controller, 0)
        assert controller.horizon_steps(1) == range(1, 2)
        later = Day(future, options)
        later.state, later.operating_point = day.state, day.operating_point
        decisions.append(controller.decide(later.observe(controller, 1)))
    assert same(*decisions)


def test_mpc_window_is_cut_at_the_end_of_the_day(tiny: Scenario) -> None:
    controller = make_controller(tiny, RunOptions(horizon_h=2.0))
    assert [controller.horizon_steps(t) for t in (0, 3, 4, 5)] == [
        range(0, 3),
        range(3, 6),
        range(4, 6),
        range(5, 6),
    ]


def test_observation_cannot_be_written_to(tiny: Scenario) -> None:
    options = RunOptions()
    seen = Day(tiny, options).observe(make_controller(tiny, options), 0)
    with pytest.raises(ValueError, match="read-only"):
        seen.forecast.load_kw[0, 0] = 0.0


# The full horizon's checks, on a plan written by hand for the tiny day.


def plan_of(scenario: Scenario, step: int, done: Decision) -> Dispatch:
    """A plan that says the same in every step as a decision of one step."""
    steps = scenario.grid.n_steps
    assert 0 <= step < steps
    return Dispatch(
        **{
            name: np.repeat(values[:1], steps, axis=0)
            for name, values in done.dispatch.arrays().items()
        }
    )


def full_horizon(
    scenario: Scenario, plan: Dispatch, pv_check: PVCheck = "absorbing"
) -> FullHorizonController:
    """A controller that has already planned."""
    controller = FullHorizonController(WindowSolver(Site.of(scenario)), scenario.grid, pv_check)
    controller.plan = plan
    return controller


def actual(scenario: Scenario, t: int, soc: float = 0.5, eta: float = 0.95) -> Observation:
    """What is measured when a step is due."""
    rows, count = slice(t, t + 1), len(scenario.batteries)
    forecast = Forecast(
        scenario.load_kw[rows],
        scenario.pv_kw[rows],
        scenario.price_gbp_per_kwh[rows],
        scenario.grid_limit_kw[rows],
        scenario.temperature_c[rows],
        out=scenario.out_of_service(range(t, t + 1)),
    )
    seen = observed(scenario, t, forecast, np.full(count, soc))
    return replace(seen, eta_charge=np.full(count, eta), eta_discharge=np.full(count, eta))


# In step 4 the hospital and the homes take 66 + 49 kW and the roofs give 24 + 16.
ISLAND = {"served": [True, False, True], "battery_kw": [-48.0, -27.0]}


def test_plan_that_passes_is_followed(tiny: Scenario) -> None:
    controller = full_horizon(tiny, plan_of(tiny, 4, decision(tiny, **ISLAND)))
    followed = controller.decide(actual(tiny, 4, soc=0.85))
    assert (followed.corrected, followed.reason, followed.info.status) == (False, "", "planned")
    assert followed.dispatch is controller.plan and followed.row == 4
    # Its step is one row, and has the states of charge before and after it.
    each = np.arange(7.0)[:, None] + np.zeros(2)
    step = replace(followed, dispatch=replace(followed.dispatch, soc=each, charge_kw=each[:6])).step
    assert (step.n_steps, step.charge_kw.tolist()) == (1, [[4.0, 4.0]])
    assert step.soc.tolist() == [[4.0, 4.0], [5.0, 5.0]]


@pytest.mark.parametrize(("change", "reason"), [
    ({"battery_kw": [-40.0, -27.0]}, "grid import: 8.0 kW above what the grid gives"),
    ({"battery_kw": [-48.0, -29.0]}, "grid import: 2.0 kW surplus that cannot be exported"),
    ({"batt_q_kvar": [37.0, 0.0]}, "battery inverter: big by 0.605 kVA"),
])  # fmt: skip
def test_correction_names_the_check_and_the_worst_item(
    tiny: Scenario, change: dict[str, list[float]], reason: str
) -> None:
    plan = plan_of(tiny, 4, decision(tiny, **{**ISLAND, **change}))
    corrected = full_horizon(tiny, plan).decide(actual(tiny, 4, soc=0.85))
    assert (corrected.corrected, corrected.reason, corrected.row) == (True, reason, 0)
    assert corrected.info.status == "optimal"
    assert type(corrected.info) is SolveInfo  # a window's solution would keep its whole dispatch


def test_correction_for_missing_energy(tiny: Scenario) -> None:
    # 27 kW for an hour draw 28.42 kWh, 0.4737 of the small battery; it has 0.35 to give.
    plan = plan_of(tiny, 4, decision(tiny, **ISLAND))
    corrected = full_horizon(tiny, plan).decide(actual(tiny, 4, soc=0.5))
    assert corrected.reason == "battery energy: big by 0.155 of capacity"


def test_correction_for_efficiency_below_plan(tiny: Scenario) -> None:
    plan = plan_of(tiny, 4, decision(tiny, **ISLAND))
    assert not full_horizon(tiny, plan).decide(actual(tiny, 4, soc=0.85)).corrected
    corrected = full_horizon(tiny, plan).decide(actual(tiny, 4, soc=0.85, eta=0.6))
    assert corrected.reason == "battery energy: big by 0.1 of capacity"


@pytest.mark.parametrize(("pv_check", "fires"), [("absorbing", False), ("literal", True)])
def test_readings_of_the_pv_check(tiny: Scenario, pv_check: PVCheck, fires: bool) -> None:
    # The grid is there and no split was planned: only the literal reading minds.
    plan = plan_of(tiny, 0, decision(tiny))
    done = full_horizon(tiny, plan, pv_check).decide(actual(tiny, 0))
    assert done.corrected is fires
    assert done.reason == ("pv: roof by 20 kW" if fires else "")


def test_correction_serves_what_the_actual_step_allows(tiny: Scenario) -> None:
    """Full batteries and 40 kW of PV serve the hospital (66 kW) and one more."""
    plan = plan_of(tiny, 4, decision(tiny, served=True))
    corrected = full_horizon(tiny, plan).decide(actual(tiny, 4, soc=0.85))
    # 66 + 44 kW with 24 + 16 from PV need 70 kW; 66 + 49 need 75: both fit, all three do not.
    assert corrected.dispatch.served[0].tolist() == [True, True, False]
    assert corrected.reason == "grid import: 119.0 kW above what the grid gives"


def test_plan_that_passes_leaves_the_island_balanced(tiny: Scenario) -> None:
    """Forecast errors that cancel in the sum must not hide a surplus.

    Foreseen: the hospital needs nothing, the homes take the field's 16 kW, and with full batteries
    the roof's 24 kW are curtailed. Due: the hospital takes 12 kW, from its own roof, and the homes
    take 4 kW. The sum is as planned, but only 12 kW of the roof can still be curtailed.
    """
    load = tiny.load_kw.copy()
    load[4] = [12.0, 0.0, 4.0]
    truth = replace(tiny, load_kw=load)
    plan = plan_of(truth, 4, decision(truth, served=True, curtailed_kw=[24.0, 0.0]))
    seen = actual(truth, 4, soc=0.85)
    done = full_horizon(truth, plan).decide(seen)
    before = BatteryState(seen.soc, seen.eta_charge, seen.eta_discharge, np.full(2, 25.0))
    happened = Plant(truth).apply(4, done, before)
    assert abs(happened.p_injection_kw.sum()) <= 1.0


# Options.


@pytest.mark.parametrize(("options", "text"), [
    ({"controller": "pid"}, "options, controller = pid: is not known. Use one of: mpc, "
        "full-horizon, perfect, idle, reserve."),
    ({"pv_check": "lax"}, "options, pv_check = lax: is not known. Use one of: absorbing, literal."),
    ({"centre": "flat"},
        "options, centre = flat: is not known. Use one of: lossless, literal, none."),
    ({"horizon_h": -1.0}, "options, horizon_h = -1.0: must be zero or positive. Give hours."),
    ({"horizon_h": float("nan")},
        "options, horizon_h = nan: must be zero or positive. Give hours."),
])  # fmt: skip
def test_unknown_options_are_named(options: dict[str, str], text: str) -> None:
    assert refusal(RunOptions, **options) == text
