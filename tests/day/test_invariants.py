"""What must hold in every step of every run: random feeders, both controllers, forecast errors.

Everything is recomputed from the record's tables and the scenario's data.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_scenario
from vppres.contract.forecast import ForecastErrors
from vppres.contract.operating_point import Centre, OperatingPoint
from vppres.core.arrays import Floats
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.model.linearise import delta_offset
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.scenario import Scenario

ERRORS = ForecastErrors(load_bias=0.05, load_alpha_per_h=0.05, pv_bias=-0.1, pv_alpha_per_h=0.1)
N_STEPS = 5
SEEDS = (100, 101, 102, 103, 106, 108, 110, 111)
BY_DAY = (100, 101)
RUNS = [(seed, kind) for seed in SEEDS for kind in ("mpc", "full-horizon")]


@cache
def random_run(seed: int, kind: str) -> Trajectory:
    """A day of five steps; every second feeder is stressed, every third has hot batteries."""
    scenario = random_scenario(seed, stressed=seed % 2 == 1, n_steps=N_STEPS)
    return run_day(
        scenario,
        RunOptions(
            controller=kind,
            horizon_h=2 * scenario.grid.dt_h,
            errors=ERRORS,
            seed=seed,
            thermal="exact" if seed % 3 == 0 else "off",
        ),
    )


@pytest.fixture(
    params=[pytest.param(r, marks=() if r[0] in BY_DAY else pytest.mark.nightly) for r in RUNS],
    ids=lambda run: f"{run[0]}-{run[1]}",
)
def run(request: pytest.FixtureRequest) -> Trajectory:
    """Each of the runs."""
    return random_run(*request.param)


def per_step(run: Trajectory, table: str, column: str) -> Floats:
    """A column as an array of shape (T, items)."""
    return getattr(run, table)[column].to_numpy(float).reshape(N_STEPS, -1)


def nodal_injection(run: Trajectory) -> tuple[Floats, Floats]:
    """Net injection of every bus in kW and kvar from the record's device tables, shape (T, N)."""
    s = run.scenario
    bus = {b: n for n, b in enumerate(s.network.buses)}
    customer_bus = [bus[b] for b in s.customers.bus]
    served = per_step(run, "customers", "served")
    p, q = np.zeros((2, N_STEPS, s.network.n_buses))
    sources = [
        (
            customer_bus,
            -served * per_step(run, "customers", "p_load_kw"),
            -served * per_step(run, "customers", "q_load_kvar"),
        ),
        (
            [customer_bus[c] for c in owners(s)],
            per_step(run, "pv", "self_kw") + per_step(run, "pv", "export_kw"),
            per_step(run, "pv", "q_kvar"),
        ),
        (
            [bus[b] for b in s.batteries.bus],
            per_step(run, "batteries", "discharge_kw") - per_step(run, "batteries", "charge_kw"),
            per_step(run, "batteries", "q_kvar"),
        ),
    ]
    for buses, p_kw, q_kvar in sources:
        for item, n in enumerate(buses):
            p[:, n] += p_kw[:, item]
            q[:, n] += q_kvar[:, item]
    return p, q


def owners(scenario: Scenario) -> list[int]:
    """Position of each PV system's customer."""
    return [scenario.customers.id.tolist().index(c) for c in scenario.pv.customer]


def test_demand_and_pv_of_the_record_are_the_actual_ones(run: Trajectory) -> None:
    assert per_step(run, "customers", "p_load_kw") == pytest.approx(run.scenario.load_kw)
    tan_phi = np.sqrt(1 - run.scenario.customers.power_factor**2) / (
        run.scenario.customers.power_factor
    )
    assert per_step(run, "customers", "q_load_kvar") == pytest.approx(
        run.scenario.load_kw * tan_phi, abs=1e-9
    )
    assert per_step(run, "pv", "available_kw") == pytest.approx(run.scenario.pv_kw)


