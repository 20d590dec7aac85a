"""The paper's day under ideal conditions: MPC at H = 5, full horizon, and resilience by horizon."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import linprog

from tests.support.dispatch_check import check_dispatch
from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.guard.guard import GuardedController
from vppres.control.mpc import MPCController
from vppres.core.arrays import Floats
from vppres.day.assembly import make_controller
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.day.trajectory import Trajectory
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario


class Listener:
    """A guarded MPC that keeps what it saw and what it decided."""

    def __init__(self, mpc: GuardedController) -> None:
        self.mpc = mpc
        self.heard: list[tuple[Observation, Decision]] = []

    def horizon_steps(self, t0: int) -> range:
        return self.mpc.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        decision = self.mpc.decide(observation)
        self.heard.append((observation, decision))
        return decision


@dataclass(frozen=True)
class IdealDay:
    """A finished run with every window's data and plan."""

    run: Trajectory
    windows: list[WindowData]
    plans: list[Dispatch]

    @property
    def steps(self) -> pd.DataFrame:
        return self.run.steps

    def per_step(self, table: str, column: str) -> Floats:
        """A column of a table as an array of shape (T, items)."""
        values = getattr(self.run, table)[column].to_numpy(float)
        return values.reshape(len(self.steps), -1)

    @property
    def net_charge_kw(self) -> Floats:
        """Charging less discharging of the fleet, shape (T,)."""
        return (
            self.per_step("batteries", "charge_kw") - self.per_step("batteries", "discharge_kw")
        ).sum(axis=1)


@pytest.fixture(scope="session")
def ideal(packaged: Scenario) -> IdealDay:
    options = RunOptions(horizon_h=5.0)
    guard = make_controller(packaged, options)
    assert isinstance(guard, GuardedController)
    assert isinstance(guard.inner, MPCController)
    listener, day = Listener(guard), Day(packaged, options)
    for t in range(packaged.grid.n_steps):
        day.step(listener, t)
    site = Site.of(packaged)
    return IdealDay(
        day.recorder.finish(options.as_record()),
        [WindowData.of(o, site, "lossless") for o, _ in listener.heard],
        [d.dispatch for _, d in listener.heard],
    )


@pytest.fixture(scope="session")
def full_horizon(packaged: Scenario) -> Trajectory:
    return run_day(packaged, RunOptions(controller="full-horizon"))


# Service.


@pytest.mark.daily
def test_tie_breakers_of_every_step_end_accurately(ideal: IdealDay) -> None:
    # One that does not sends the step to the network's stages, whose reactive power is arbitrary.
    assert not ideal.steps["stages"].str.contains("inaccurate|numerical").any()


def test_resilience_is_the_papers(ideal: IdealDay) -> None:
    value = resilience(ideal.run)
    assert value is not None and 0.90 <= value <= 0.94


def test_critical_customers_are_served_in_the_outage(ideal: IdealDay) -> None:
    critical = ideal.run.scenario.customers.tier == "critical"
    served = ideal.per_step("customers", "served")[ideal.run.scenario.outage][:, critical]
    assert served.mean() >= 0.98


def test_everybody_is_served_while_connected(ideal: IdealDay) -> None:
    assert ideal.per_step("customers", "served")[~ideal.run.scenario.outage].all()


def test_pv_is_hardly_curtailed(ideal: IdealDay) -> None:
    curtailed = ideal.per_step("pv", "curtailed_kw").sum()
    assert curtailed < 0.005 * ideal.run.scenario.pv_kw.sum()


def test_every_window_is_certified(ideal: IdealDay) -> None:
    assert (ideal.steps["status"] == "optimal").all()
    assert ideal.steps["gap"].max() <= 1e-4
    assert ideal.steps["gap_abs"].max() <= 5e-3


def test_every_plan_satisfies_every_equation(ideal: IdealDay) -> None:
    for data, plan in zip(ideal.windows, ideal.plans, strict=True):
        check = check_dispatch(ideal.run.scenario, data, plan)
        assert check.worst[1] <= 1e-5, check.worst


# Network.


def test_ac_voltages_stay_within_the_grid_code(ideal: IdealDay) -> None:
    assert ideal.per_step("buses", "v_ac_pu").min() > 0.94


def test_model_and_ac_voltages_are_close_in_every_hour(ideal: IdealDay) -> None:
    error = np.abs(ideal.per_step("buses", "v_model_pu") - ideal.per_step("buses", "v_ac_pu"))
    assert error.max() < 0.005


def test_island_balance_closes(ideal: IdealDay) -> None:
    """Actual load, PV power and set-points, with the AC losses, leave nothing for the slack bus."""
    scenario = ideal.run.scenario
    served = ideal.per_step("customers", "served")
    used_pv = scenario.pv_kw - ideal.per_step("pv", "curtailed_kw")
    need = (scenario.load_kw * served).sum(axis=1) - used_pv.sum(axis=1) + ideal.net_charge_kw
    losses = ideal.steps["losses_kw"].to_numpy()
    p_grid = ideal.steps["p_grid_kw"].to_numpy()
    dark = scenario.outage
    assert np.abs(need[dark]).max() < 1.0
    assert np.abs(p_grid - need - losses).max() < 1e-3


