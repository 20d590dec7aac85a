"""Generating sets in the record of a run, and their figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.core.text import counted
from vppres.day.trajectory import Trajectory
from vppres.plant.plant import Plant, Realised


def genset_record(plant: Plant, t: int, realised: Realised) -> dict[str, Any] | None:
    """What sets did in a step, and what is in their tanks; None without any."""
    sets = plant.scenario.gensets
    if not len(sets):
        return None
    before = plant.engines.state
    on = np.broadcast_to(realised.genset_on, len(sets))
    power_kw = np.broadcast_to(realised.genset_kw, len(sets))
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
    }


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
    shape = (-1, len(sets))
    burnt = rows["burnt_litres"].to_numpy(float).reshape(shape)
    started = rows["started"].to_numpy(bool).reshape(shape)
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
    """What sets burnt and what is left, in a sentence; none if none ran."""
    figures = genset_figures(trajectory).get("gensets", {})
    if not figures.get("hours_on"):
        return []
    return [
        f"{counted(figures['sets'], 'generating set')}: {figures['hours_on']:g} h on, "
        f"{counted(figures['starts'], 'start')}, {figures['given_kwh']:.0f} kWh from "
        f"{figures['burnt_litres']:.0f} l of fuel; {figures['left_litres']:.0f} l left."
    ]