def test_soc_recursion(run: Trajectory) -> None:
    start, end = per_step(run, "batteries", "soc_start"), per_step(run, "batteries", "soc_end")
    kwh = run.scenario.grid.dt_h * (
        per_step(run, "batteries", "eta_charge") * per_step(run, "batteries", "charge_kw")
        - per_step(run, "batteries", "discharge_kw") / per_step(run, "batteries", "eta_discharge")
    )
    assert start[0] == pytest.approx(run.scenario.batteries.soc_initial)
    assert start[1:] == pytest.approx(end[:-1])
    assert end == pytest.approx(start + kwh / run.scenario.batteries.energy_kwh, abs=1e-9)


def test_soc_limits(run: Trajectory) -> None:
    end, b = per_step(run, "batteries", "soc_end"), run.scenario.batteries
    assert (end >= b.soc_min).all() and (end <= b.soc_max).all()


def test_ratings_and_exclusivity(run: Trajectory) -> None:
    b = run.scenario.batteries
    charge, discharge = (per_step(run, "batteries", name) for name in ("charge_kw", "discharge_kw"))
    assert (np.minimum(charge, discharge) == 0.0).all()
    assert (np.maximum(charge, discharge) <= b.p_max_kw).all()
    apparent = np.hypot(charge - discharge, per_step(run, "batteries", "q_kvar"))
    assert (apparent <= b.s_max_kva * (1 + 1e-6)).all()
    through = per_step(run, "pv", "self_kw") + per_step(run, "pv", "export_kw")
    apparent = np.hypot(through, per_step(run, "pv", "q_kvar"))
    assert (apparent <= run.scenario.pv.s_max_kva * (1 + 1e-6)).all()


def test_pv_split_and_self_consumption_of_the_served(run: Trajectory) -> None:
    s = run.scenario
    own, export, curtailed = (
        per_step(run, "pv", name) for name in ("self_kw", "export_kw", "curtailed_kw")
    )
    assert min(own.min(initial=0), export.min(initial=0), curtailed.min(initial=0)) >= 0.0
    assert own + export + curtailed == pytest.approx(s.pv_kw, abs=1e-9)
    served = per_step(run, "customers", "served")[:, owners(s)]
    assert own == pytest.approx(served * np.minimum(s.pv_kw, s.load_kw[:, owners(s)]), abs=1e-9)


def test_nodal_balance_of_the_ac_power_flow(run: Trajectory) -> None:
    """What arrives at a bus after the line's loss, and is injected there, leaves it again."""
    net, (p, q) = run.scenario.network, nodal_injection(run)
    p_from, q_from = per_step(run, "lines", "p_ac_kw"), per_step(run, "lines", "q_ac_kvar")
    v_kv = per_step(run, "buses", "v_ac_pu") * net.base_kv
    # 3 I² in A², with the power in kVA and the voltage between lines in kV.
    squared_a = (p_from**2 + q_from**2) / v_kv[:, net.parent] ** 2
    p[:, 0] += run.steps["p_grid_kw"]
    q[:, 0] += run.steps["q_grid_kvar"]
    for line, upstream in enumerate(net.parent):
        p[:, upstream] -= p_from[:, line]
        q[:, upstream] -= q_from[:, line]
        p[:, line + 1] += p_from[:, line] - net.r_ohm[line] * squared_a[:, line] / 1000.0
        q[:, line + 1] += q_from[:, line] - net.x_ohm[line] * squared_a[:, line] / 1000.0
    assert np.abs(p).max() < 1e-4
    assert np.abs(q).max() < 1e-4
    assert squared_a @ net.r_ohm / 1000.0 == pytest.approx(run.steps["losses_kw"], abs=1e-4)


def test_dead_grid_gives_and_takes_no_more_than_the_losses(run: Trajectory) -> None:
    dark = run.scenario.outage
    net_of_losses = (run.steps["p_grid_kw"] - run.steps["losses_kw"]).to_numpy()[dark]
    assert np.abs(net_of_losses).max(initial=0.0) <= 1.0


