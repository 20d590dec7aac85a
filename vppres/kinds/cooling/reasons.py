"""Why a room was cooled, or a room or tank heated, further than its comfort needs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vppres.explain.reason import Reason
from vppres.explain.recorded import MOVE_KW
from vppres.explain.step import Step

AHEAD_C = 0.5
"""How far inside its band a temperature is that was brought there for later."""

ACTIONS = {
    "prepared": "cooled or heated ahead",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Step) -> Iterator[tuple[str, str, Reason]]:
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
            yield str(load["thermal_load"]), "prepared", Reason("preparation", "", words)