# Batteries and import.


def test_most_charging_of_the_connected_night_is_at_hour_2(ideal: IdealDay) -> None:
    assert ideal.net_charge_kw.argmax() == 2


def test_batteries_discharge_towards_the_price_peak_at_hour_6(ideal: IdealDay) -> None:
    net = ideal.net_charge_kw
    assert net[3:7].sum() < 0.0
    assert np.where(ideal.run.scenario.outage, np.inf, net).argmin() == 6


def test_import_is_largest_at_hour_2_and_smallest_at_hour_6(ideal: IdealDay) -> None:
    p_grid = ideal.steps["p_grid_kw"].to_numpy()
    assert p_grid.argmax() == 2
    assert np.where(ideal.run.scenario.outage, np.inf, p_grid).argmin() == 6


def test_fleet_is_charged_before_the_outage_and_empty_after_it(ideal: IdealDay) -> None:
    capacity = ideal.run.scenario.batteries.energy_kwh
    soc = ideal.per_step("batteries", "soc_end") @ capacity / capacity.sum()
    assert soc[11] > 0.8
    assert soc[17] < 0.2


def test_nothing_is_compiled_twice(ideal: IdealDay) -> None:
    """Once a window length has seen its stages, meeting them again compiles nothing."""
    seen: set[tuple[int, str]] = set()
    before = 0
    for (_, step), data in zip(ideal.steps.iterrows(), ideal.windows, strict=True):
        stages = {(data.n_steps, stage) for stage in step["stages"].split()}
        if stages <= seen:
            assert step["compilations"] == before
        seen, before = seen | stages, int(step["compilations"])
    assert len(seen) < len(ideal.windows) * 2


# An independent linear programme.


def least_cost(scenario: Scenario, data: WindowData, plan: Dispatch) -> float:
    """Cost in GBP of serving everybody with one lumped battery, no network and no losses in it.

    Variables: import, charge, discharge and stored energy of each step. The battery starts and ends
    with the energy of the plan.
    """
    steps, dt_h, b = data.n_steps, scenario.grid.dt_h, scenario.batteries
    own = np.minimum(data.load_kw[:, scenario.pv.owner(scenario.customers)], data.pv_kw).sum(axis=1)
    load, pv = data.load_kw.sum(axis=1), data.pv_kw.sum(axis=1)
    one, zero = np.eye(steps), np.zeros((steps, steps))
    change = one - np.eye(steps, k=-1)
    balance = np.hstack([one, -one, one, zero])
    stored = np.hstack(
        [zero, -dt_h * data.eta_charge.mean() * one, dt_h / data.eta_discharge.mean() * one, change]
    )
    energy = plan.soc @ b.energy_kwh
    start = np.r_[energy[0], np.zeros(steps - 1)]
    limits = [(0.0, None)] * steps + [(0.0, b.p_max_kw.sum())] * steps
    limits += [(0.0, min(b.p_max_kw.sum(), room)) for room in load - own]
    limits += [(b.energy_kwh @ b.soc_min, b.energy_kwh @ b.soc_max)] * (steps - 1)
    limits += [(energy[-1], energy[-1])]
    answer = linprog(
        np.r_[data.price_gbp_per_kwh * dt_h, np.zeros(3 * steps)],
        A_eq=np.vstack([balance, stored]),
        b_eq=np.r_[load - pv, start],
        bounds=limits,
    )
    assert answer.status == 0, answer.message
    return float(answer.fun)


@pytest.mark.parametrize("t0", range(7))
def test_planned_cost_is_that_of_an_independent_linear_programme(ideal: IdealDay, t0: int) -> None:
    data, plan = ideal.windows[t0], ideal.plans[t0]
    assert (data.grid_limit_kw > 0).all() and plan.served.all()
    planned = float(data.price_gbp_per_kwh @ plan.p_grid_kw) * ideal.run.scenario.grid.dt_h
    assert planned == pytest.approx(least_cost(ideal.run.scenario, data, plan), rel=1e-3)


# Full horizon and horizons.


def test_no_check_fires_under_ideal_conditions(full_horizon: Trajectory) -> None:
    steps = full_horizon.steps
    assert steps["correction_reason"][steps["corrected"]].tolist() == []


def test_full_horizon_does_what_it_planned(full_horizon: Trajectory) -> None:
    steps, energy = len(full_horizon.steps), full_horizon.scenario.batteries.energy_kwh
    done = full_horizon.customers["served"].to_numpy().reshape(steps, -1)
    assert (done == np.array(full_horizon.planned["served"])).all()
    end = full_horizon.batteries["soc_end"].to_numpy().reshape(steps, -1)
    assert end @ energy == pytest.approx(full_horizon.planned["energy_kwh"][1:], abs=1e-2)


def test_mpc_replicates_the_full_horizon(ideal: IdealDay, full_horizon: Trajectory) -> None:
    of_mpc, of_plan = resilience(ideal.run), resilience(full_horizon)
    assert of_mpc is not None and of_plan is not None
    assert of_mpc == pytest.approx(of_plan, abs=0.003)
    assert of_plan >= of_mpc - 5e-3 / 79.2
