"""Islands of feeders with capacitors, taps and charging.

Each day's resilience is held against a bound that no plan of physical mode exceeds: the same day on
a copper plate, planned at once with the outage known, with the headroom of plans.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import scipy.sparse as sp
import typer
from scipy.optimize import Bounds, LinearConstraint, milp

from benchmarks.random_feeders import random_scenario
from experiments.studies.islands import claims_of
from experiments.studies.seeds import Days, FirstSeed
from vppres.control.converged import DEFAULT_HEADROOM
from vppres.core.units import kw_at_1_pu_to_us
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.model.site import Site
from vppres.physics.powerflow import ACPowerFlow
from vppres.scenario.capacitors import too_large
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

STEPS = 12
OUTAGE = slice(6, 10)
SHARE_OF_BOUND = 0.9
TAPS = (0.975, 1.0, 1.025)
ANGLES = np.radians(np.arange(0, 61, 3))
CAPACITOR_SHARE = (0.05, 1.5)
"""Smallest and largest capacitor, as a share of all batteries' inverters."""


def equipped_day(seed: int) -> Scenario:
    """A random feeder with a battery, two taps, charging lines and one to three capacitors.

    With grid it keeps its voltages without any device: what breaks them then is no matter of
    islands.
    """
    while True:
        day = random_scenario(seed, n_steps=STEPS)
        if len(day.batteries):
            limit_kw = np.full(STEPS, np.inf)
            limit_kw[OUTAGE] = 0.0
            network = equipped(day, np.random.default_rng([seed, 5]))
            day = replace(day, network=network, grid_limit_kw=limit_kw)
            if within_limits(day):
                return day
        seed += 1_000_000


def within_limits(day: Scenario) -> bool:
    """Whether the voltages keep the plan's limits with grid, with all customers and with none."""
    net = day.network
    site = Site.of(day)
    most = np.argmax(day.load_kw.sum(axis=1))
    for share in (0.0, 1.0):
        p_kw = -share * (site.customer_bus @ day.load_kw[most])
        q_kvar = -share * (site.customer_bus @ day.load_kvar[most])
        v_pu = ACPowerFlow(net).solve(p_kw, q_kvar).v_pu
        if v_pu.min() < net.v_min_pu or v_pu.max() > net.v_max_pu:
            return False
    return True


def equipped(day: Scenario, rng: np.random.Generator) -> Network:
    """The day's feeder with its equipment; capacitors that no battery holds are off in islands."""
    net = day.network
    peak_kw = float(day.load_kw.sum(axis=1).max())
    ratio = np.ones(net.n_lines)
    ratio[rng.integers(net.n_lines, size=2)] = rng.choice(TAPS, 2)
    charging_kvar = rng.uniform(0.0, 0.02, net.n_lines) * peak_kw
    kvar = np.zeros(net.n_buses)
    at = rng.integers(1, net.n_buses, size=rng.integers(1, 4))
    kvar[at] = -rng.uniform(*CAPACITOR_SHARE, len(at)) * float(day.batteries.s_max_kva.sum())
    network = replace(
        net, ratio=ratio, b_us=kw_at_1_pu_to_us(charging_kvar, net.base_kv), q_shunt_kvar=kvar
    )
    formers_kva = float(day.batteries.s_max_kva[day.batteries.formers].sum())
    return replace(network, island=~too_large(network, formers_kva))


