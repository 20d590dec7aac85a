"""Vehicles in the record of a run, their figures, and words about those that left short."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vppres.core.text import named
from vppres.day.trajectory import Trajectory
from vppres.plant.plant import Plant, Realised

NAMED = 5
"""Vehicles that a sentence names."""


SHORT_KWH = 1e-3
"""Energy that a vehicle may lack without being short: the rounding of plans."""


def vehicle_record(plant: Plant, t: int, realised: Realised) -> dict[str, NDArray[Any]]:
    """What chargers did in a step, and what vehicles lack that leave then."""
    day = plant.scenario
    power_kw = realised.taken_kw["chargers"]
    session = day.session_at[t]
    here = session >= 0
    end_kwh = plant.garage.after_kwh(t, power_kw)
    _, after = day.sessions.steps(day.grid)
    found: dict[str, NDArray[Any]] = {
        "vehicle": np.full(len(session), "", dtype=object),
        "tier": np.full(len(session), "", dtype=object),
        "plugged": here,
        "p_kw": power_kw,
        "energy_start_kwh": plant.garage.held_kwh(t),
        "energy_end_kwh": end_kwh,
        "needed_kwh": np.full(len(session), np.nan),
        "leaves": np.zeros(len(session), dtype=bool),
        "short_kwh": np.zeros(len(session)),
    }
    row = session[here]
    found["vehicle"][here] = day.sessions.vehicle[row]
    found["tier"][here] = day.sessions.tier[row]
    found["needed_kwh"][here] = day.sessions.needed_kwh[row]
    found["leaves"][here] = after[row] == t + 1
    lacks_kwh = found["needed_kwh"] - end_kwh
    short = found["leaves"] & (lacks_kwh > SHORT_KWH)
    found["short_kwh"][short] = lacks_kwh[short]
    return found


def vehicle_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Energy that vehicles were given and missed, and how many left short; empty without any.

    Returns
    -------
    dict
        ``vehicles``: departures, those that were short, missed energy in kWh in all and by tier,
        energy that was charged and given back at the connection in kWh.
    """
    rows = trajectory.vehicles
    if rows is None:
        return {}
    day = trajectory.scenario
    dt_h = day.grid.dt_h
    left = rows[rows["leaves"]]
    by_tier = left.groupby("tier")["short_kwh"].sum()
    return {
        "vehicles": {
            "departures": len(left),
            "left_short": int((left["short_kwh"] > 0.0).sum()),
            "missed_kwh": float(left["short_kwh"].sum()),
            "missed_kwh_by_tier": {
                tier: float(by_tier[tier]) for tier in day.tiers if tier in by_tier
            },
            "charged_kwh": float(rows["p_kw"].clip(lower=0.0).sum()) * dt_h,
            "given_back_kwh": float((-rows["p_kw"]).clip(lower=0.0).sum()) * dt_h,
        }
    }


def vehicle_words(trajectory: Trajectory) -> list[str]:
    """How many vehicles left with less than they need, in a sentence; none if all have enough."""
    figures = vehicle_figures(trajectory).get("vehicles", {})
    if not figures.get("left_short"):
        return []
    rows = trajectory.vehicles
    assert rows is not None
    short = rows[rows["short_kwh"] > 0.0].sort_values("short_kwh", ascending=False, kind="stable")
    names = [f"{row.vehicle} {row.short_kwh:.1f} kWh" for row in short.itertuples()]
    return [
        f"{figures['left_short']} of {figures['departures']} vehicles left short of "
        f"{figures['missed_kwh']:.1f} kWh in all: {named(names, NAMED)}."
    ]
