"""Vehicles in the record of a run, their figures, and words about those that left short."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Floats
from vppres.core.text import named
from vppres.day.trajectory import Trajectory
from vppres.kinds.kind import NAMES_SHOWN
from vppres.kinds.vehicles.past_days import PastDays
from vppres.kinds.vehicles.physics import Garage
from vppres.plant.plant import Realised
from vppres.scenario.scenario import Scenario

NAMED = 5
"""Vehicles that a sentence names."""


SHORT_KWH = 1e-3
"""Energy that a vehicle may lack without being short: the rounding of plans."""


def record(day: Scenario, garage: Garage, t: int, realised: Realised) -> dict[str, NDArray[Any]]:
    """Power of chargers in a step, and energy that vehicles lack that leave then."""
    power_kw = realised.taken_kw["chargers"]
    session = day.session_at[t]
    here = session >= 0
    end_kwh = garage.after_kwh(t, power_kw)
    _, after = day.sessions.steps(day.grid)
    found: dict[str, NDArray[Any]] = {
        "vehicle": np.full(len(session), "", dtype=object),
        "tier": np.full(len(session), "", dtype=object),
        "plugged": here,
        "p_kw": power_kw,
        "energy_start_kwh": garage.at(t),
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


def state_of(rows: pd.DataFrame) -> Floats:
    """Energy of the vehicles at the beginning of a step, from its rows of the table."""
    return rows["energy_start_kwh"].to_numpy(float)


def figures(trajectory: Trajectory) -> dict[str, Any]:
    """Energy that vehicles were given and missed, and how many left short.

    Returns
    -------
    dict
        Departures, those that were short, missed energy in kWh in all and by tier, energy that was
        charged and given back at the connection in kWh.
    """
    rows = trajectory.tables["vehicles"]
    day = trajectory.scenario
    dt_h = day.grid.dt_h
    left = rows[rows["leaves"]]
    by_tier = left.groupby("tier")["short_kwh"].sum()
    return {
        "departures": len(left),
        "left_short": int((left["short_kwh"] > 0.0).sum()),
        "missed_kwh": float(left["short_kwh"].sum()),
        "missed_kwh_by_tier": {tier: float(by_tier[tier]) for tier in day.tiers if tier in by_tier},
        "charged_kwh": float(rows["p_kw"].clip(lower=0.0).sum()) * dt_h,
        "given_back_kwh": float((-rows["p_kw"]).clip(lower=0.0).sum()) * dt_h,
    }


def cautions(trajectory: Trajectory) -> list[str]:
    """How many vehicles left with less than they need, in a sentence; none if all have enough."""
    found = figures(trajectory)
    if not found["left_short"]:
        return []
    rows = trajectory.tables["vehicles"]
    short = rows[rows["short_kwh"] > 0.0].sort_values("short_kwh", ascending=False, kind="stable")
    names = [f"{row.vehicle} {row.short_kwh:.1f} kWh" for row in short.itertuples()]
    return [
        f"{found['left_short']} of {found['departures']} vehicles left short of "
        f"{found['missed_kwh']:.1f} kWh in all: {named(names, NAMED)}."
    ]


def events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """Vehicles that leave with less than they need."""
    lacks_kwh = run.by_step("vehicles", "short_kwh")
    for t in np.flatnonzero((lacks_kwh > 0.0).any(axis=1)).tolist():
        rows = run.rows("vehicles", t)
        names = [
            f"{row['vehicle']} ({row['tier']}, {row['short_kwh']:.1f} kWh)"
            for row in rows[rows["short_kwh"] > 0.0].to_dict("records")
        ]
        what = "vehicle leaves" if len(names) == 1 else "vehicles leave"
        yield t + 1, f"{len(names)} {what} short: {named(names, NAMES_SHOWN)}."


def assumption(run: Trajectory) -> str:
    """Assumptions of plans about vehicles."""
    day = run.scenario
    count = int((~day.sessions.over(day.grid.start)).sum())
    words = (
        f"{count} sessions of vehicles at {len(day.chargers)} chargers come after service; a plan "
        "knows those that are plugged in or announced"
    )
    past_days = PastDays.of(day, int(run.options["seed"]))
    if past_days is None:
        return f"{words}."
    return f"{words}, and expects others as on one of {len(past_days.days)} past days."


def energies(figures: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Energies of the first page in kWh, from the figures."""
    return [
        ("Vehicles charged", figures["charged_kwh"]),
        ("Vehicles gave back", figures["given_back_kwh"]),
    ]
