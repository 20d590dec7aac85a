"""Whether what kinds of assets may cost or miss keeps its place behind service and energy."""

from __future__ import annotations

import numpy as np

from vppres.contract.plugged import price_scale
from vppres.contract.rooms import OF_A_STEP, Rooms
from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.scenario.past_days import PastDays
from vppres.scenario.scenario import Scenario

DEARER = 2.0
"""How much dearer a missed kWh must be than any energy that could be given instead."""


def check_prices(scenario: Scenario, horizon_h: float, seed: int) -> None:
    """Refuse prices beside which missed energy or comfort would count nothing.

    Raises
    ------
    InputError
        If a missed kWh is not dearer than any energy, with so many that share the price.
    """
    weight, full_kwh = _sessions(scenario, seed)
    worth = {
        f"{len(weight)} sessions of vehicles": _of_vehicles(scenario, weight, full_kwh),
        f"the comfort of {len(scenario.thermal_loads)} rooms and tanks": _of_rooms(
            scenario, horizon_h
        ),
    }
    dearest = float(np.abs(scenario.price_gbp_per_kwh).max())
    for what, missed in worth.items():
        if missed < DEARER * scenario.objective.lambda_grid * dearest:
            raise InputError.of(
                "scenario.toml",
                f"makes energy dearer than what {what} may count",
                f"Give at most {missed / DEARER / dearest:.1e}, or fewer of them.",
                field="objective.lambda_grid",
                value=scenario.objective.lambda_grid,
            )


def check_fuel(scenario: Scenario) -> None:
    """Refuse fuel and starts that could outweigh a customer of the first tier.

    Raises
    ------
    InputError
        If a start and the least time on of all sets at their largest power, a step at least, cost
        as much as a step of such a customer counts.
    """
    sets = scenario.gensets
    dt_h = scenario.grid.dt_h
    on_h = np.maximum(sets.min_on_h, dt_h)
    litres = on_h * sets.litres(np.ones(len(sets), dtype=bool), sets.p_max_kw, dt_h=1.0)
    dearest_gbp = float((litres * sets.fuel_price_gbp_per_litre + sets.start_cost_gbp).sum())
    customers = scenario.customers
    first = customers.weight[customers.tier == scenario.tiers[0]]
    least = float(first.min(initial=np.inf)) * dt_h
    if scenario.objective.lambda_grid * dearest_gbp >= least:
        raise InputError.of(
            "scenario.toml",
            "makes fuel and starts of sets count as much as a customer of the first tier",
            f"Give less than {least / dearest_gbp:.1e}.",
            field="objective.lambda_grid",
            value=scenario.objective.lambda_grid,
        )


def _sessions(scenario: Scenario, seed: int) -> tuple[Floats, Floats]:
    """Weight and capacity of the vehicles that plans may count, known or expected."""
    grid = scenario.grid
    counted = [scenario.sessions.rows(~scenario.sessions.over(grid.start))]
    past_days = PastDays.of(scenario, seed)
    if past_days is not None:
        counted.append(past_days.expected(grid, range(grid.n_steps)))
    weight, full_kwh = (
        np.concatenate([getattr(each, name) for each in counted]) for name in ("weight", "full_kwh")
    )
    return weight, full_kwh


def _of_vehicles(scenario: Scenario, weight: Floats, full_kwh: Floats) -> float:
    """Least worth of a kWh at a charger, in weighted customer hours; infinite if none is missed."""
    least_weight = float(scenario.customers.weight.min())
    scale = price_scale(weight, full_kwh, least_weight, scenario.grid.dt_h)
    if not scale:
        return np.inf
    return scale * float(weight.min()) * float(scenario.chargers.eta_charge.min())


def _of_rooms(scenario: Scenario, horizon_h: float) -> float:
    """The same of a kWh of a machine, in a window each of whose steps misses the most of the day.

    A kWh moves a temperature at the end of its step at least, and so for one step.
    """
    rooms = Rooms.of(scenario, range(scenario.grid.n_steps), scenario.thermal_loads.t_initial_c)
    if rooms is None:
        return np.inf
    over_c, under_c = rooms.missed_c(rooms.t_c(np.zeros_like(rooms.most_kw)))
    dt_h = scenario.grid.dt_h
    window_h = dt_h * len(scenario.grid.window(0, horizon_h))
    most_k_h = window_h * (over_c + under_c).max(axis=0)
    weight = rooms.weight[0]
    scale = OF_A_STEP * price_scale(weight, most_k_h, float(scenario.customers.weight.min()), dt_h)
    if not scale:
        return np.inf
    return scale * float((weight * np.abs(rooms.c_per_kw).min(axis=0)).min())
