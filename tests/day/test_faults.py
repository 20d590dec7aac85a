"""Faults: seeded, put between plant and controller, and never the end of a day."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from experiments.studies.faults import drawn_faults
from tests.support.refusals import refusal
from tests.support.set_points import decision
from vppres.contract.decision import Decision
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.day.assembly import make_controller
from vppres.day.faults import (
    QUANTITIES,
    SOLVER_FAULTS,
    BatteryTrip,
    FaultInjector,
    FaultPlan,
    MeasurementFault,
    SolverOutage,
)
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.day.trajectory import Trajectory
from vppres.physics import nose
from vppres.plant.collapse import realise
from vppres.report.findings import findings
from vppres.scenario.scenario import Scenario

OPTIONS = RunOptions(horizon_h=2.0, protect_critical=True)


def faulty(scenario: Scenario, plan: FaultPlan, options: RunOptions = OPTIONS) -> Trajectory:
    return run_day(scenario, options, faults=plan)


def test_plan_is_drawn_from_its_seed(tiny: Scenario) -> None:
    plans = [drawn_faults(tiny, seed) for seed in range(40)]
    assert plans[3] == drawn_faults(tiny, 3)
    kinds = {outage.kind for plan in plans for outage in plan.solver.values()}
    assert kinds == set(SOLVER_FAULTS)
    assert {m.quantity for plan in plans for m in plan.measurements} == set(QUANTITIES)
    assert {m.frozen for plan in plans for m in plan.measurements} == {True, False}
    assert {t.silent for plan in plans for t in plan.trips} == {True, False}
    assert {plan.pv_bias for plan in plans} == {-0.5, 0.0, 0.5}
    for plan in plans:
        plan.check(tiny)
        assert all(0 <= m.start < m.end <= 6 for m in plan.measurements)
        assert all(0 <= t.start < t.end <= 6 for t in plan.trips)


def test_fault_of_an_item_that_is_not_there_is_named(tiny: Scenario) -> None:
    plan = FaultPlan(
        measurements=(MeasurementFault("load", True, 0, 1, (0, 3)),), trips=(BatteryTrip(2, 0, 1),)
    )
    assert refusal(FaultInjector, plan, tiny).splitlines() == [
        "faults, load = 3: is not in the scenario. Give a position from 0 to 2.",
        "faults, soc = 2: is not in the scenario. Give a position from 0 to 1.",
    ]


# One fault at a time: the day goes on, and the record says what was done.


@pytest.mark.parametrize(("kind", "every_call"), [
    *((kind, True) for kind in SOLVER_FAULTS),
    ("infeasible", False),
    *(pytest.param(k, False, marks=pytest.mark.nightly) for k in SOLVER_FAULTS
        if k != "infeasible"),
])  # fmt: skip
def test_solver_fault_is_named_and_the_next_step_is_as_planned(
    tiny: Scenario, kind: str, every_call: bool
) -> None:
    steps = faulty(tiny, FaultPlan({1: SolverOutage(kind, every_call)})).steps
    expected = "voltage" if kind == "infeasible" and not every_call else "previous_plan"
    assert steps["fallback"].tolist() == ["none", expected, "none", "none", "none", "none"]
    words = {
        "killed": "SolverKilledError: the solver's process was killed",
        "timed_out": "LimitError: The window was not solved before the time limit.",
        "infeasible": "InfeasibleError: The window has no feasible dispatch.",
        "nan": "refused: served is not finite",
        "wrong_shape": "refused: served has shape",
        "out_of_range": "refused: battery power",
    }
    assert steps["fallback_reason"][1].startswith(words[kind])
    assert steps["fallback_reason"][0] == ""


@pytest.mark.parametrize(("controller", "kind"), [
    ("mpc", "killed"),
    ("mpc", "infeasible"),
    *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        *(("mpc", kind) for kind in SOLVER_FAULTS if kind not in ("killed", "infeasible")),
        ("full-horizon", "infeasible")]),
])  # fmt: skip
def test_solver_that_never_works_leaves_the_rule(
    tiny: Scenario, controller: str, kind: str
) -> None:
    plan = FaultPlan({t: SolverOutage(kind) for t in range(6)})
    run = faulty(tiny, plan, replace(OPTIONS, controller=controller))
    assert set(run.steps["fallback"]) == {"rule"}
    assert summarise(run)["fallbacks_by_kind"] == {"rule": 6}
    critical = run.customers[run.customers["tier"] == "critical"]
    assert critical["served"].tolist()[3] or tiny.pv_kw[3].sum() < tiny.load_kw[3, 0]


@pytest.mark.parametrize("frozen", [True, False])
@pytest.mark.parametrize("quantity", QUANTITIES)
def test_measurement_faults_are_recorded(tiny: Scenario, quantity: str, frozen: bool) -> None:
    shape = np.linspace(1.0, 0.5, 6)[:, None]
    day = replace(tiny, load_kw=tiny.load_kw * shape, pv_kw=tiny.pv_kw * shape)
    run = faulty(day, FaultPlan(measurements=(MeasurementFault(quantity, frozen, 2, 5),)))
    words = run.steps["estimated"].tolist()
    # A frozen reading is true in its first step, and shows by what came of the second.
    expected = [4] if frozen else [2, 3, 4]
    assert [t for t, text in enumerate(words) if f"{quantity} " in text] == expected
    assert all(("frozen" if frozen else "missing") in words[t] for t in expected)
    assert summarise(run)["estimated_steps"] == len(expected)
    # Plant and record keep the truth.
    assert (run.customers["p_load_kw"].to_numpy().reshape(6, 3) == day.load_kw).all()
    assert np.isfinite(run.batteries["soc_end"]).all()


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize(
    "controller", ["mpc", pytest.param("full-horizon", marks=pytest.mark.nightly)]
)
def test_tripped_battery_gives_nothing(tiny: Scenario, controller: str, silent: bool) -> None:
    plan = FaultPlan(trips=(BatteryTrip(0, 3, 6, silent),))
    run = faulty(tiny, plan, replace(OPTIONS, controller=controller))
    big = run.batteries[run.batteries["id"] == "big"].reset_index()
    assert (big.loc[3:, ["charge_kw", "discharge_kw", "q_kvar"]] == 0.0).all(axis=None)
    assert big["soc_start"][3] == big["soc_end"][5]
    words = run.steps["estimated"].tolist()
    noticed = [t for t, text in enumerate(words) if text == "battery big is out"]
    # A silent trip shows in the step after the first that asked for power.
    assert noticed == [3, 4, 5] if not silent else noticed and set(noticed) <= {4, 5}


def test_pv_forecast_is_off_and_the_measurement_is_not(tiny: Scenario) -> None:
    faults = FaultInjector(FaultPlan(pv_bias=-0.5), tiny)
    day = Day(tiny, replace(OPTIONS, errors=ForecastErrors(pv_bias=0.1)), faults)
    seen = day.observe(make_controller(tiny, OPTIONS, faults), 0).forecast
    assert seen.pv_kw[0].tolist() == tiny.pv_kw[0].tolist()
    assert seen.pv_kw[1] == pytest.approx(0.6 * tiny.pv_kw[1])


@pytest.mark.daily
@pytest.mark.parametrize("seed", range(4))
def test_day_of_drawn_faults_finishes(seed: int) -> None:
    day = random_scenario(seed, stressed=seed % 2 == 1, n_steps=5)
    run = faulty(day, drawn_faults(day, seed), replace(OPTIONS, horizon_h=1.0))
    assert len(run.steps) == 5
    b = day.batteries
    soc = run.batteries["soc_end"].to_numpy().reshape(5, len(b))
    assert ((soc >= b.soc_min - 1e-9) & (soc <= b.soc_max + 1e-9)).all()
    named = run.steps["fallback"] != "none"
    assert (run.steps["fallback_reason"] != "").tolist() == named.tolist()


# A power flow without a solution.


def overloaded(tiny: Scenario) -> Scenario:
    """The tiny day with a homes' load in step 1 that no line can carry."""
    load = np.array(tiny.load_kw)
    load[1, 2] = 5e5
    return replace(tiny, load_kw=load)


