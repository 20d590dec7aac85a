"""Rooms and tanks in the record of a run, and their figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.core.text import counted
from vppres.day.trajectory import Trajectory
from vppres.plant.plant import Plant, Realised

MISSED_C = 1e-6
"""By how much a temperature may be outside its band without missing it: the rounding of plans."""


def climate_record(plant: Plant, t: int, realised: Realised) -> dict[str, Any]:
    """What machines did in a step, and how rooms and tanks are."""
    day = plant.scenario
    loads = day.thermal_loads
    power_kw = realised.taken_kw["thermal_loads"]
    end_c = plant.climate.after_c(t, power_kw)
    return {
        "tier": day.customers.tier[loads.owner(day.customers)],
        "p_kw": power_kw,
        "t_start_c": plant.climate.t_c,
        "t_end_c": end_c,
        "t_min_c": loads.t_min_c,
        "t_max_c": loads.t_max_c,
        "outside_band_c": _outside_band(loads.t_min_c, loads.t_max_c, end_c),
    }


def _outside_band(t_min_c: Floats, t_max_c: Floats, t_c: Floats) -> Floats:
    """By how much temperatures are outside their band."""
    away_c = np.maximum(t_c - t_max_c, t_min_c - t_c)
    return np.where(away_c > MISSED_C, away_c, 0.0)


def thermal_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Comfort that was missed, in all and by tier, and energy of machines; empty without any.

    Returns
    -------
    dict
        ``thermal_loads``: how many there are, K h outside the comfort band, hours outside it and
        above it, all summed over the loads, in all and by tier; and the energy that machines took
        in kWh.
    """
    rows = trajectory.thermal_loads
    if rows is None:
        return {}
    day = trajectory.scenario
    dt_h = day.grid.dt_h
    hours = (rows["outside_band_c"] > 0.0).groupby(rows["tier"]).sum() * dt_h
    too_warm = rows["t_end_c"] - rows["t_max_c"] > MISSED_C
    above = too_warm.groupby(rows["tier"]).sum() * dt_h
    missed = rows.groupby("tier")["outside_band_c"].sum() * dt_h
    tiers = [tier for tier in day.tiers if tier in missed]
    return {
        "thermal_loads": {
            "loads": len(day.thermal_loads),
            "missed_k_h": float(missed.sum()),
            "missed_k_h_by_tier": {tier: float(missed[tier]) for tier in tiers},
            "hours_above_band_by_tier": {tier: float(above[tier]) for tier in tiers},
            "hours_outside_band": float(hours.sum()),
            "hours_outside_band_by_tier": {tier: float(hours[tier]) for tier in tiers},
            "machines_kwh": float(rows["p_kw"].sum()) * dt_h,
        }
    }


def thermal_words(trajectory: Trajectory) -> list[str]:
    """How long rooms and tanks were outside their comfort band, in a sentence; none if none was."""
    figures = thermal_figures(trajectory).get("thermal_loads", {})
    if not figures.get("missed_k_h"):
        return []
    rows = trajectory.thermal_loads
    assert rows is not None
    missed = rows.loc[rows["outside_band_c"] > 0.0, "thermal_load"].nunique()
    by_tier = ", ".join(
        f"{tier} {hours:g} h" for tier, hours in figures["hours_outside_band_by_tier"].items()
    )
    return [
        f"{missed} of {counted(figures['loads'], 'room or tank', 'rooms and tanks')} outside the "
        f"comfort band, for {figures['hours_outside_band']:g} h and "
        f"{figures['missed_k_h']:.1f} K h in all ({by_tier})."
    ]
