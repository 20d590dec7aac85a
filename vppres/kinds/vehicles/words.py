"""Vehicles in words: record of a run, figures, cautions, events, and reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import date
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.core.arrays import Floats
from vppres.core.text import named
from vppres.day.trajectory import Trajectory
from vppres.kinds.kind import MOVE_KW, NAMES_SHOWN, Why
from vppres.kinds.vehicles.physics import Garage, PastDays
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


Vehicle = dict[str, Any]

ACTIONS = {
    "expected": "vehicle expected",
    "charged": "vehicle charged",
    "given_back": "vehicle discharged",
    "left_short": "vehicle left short",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Any) -> Iterator[tuple[str, str, Why]]:
    """Name of each vehicle that was expected, charged, discharged or left short, and why."""
    yield from _expected(step)
    now: Any = step.recorded.trajectory.rows("vehicles", step.t)
    for charger, car in enumerate(now.to_dict("records")):
        if not car["plugged"]:
            continue
        name = str(car["vehicle"])
        if car["p_kw"] > MOVE_KW:
            yield name, "charged", why_charged(step, charger, car)
        if car["p_kw"] < -MOVE_KW:
            yield name, "given_back", why_given_back(step, car)
        if car["short_kwh"] > 0.0:
            yield name, "left_short", why_short(step, charger, car)


def _expected(step: Any) -> Iterator[tuple[str, str, Why]]:
    """Vehicles that plans before the step expected to come at its beginning."""
    past_days, grid = step.windows.observer.past_days["chargers"], step.scenario.grid
    if past_days is None:
        return
    sessions = past_days.expected(grid, range(step.t, step.t + 1))
    today = grid.local(grid.start + step.t * grid.step).toordinal()
    like = date.fromordinal(past_days.drawn_for(today))
    needs_kwh = sessions.needed_kwh - sessions.held_kwh
    first, _ = sessions.steps(grid)
    for s in np.flatnonzero(first == step.t).tolist():
        leaves = grid.local(sessions.plug_out[s])
        words = f"Expected as on {like}: up to {leaves:%H:%M}, to need {needs_kwh[s]:.1f} kWh."
        yield str(sessions.vehicle[s]), "expected", ("past_day", "", words)


def why_charged(step: Any, charger: int, car: Vehicle) -> Why:
    """Why a vehicle was charged."""
    what = f"Charges {car['p_kw']:.1f} kW"
    missing_kwh = car["needed_kwh"] - car["energy_start_kwh"]
    if missing_kwh > 0.0:
        session = step.scenario.session_at[step.t, charger]
        leaves = step.scenario.grid.local(step.scenario.sessions.plug_out[session])
        words = f"{what}: it leaves at {leaves:%H:%M} and needs {missing_kwh:.1f} kWh more."
        return "departure", "", words
    if step.outage:
        return "surplus", "", f"{what} beyond its need: the power would be curtailed."
    return "preparation", "", f"{what} beyond its need, to give it back later."


def why_given_back(step: Any, car: Vehicle) -> Why:
    """Why a vehicle was discharged."""
    what = f"Gives {-car['p_kw']:.1f} kW"
    if step.outage:
        return "supply", "", f"{what} to the island, of what it holds above its floor."
    return "price", "", f"{what} back now, and is charged when that costs less."


def why_short(step: Any, charger: int, car: Vehicle) -> Why:
    """Why a vehicle left with less than it needs."""
    day = step.scenario
    what = f"Leaves {car['short_kwh']:.1f} kWh short"
    session = day.session_at[step.t, charger]
    plugged = np.flatnonzero(day.session_at[:, charger] == session)
    rate_kw = day.chargers.eta_charge[charger] * day.chargers.p_charge_kw[charger]
    most_kwh = rate_kw * len(plugged) * day.grid.dt_h
    held_kwh = step.recorded.trajectory.by_step("vehicles", "energy_start_kwh")[plugged[0], charger]
    if car["needed_kwh"] - held_kwh > most_kwh:
        words = f"{what}: its charger gives at most {most_kwh:.1f} kWh while it is plugged in."
        return "power", "power", words
    dark = day.outage[plugged]
    if dark[-1]:
        words = f"{what}: it left inside the outage, and customers come first."
        return "priority", "", words
    if dark.any():
        hours = float(dark.sum()) * day.grid.dt_h
        words = f"{what}: {hours:g} h of its time were an outage, and customers come first."
        return "priority", "", words
    if np.isfinite(day.grid_limit_kw[plugged]).any():
        return "grid", "grid", f"{what}: the import is limited."
    return "unexplained", "", f"{what}: the record gives no reason."
