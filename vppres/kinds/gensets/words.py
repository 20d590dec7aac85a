"""Generating sets in words: record of a run, figures, cautions, events, and reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Names
from vppres.core.text import named
from vppres.day.trajectory import FORMS, Trajectory
from vppres.kinds.gensets import ROUNDING_H, Gensets, GensetState
from vppres.kinds.gensets.physics import Engines
from vppres.kinds.kind import MOVE_KW, NAMES_SHOWN, Why
from vppres.plant.plant import Realised
from vppres.scenario.scenario import Scenario


def record(day: Scenario, engines: Engines, t: int, realised: Realised) -> dict[str, Any]:
    """Power and starts of sets in a step, and the fuel in their tanks."""
    sets = day.gensets
    before = engines.state
    on, power_kw = realised.running["gensets"], 0.0 - realised.taken_kw["gensets"]
    after = engines.after(t, realised.taken_kw["gensets"], on)
    return {
        "running": on,
        "started": on & ~before.on,
        "p_kw": power_kw,
        "hours_before": np.where(before.on, before.hours, -before.hours),
        "p_before_kw": before.power_kw,
        "fuel_start_litres": before.fuel_litres,
        "burnt_litres": sets.litres(on, power_kw, day.grid.dt_h),
        "fuel_end_litres": after.fuel_litres,
        **_forming(sets, realised),
    }


def _forming(sets: Gensets, realised: Realised) -> dict[str, Any]:
    """Which sets formed grids of islands, and their reactive power; nothing where none can."""
    if not sets.grid_forming.any():
        return {}
    forms, q_kvar = np.zeros(len(sets), dtype=bool), np.zeros(len(sets))
    for one in realised.forming:
        forms[one.genset] = True
        q_kvar[one.genset] = one.q_kvar
    return {FORMS: forms, "q_kvar": q_kvar}


def state_of(rows: pd.DataFrame) -> GensetState:
    """State at the beginning of a step, from its rows of the table."""
    hours, power_kw, litres = (
        rows[name].to_numpy(float) for name in ("hours_before", "p_before_kw", "fuel_start_litres")
    )
    return GensetState(hours > 0.0, np.abs(hours), power_kw, litres)


def figures(trajectory: Trajectory) -> dict[str, Any]:
    """Hours, starts, energy and fuel of sets.

    Returns
    -------
    dict
        How many sets there are; hours on, starts, energy in kWh, fuel burnt and fuel left
        in litres, summed over the sets; and what fuel and starts cost in GBP.
    """
    rows = trajectory.tables["gensets"]
    sets = trajectory.scenario.gensets
    dt_h = trajectory.scenario.grid.dt_h
    burnt, started = (trajectory.by_step("gensets", name) for name in ("burnt_litres", "started"))
    cost = burnt @ sets.fuel_price_gbp_per_litre + started @ sets.start_cost_gbp
    return {
        "sets": len(sets),
        "hours_on": float(rows["running"].sum()) * dt_h,
        "starts": int(started.sum()),
        "given_kwh": float(rows["p_kw"].sum()) * dt_h,
        "burnt_litres": float(burnt.sum()),
        "left_litres": float(rows["fuel_end_litres"].to_numpy(float)[-len(sets) :].sum()),
        "cost_gbp": float(cost.sum()),
    }


def cautions(trajectory: Trajectory) -> list[str]:
    """Sets without fuel in an outage, and those that stopped too early; none if there is none."""
    day = trajectory.scenario
    sets, dt_h = day.gensets, day.grid.dt_h
    on, fuel_litres, before_h = (
        trajectory.by_step("gensets", name)
        for name in ("running", "fuel_start_litres", "hours_before")
    )
    outage = trajectory.steps["outage"].to_numpy(bool)[:, None]
    dry = outage & ~on & (fuel_litres < sets.least_litres(dt_h))
    early = ~on & (before_h > 0.0) & (before_h < sets.min_on_h - ROUNDING_H)
    found = []
    if dry.any():
        found.append(
            f"{_names(sets.id, dry)} without fuel in the outage, "
            f"for {float(dry.sum()) * dt_h:g} h in all."
        )
    if early.any():
        found.append(f"{_names(sets.id, early)} stopped before the least time on.")
    return found


def _names(ids: Names, which: Flags) -> str:
    """Sets that are meant in any step, (T, G), as the beginning of a sentence."""
    meant = [str(name) for name in ids[which.any(axis=0)]]
    return f"{'Generator' if len(meant) == 1 else 'Generators'} {named(meant, NAMES_SHOWN)}"


def events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """When generating sets start and stop, with the fuel that they have then."""
    names = run.scenario.gensets.id
    on, fuel_litres, hours_before = (
        run.by_step("gensets", name) for name in ("running", "fuel_start_litres", "hours_before")
    )
    for t, g in np.argwhere(on != (hours_before > 0.0)).tolist():
        verb = "starts" if on[t, g] else "stops"
        yield t, f"Generator {names[g]} {verb}, with {fuel_litres[t, g]:.0f} l of fuel."


def assumption(run: Trajectory) -> str:
    """Assumptions of plans about generating sets."""
    return (
        f"{len(run.scenario.gensets)} generating sets have a power factor of 1 where they form no "
        "grid; a set starts in the step for which it is told to."
    )


def energies(figures: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Energies of the first page in kWh, from the figures."""
    return [("Generating sets gave", figures["given_kwh"])]


