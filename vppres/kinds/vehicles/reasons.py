"""Why a vehicle was charged or discharged, and why it left with less than it needs."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Any

import numpy as np

from vppres.explain.reason import Reason
from vppres.explain.recorded import MOVE_KW
from vppres.explain.step import Step

Vehicle = dict[str, Any]

ACTIONS = {
    "expected": "vehicle expected",
    "charged": "vehicle charged",
    "given_back": "vehicle discharged",
    "left_short": "vehicle left short",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Step) -> Iterator[tuple[str, str, Reason]]:
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


def _expected(step: Step) -> Iterator[tuple[str, str, Reason]]:
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
        yield str(sessions.vehicle[s]), "expected", Reason("past_day", "", words)


def why_charged(step: Step, charger: int, car: Vehicle) -> Reason:
    """Why a vehicle was charged."""
    what = f"Charges {car['p_kw']:.1f} kW"
    missing_kwh = car["needed_kwh"] - car["energy_start_kwh"]
    if missing_kwh > 0.0:
        session = step.scenario.session_at[step.t, charger]
        leaves = step.scenario.grid.local(step.scenario.sessions.plug_out[session])
        words = f"{what}: it leaves at {leaves:%H:%M} and needs {missing_kwh:.1f} kWh more."
        return Reason("departure", "", words)
    if step.outage:
        return Reason("surplus", "", f"{what} beyond its need: the power would be curtailed.")
    return Reason("preparation", "", f"{what} beyond its need, to give it back later.")


def why_given_back(step: Step, car: Vehicle) -> Reason:
    """Why a vehicle was discharged."""
    what = f"Gives {-car['p_kw']:.1f} kW"
    if step.outage:
        return Reason("supply", "", f"{what} to the island, of what it holds above its floor.")
    return Reason("price", "", f"{what} back now, and is charged when that costs less.")


def why_short(step: Step, charger: int, car: Vehicle) -> Reason:
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
        return Reason("power", "power", words)
    dark = day.outage[plugged]
    if dark[-1]:
        words = f"{what}: it left inside the outage, and customers come first."
        return Reason("priority", "", words)
    if dark.any():
        hours = float(dark.sum()) * day.grid.dt_h
        words = f"{what}: {hours:g} h of its time were an outage, and customers come first."
        return Reason("priority", "", words)
    if np.isfinite(day.grid_limit_kw[plugged]).any():
        return Reason("grid", "grid", f"{what}: the import is limited.")
    return Reason("unexplained", "", f"{what}: the record gives no reason.")
