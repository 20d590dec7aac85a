"""Rooms and tanks in words: record of a run, figures, cautions, events, and reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.text import counted, named
from vppres.day.trajectory import Trajectory
from vppres.kinds.cooling.physics import Climate
from vppres.kinds.kind import MOVE_KW, NAMES_SHOWN, Why
from vppres.plant.plant import Realised
from vppres.scenario.scenario import Scenario

MISSED_C = 1e-6
"""By how much a temperature may be outside its band without missing it: the rounding of plans."""


def record(day: Scenario, climate: Climate, t: int, realised: Realised) -> dict[str, Any]:
    """Power of machines in a step, and temperatures of rooms and tanks."""
    loads = day.thermal_loads
    power_kw = realised.taken_kw["thermal_loads"]
    end_c = climate.after_c(t, power_kw)
    away_c = np.maximum(end_c - loads.t_max_c, loads.t_min_c - end_c)
    return {
        "tier": day.customers.tier[loads.owner(day.customers)],
        "p_kw": power_kw,
        "t_start_c": climate.state,
        "t_end_c": end_c,
        "t_min_c": loads.t_min_c,
        "t_max_c": loads.t_max_c,
        "outside_band_c": np.where(away_c > MISSED_C, away_c, 0.0),
    }


def state_of(rows: pd.DataFrame) -> Floats:
    """Temperatures at the beginning of a step, from its rows of the table."""
    return rows["t_start_c"].to_numpy(float)


def figures(trajectory: Trajectory) -> dict[str, Any]:
    """Comfort that was missed, in all and by tier, and energy of machines.

    Returns
    -------
    dict
        How many loads there are, K h outside the comfort band, hours outside it and above it, all
        summed over the loads, in all and by tier; and the energy that machines took in kWh.
    """
    rows = trajectory.tables["thermal_loads"]
    day = trajectory.scenario
    dt_h = day.grid.dt_h
    hours = (rows["outside_band_c"] > 0.0).groupby(rows["tier"]).sum() * dt_h
    too_warm = rows["t_end_c"] - rows["t_max_c"] > MISSED_C
    above = too_warm.groupby(rows["tier"]).sum() * dt_h
    missed = rows.groupby("tier")["outside_band_c"].sum() * dt_h
    tiers = [tier for tier in day.tiers if tier in missed]
    return {
        "loads": len(day.thermal_loads),
        "missed_k_h": float(missed.sum()),
        "missed_k_h_by_tier": {tier: float(missed[tier]) for tier in tiers},
        "hours_above_band_by_tier": {tier: float(above[tier]) for tier in tiers},
        "hours_outside_band": float(hours.sum()),
        "hours_outside_band_by_tier": {tier: float(hours[tier]) for tier in tiers},
        "machines_kwh": float(rows["p_kw"].sum()) * dt_h,
    }


def cautions(trajectory: Trajectory) -> list[str]:
    """How long rooms and tanks were outside their comfort band, in a sentence; none if none was."""
    found = figures(trajectory)
    if not found["missed_k_h"]:
        return []
    rows = trajectory.tables["thermal_loads"]
    missed = rows.loc[rows["outside_band_c"] > 0.0, "thermal_load"].nunique()
    by_tier = ", ".join(
        f"{tier} {hours:g} h" for tier, hours in found["hours_outside_band_by_tier"].items()
    )
    return [
        f"{missed} of {counted(found['loads'], 'room or tank', 'rooms and tanks')} outside the "
        f"comfort band, for {found['hours_outside_band']:g} h and "
        f"{found['missed_k_h']:.1f} K h in all ({by_tier})."
    ]


def events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Rooms and tanks that leave their comfort band."""
    names = run.scenario.thermal_loads.id
    t_c, away_c = (run.by_step("thermal_loads", name) for name in ("t_end_c", "outside_band_c"))
    leaves = (away_c > 0.0) & ~np.vstack([np.zeros_like(names, dtype=bool), away_c[:-1] > 0.0])
    for t in np.flatnonzero(leaves.any(axis=1)).tolist():
        who = [f"{names[h]} ({t_c[t, h]:.1f} °C)" for h in np.flatnonzero(leaves[t])]
        what = "room or tank leaves its" if len(who) == 1 else "rooms or tanks leave their"
        yield t + 1, f"{len(who)} {what} comfort band: {named(who, NAMES_SHOWN)}."


def assumption(run: Trajectory) -> str:
    """Assumptions of plans about rooms and tanks."""
    count = len(run.scenario.thermal_loads)
    return f"{count} rooms and tanks come after service; the temperature outside is known."


def energies(figures: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Energies of the first page in kWh, from the figures."""
    return [("Cooling and heat", figures["machines_kwh"])]


AHEAD_C = 0.5
"""How far inside its band a temperature is that was brought there for later."""

ACTIONS = {
    "prepared": "cooled or heated ahead",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Any) -> Iterator[tuple[str, str, Why]]:
    """Name of each room or tank that was prepared for an outage, the action, and why."""
    day = step.scenario
    if step.outage:
        return
    seen = day.outage[step.t : step.t + step.windows.n_seen]
    known = step.recorded.trajectory.options["outages"]
    if known == "none" or not seen.any():
        return
    goes = day.grid.times[step.t + int(np.argmax(seen))].tz_convert(day.grid.zone)
    when = f"goes at {goes:%H:%M}" if known == "known" else "may go"
    now: Any = step.recorded.trajectory.rows("thermal_loads", step.t)
    for load in now.to_dict("records"):
        change_c = load["t_end_c"] - load["t_start_c"]
        heats = change_c > 0.0
        inside_c = load["t_end_c"] - load["t_min_c"] if heats else load["t_max_c"] - load["t_end_c"]
        if load["p_kw"] > MOVE_KW and change_c != 0.0 and inside_c > AHEAD_C:
            verb = "Heated" if heats else "Cooled"
            words = f"{verb} to {load['t_end_c']:.1f} °C because the grid {when}."
            yield str(load["thermal_load"]), "prepared", ("preparation", "", words)