ACTIONS = {
    "ran": "generating set ran",
    "stopped": "generating set stopped in an outage",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Any) -> Iterator[tuple[str, str, Why]]:
    """Name of each set that runs, or that stopped in an outage, the action, and why."""
    now: Any = step.recorded.trajectory.rows("gensets", step.t)
    for g, each in enumerate(now.to_dict("records")):
        name = str(each["genset"])
        if each["running"]:
            yield name, "ran", _why_on(step, g, each)
        elif each["hours_before"] > 0.0 and step.outage:
            yield name, "stopped", _why_off(step, g, each)


def _why_on(step: Any, g: int, row: dict[str, Any]) -> Why:
    """Why a set runs: its least time, batteries that charge for later, customers, or the price."""
    sets = step.scenario.gensets
    what = f"Generator {sets.id[g]} runs"
    gives = f"{row['p_kw']:.1f} kW, {row['fuel_end_litres']:.0f} l left"
    least_h = sets.min_on_h[g]
    if not step.outage and 0.0 < row["hours_before"] < least_h:
        words = f"{what} because it has to stay on for {least_h:g} h ({gives})."
        return "switching_rule", "", words
    if not step.outage:
        return "price", "", f"{what} because the grid is dearer or limited ({gives})."
    if row.get(FORMS):
        return "supply", "", f"{what} because it forms the grid of the island ({gives})."
    charging_kw = float(step.battery_kw[step.battery_kw > MOVE_KW].sum())
    if charging_kw > 0.0:
        words = (
            f"{what} because the grid is away, and charges batteries with up to "
            f"{min(charging_kw, row['p_kw']):.1f} kW for later ({gives})."
        )
        return "preparation", "", words
    return "supply", "", f"{what} because the grid is away ({gives})."


def _why_off(step: Any, g: int, row: dict[str, Any]) -> Why:
    """Why a set stopped in an outage: no fuel, or the others are enough."""
    sets = step.scenario.gensets
    left = row["fuel_end_litres"]
    if left < sets.least_litres(step.scenario.grid.dt_h)[g]:
        words = f"Generator {sets.id[g]} stopped: {left:.0f} l are not enough for a step."
        return "energy", "energy", words
    words = f"Generator {sets.id[g]} stopped: PV and batteries carry the step, {left:.0f} l left."
    return "plan", "", words