def test_power_flow_without_solution_sheds_the_lowest_tier(tiny: Scenario) -> None:
    scenario = overloaded(tiny)
    day, everyone = Day(scenario, OPTIONS), decision(scenario)
    done = realise(day.plant, day.ac, 1, everyone, day.state)
    assert done.served.tolist() == [True, True, False]
    assert done.ac_failed.startswith(
        "low and below shed: the AC power flow has no solution: net load 500"
    )
    assert done.ac.v_pu.min() > 0.9


def test_run_goes_on_where_the_power_flow_has_no_solution(tiny: Scenario) -> None:
    scenario, day = overloaded(tiny), Day(overloaded(tiny), OPTIONS)

    class Blind:
        def horizon_steps(self, t0: int) -> range:
            return range(t0, t0 + 1)

        def decide(self, observation: Observation) -> Decision:
            return decision(scenario)

    for t in range(6):
        day.step(Blind(), t)
    failed = [record.steps["ac_failed"] != "" for record in day.recorder.records]
    assert failed == [False, True, False, False, False, False]
    run = day.recorder.finish(OPTIONS.as_record())
    assert summarise(run)["ac_failures"] == 1


def test_a_power_flow_that_is_not_found_sheds_nobody(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = overloaded(tiny)
    monkeypatch.setattr(nose, "MAX_POINTS", 1)
    day = Day(scenario, OPTIONS)
    done = realise(day.plant, day.ac, 1, decision(scenario), day.state)
    assert done.served.all()
    assert not done.shed.any()
    assert not done.ac.converged
    assert done.ac_failed.startswith("nobody shed: the AC power flow was not found: net load 500")
    assert "misses 5.1e+05 kVA at bus 4. Nothing shows that there is no solution" in done.ac_failed


def test_the_record_tells_not_found_from_no_solution(tiny: Scenario) -> None:
    run = faulty(tiny, FaultPlan())
    notes = [
        "low and below shed: the AC power flow has no solution",
        "",
        "nobody shed: the AC power flow was not found",
        "nobody shed: not found",
        "",
        "",
    ]
    told = replace(run, steps=run.steps.assign(ac_failed=notes))
    assert (summarise(told)["ac_failures"], summarise(told)["ac_not_found"]) == (1, 2)
    found = findings(told)
    assert "AC power flow had no solution in 1 step." in found
    assert "AC power flow did not converge (no load shed) in 2 steps." in found


def test_nothing_left_to_shed_stops_the_devices_too(tiny: Scenario) -> None:
    roof = replace(tiny.pv, p_max_kw=[30.0, 6e5], s_max_kva=[40.0, 6e5])
    pv = np.array(tiny.pv_kw)
    pv[1, 1] = 6e5
    scenario = replace(tiny, pv=roof, pv_kw=pv)
    day = Day(scenario, OPTIONS)
    done = realise(day.plant, day.ac, 1, decision(scenario, battery_kw=[10.0, 0.0]), day.state)
    assert done.ac_failed.startswith("everything shed: ")
    assert not done.served.any()
    assert (done.p_injection_kw == 0.0).all()
    assert done.ac.v_pu.tolist() == [1.0] * 4
