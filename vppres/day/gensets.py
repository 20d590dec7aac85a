"""Generating sets in the record of a run, and their figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Names
from vppres.core.text import named
from vppres.day.trajectory import FORMS, Trajectory
from vppres.plant.plant import Plant, Realised
from vppres.scenario.gensets import ROUNDING_H, Gensets

NAMES_SHOWN = 6


def genset_record(plant: Plant, t: int, realised: Realised) -> dict[str, Any]:
    """What sets did in a step, and what is in their tanks."""
    sets = plant.scenario.gensets
    before = plant.engines.state
    on, power_kw = realised.running["gensets"], 0.0 - realised.taken_kw["gensets"]
    after = plant.engines.after(t, on, power_kw)
    return {
        "running": on,
        "started": on & ~before.on,
        "p_kw": power_kw,
        "hours_before": np.where(before.on, before.hours, -before.hours),
        "p_before_kw": before.power_kw,
        "fuel_start_litres": before.fuel_litres,
        "burnt_litres": sets.litres(on, power_kw, plant.scenario.grid.dt_h),
        "fuel_end_litres": after.fuel_litres,
        **_forming(sets, realised),
    }


def _forming(sets: Gensets, realised: Realised) -> dict[str, Any]:
    """Which set formed the grid, and its reactive power; nothing where none can."""
    if not sets.grid_forming.any():
        return {}
    forms, q_kvar = np.zeros(len(sets), dtype=bool), np.zeros(len(sets))
    if realised.forming is not None:
        forms[realised.forming.genset] = True
        q_kvar[realised.forming.genset] = realised.forming.q_kvar
    return {FORMS: forms, "q_kvar": q_kvar}


def genset_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Hours, starts, energy and fuel of sets; empty without any.

    Returns
    -------
    dict
        ``gensets``: how many there are; hours on, starts, energy in kWh, fuel burnt and fuel left
        in litres, summed over the sets; and what fuel and starts cost in GBP.
    """
    rows = trajectory.gensets
    if rows is None:
        return {}
    sets = trajectory.scenario.gensets
    dt_h = trajectory.scenario.grid.dt_h
    burnt, started = (trajectory.by_step("gensets", name) for name in ("burnt_litres", "started"))
    cost = burnt @ sets.fuel_price_gbp_per_litre + started @ sets.start_cost_gbp
    return {
        "gensets": {
            "sets": len(sets),
            "hours_on": float(rows["running"].sum()) * dt_h,
            "starts": int(started.sum()),
            "given_kwh": float(rows["p_kw"].sum()) * dt_h,
            "burnt_litres": float(burnt.sum()),
            "left_litres": float(rows["fuel_end_litres"].to_numpy(float)[-len(sets) :].sum()),
            "cost_gbp": float(cost.sum()),
        }
    }


def genset_words(trajectory: Trajectory) -> list[str]:
    """Sets without fuel in an outage, and those that stopped too early; none if there is none."""
    if trajectory.gensets is None:
        return []
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