def test_live_grid_is_never_fed(run: Trajectory) -> None:
    net_of_losses = (run.steps["p_grid_kw"] - run.steps["losses_kw"]).to_numpy()
    assert net_of_losses[~run.scenario.outage].min(initial=0.0) >= -1.0


def test_batteries_charge_from_import_and_pv_export_only(run: Trajectory) -> None:
    given = (run.steps["p_grid_kw"] - run.steps["losses_kw"]).to_numpy()
    given = given + per_step(run, "pv", "export_kw").sum(axis=1)
    assert (per_step(run, "batteries", "charge_kw").sum(axis=1) <= given + 1.0).all()


@pytest.mark.parametrize(
    "seed", [pytest.param(s, marks=() if s in BY_DAY else pytest.mark.nightly) for s in SEEDS]
)
def test_mpc_decides_on_exact_current_values(seed: int) -> None:
    """The current step is known exactly, so the plant has nothing to move."""
    assert random_run(seed, "mpc").steps["clipped_kw"].max() <= 1e-3


@pytest.mark.nightly
def test_runs_cover_what_they_are_meant_to() -> None:
    runs = {key: random_run(*key) for key in RUNS}
    scenarios = [run.scenario for run in runs.values()]
    assert {len(s.batteries) == 0 for s in scenarios} == {True, False}
    assert {len(s.pv) == 0 for s in scenarios} == {True, False}
    assert {bool(s.outage.any()) for s in scenarios} == {True, False}
    corrected = [
        run.steps["corrected"].to_numpy() for key, run in runs.items() if key[1] == "full-horizon"
    ]
    assert np.any(corrected) and not np.all(corrected)
    shares = [resilience(run) for run in runs.values() if run.scenario.outage.any()]
    assert min(shares) < 0.5 and max(shares) > 0.9


def linear_voltages(scenario: Scenario, point: OperatingPoint, offset: Floats) -> Floats:
    """LinDistFlow voltages for a point's injections, line by line from the slack bus."""
    net = scenario.network
    flow = np.array([-point.p_injection_kw, -point.q_injection_kvar])
    for line in range(net.n_lines - 1, -1, -1):
        if net.parent[line] > 0:
            flow[:, net.parent[line]] += flow[:, line + 1]
    u = np.full(net.n_buses, net.v_slack_pu**2)
    for line, upstream in enumerate(net.parent):
        drop = net.r_ohm[line] * flow[0, line + 1] + net.x_ohm[line] * flow[1, line + 1]
        u[line + 1] = u[upstream] - 2 * drop / (1000 * net.base_kv**2) + offset[line]
    return np.sqrt(u)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("centre", "exact"), [("lossless", True), ("literal", False), ("none", False)]
)
def test_delta_form_meets_the_ac_point_it_was_taken_at(
    seed: int, centre: Centre, exact: bool
) -> None:
    scenario = random_scenario(seed, n_steps=1)
    p, q = np.zeros((2, scenario.network.n_buses))
    for c, bus in enumerate(scenario.customers.bus):
        n = scenario.network.buses.tolist().index(bus)
        p[n] -= scenario.load_kw[0, c]
        q[n] -= 0.3 * scenario.load_kw[0, c]
    ac = ACPowerFlow(scenario.network).solve(p, q)
    none_out = np.zeros(scenario.network.n_lines, dtype=bool)
    flows = ac.p_from_kw, ac.q_from_kvar
    point = OperatingPoint(ac.v_pu, *flows, p, q, lines_out=none_out)
    model = linear_voltages(scenario, point, delta_offset(scenario.network, point, centre))
    error = np.abs(model - ac.v_pu).max()
    assert error < 1e-12 if exact else 1e-7 < error < 5e-3
