"""Why a generating set runs, and why it stopped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vppres.day.trajectory import FORMS
from vppres.explain.reason import Reason
from vppres.explain.recorded import MOVE_KW
from vppres.explain.step import Step

ACTIONS = {
    "ran": "generating set ran",
    "stopped": "generating set stopped in an outage",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Step) -> Iterator[tuple[str, str, Reason]]:
    """Name of each set that runs, or that stopped in an outage, the action, and why."""
    now: Any = step.recorded.trajectory.rows("gensets", step.t)
    for g, each in enumerate(now.to_dict("records")):
        name = str(each["genset"])
        if each["running"]:
            yield name, "ran", _why_on(step, g, each)
        elif each["hours_before"] > 0.0 and step.outage:
            yield name, "stopped", _why_off(step, g, each)


def _why_on(step: Step, g: int, row: dict[str, Any]) -> Reason:
    """Why a set runs: its least time, batteries that charge for later, customers, or the price."""
    sets = step.scenario.gensets
    what = f"Generator {sets.id[g]} runs"
    gives = f"{row['p_kw']:.1f} kW, {row['fuel_end_litres']:.0f} l left"
    least_h = sets.min_on_h[g]
    if not step.outage and 0.0 < row["hours_before"] < least_h:
        words = f"{what} because it has to stay on for {least_h:g} h ({gives})."
        return Reason("switching_rule", "", words)
    if not step.outage:
        return Reason("price", "", f"{what} because the grid is dearer or limited ({gives}).")
    if row.get(FORMS):
        return Reason("supply", "", f"{what} because it forms the grid of the island ({gives}).")
    charging_kw = float(step.battery_kw[step.battery_kw > MOVE_KW].sum())
    if charging_kw > 0.0:
        words = (
            f"{what} because the grid is away, and charges batteries with up to "
            f"{min(charging_kw, row['p_kw']):.1f} kW for later ({gives})."
        )
        return Reason("preparation", "", words)
    return Reason("supply", "", f"{what} because the grid is away ({gives}).")


def _why_off(step: Step, g: int, row: dict[str, Any]) -> Reason:
    """Why a set stopped in an outage: no fuel, or the others are enough."""
    sets = step.scenario.gensets
    left = row["fuel_end_litres"]
    if left < sets.least_litres(step.scenario.grid.dt_h)[g]:
        words = f"Generator {sets.id[g]} stopped: {left:.0f} l are not enough for a step."
        return Reason("energy", "energy", words)
    words = f"Generator {sets.id[g]} stopped: PV and batteries carry the step, {left:.0f} l left."
    return Reason("plan", "", words)