def bound_of(day: Scenario) -> float:
    """Largest resilience on a copper plate, by one plan of the whole day that knows the outage."""
    T, C, B = day.grid.n_steps, len(day.customers), len(day.batteries)
    b = day.batteries
    dt_h = day.grid.dt_h
    out = day.outage.astype(float)
    # Columns: served (T, C), charge (T, B), discharge (T, B), in this order.
    worth = np.concatenate([np.outer(out, day.customers.weight).ravel(), np.zeros(2 * T * B)])
    supply = sp.block_diag([load_kw[None, :] for load_kw in day.load_kw])
    of_fleet = sp.kron(sp.eye_array(T), np.ones((1, B)))
    balance = sp.hstack([supply, of_fleet, -of_fleet])
    most_kw = np.where(day.outage, day.pv_kw.sum(axis=1), np.inf)
    so_far = sp.kron(np.tril(np.ones((T, T))), sp.eye_array(B)) * dt_h
    gained = sp.hstack(
        [
            sp.csr_array((T * B, T * C)),
            so_far @ sp.diags_array(np.tile(b.eta_charge / b.energy_kwh, T)),
            -so_far @ sp.diags_array(np.tile(1.0 / (b.eta_discharge * b.energy_kwh), T)),
        ]
    )
    headroom_kva = np.where(b.formers, DEFAULT_HEADROOM * b.s_max_kva, 0.0)
    in_island = np.where(day.outage[:, None], headroom_kva, 0.0)
    power_kw = np.tile(np.maximum(b.active_max_kw - in_island, 0.0).ravel(), 2)
    together_kva = float((b.s_max_kva - headroom_kva).sum() + day.pv.s_max_kva.sum())
    found = milp(
        -worth,
        constraints=[
            LinearConstraint(sp.csr_array(balance), ub=most_kw),
            LinearConstraint(
                sp.csr_array(gained),
                np.tile(b.soc_min - b.soc_initial, T),
                np.tile(b.soc_max - b.soc_initial, T),
            ),
            *(
                LinearConstraint(
                    _seen_at(day, angle), ub=np.where(day.outage, together_kva, np.inf)
                )
                for angle in ANGLES
            ),
        ],
        bounds=Bounds(0.0, np.concatenate([np.ones(T * C), power_kw])),
        integrality=np.concatenate([np.ones(T * C), np.zeros(2 * T * B)]),
    )
    assert found.mip_dual_bound is not None  # HiGHS has one for every problem with binaries
    total = float(out.sum() * day.customers.weight.sum())
    return min(1.0, -found.mip_dual_bound / total)


def _seen_at(day: Scenario, angle: float) -> sp.csr_array:
    """Apparent power of those served, projected on an angle, where inverters have their sum."""
    projected = np.cos(angle) * day.load_kw + np.sin(angle) * day.load_kvar
    rows = sp.block_diag([step[None, :] for step in projected])
    nothing = sp.csr_array((day.grid.n_steps, 2 * day.grid.n_steps * len(day.batteries)))
    return sp.csr_array(sp.hstack([rows, nothing]))


def row_of(seed: int) -> dict[str, object]:
    """What the default controller reaches on a day, and what its record claims."""
    day = equipped_day(seed)
    run = run_day(day, RunOptions(mode="physical", seed=seed))
    found = resilience(run)
    assert found is not None  # every day has an outage
    steps = run.steps
    dark = steps["dark"] > 0
    bound = bound_of(day)
    return {
        "seed": seed,
        "resilience": found,
        "bound": bound,
        "near": found >= SHARE_OF_BOUND * bound - 1e-9,
        "switched_off": int((~day.network.island).sum()),
        "dark_steps": int(dark.sum()),
        "dark_called_optimal": int((dark & (steps["status"] == "optimal")).sum()),
        "dark_reason": "; ".join(sorted({*steps.loc[dark, "dark_reason"]})),
        "status": ", ".join(sorted({*steps["status"]})),
        "kept": claims_of(run).kept,
    }


def main(days: Days = 40, first: FirstSeed = 0) -> None:
    """Resilience of islands with capacitors, taps and charging, beside a bound."""
    rows = []
    for seed in range(first, first + days):
        rows.append(row_of(seed))
        typer.echo(", ".join(f"{name} {value}" for name, value in rows[-1].items()))
    table = pd.DataFrame(rows)
    typer.echo(
        f"{int(table['near'].sum())} of {days} days reach {SHARE_OF_BOUND:g} of the bound, "
        f"{int(table['kept'].sum())} keep every claim. Dark steps: {table['dark_steps'].sum()}, "
        f"called optimal: {table['dark_called_optimal'].sum()}."
    )


if __name__ == "__main__":
    typer.run(main)
