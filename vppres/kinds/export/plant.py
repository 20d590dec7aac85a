"""The export limiter of a connection: what is beyond the limit does not leave the feeder.

It reads the meter at the grid, so losses are on its side. Sets, vehicles and batteries that give
are held back first, which loses nothing; then PV power that no customer uses is curtailed. An
import-only connection has no limiter: what its meter shows is the paper's business.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.physics.feeder import PowerFlow
from vppres.physics.powerflow import ACResult
from vppres.plant.changes import curtailed, part_of, spare, taking
from vppres.plant.plant import BatteryState, Plant, Powers, Realised

LIMIT_TOLERANCE_KW = 1e-3
"""By how much the AC export may exceed its limit."""

_MAX_ROUNDS = 20


def within_export_limit(
    plant: Plant, flow: PowerFlow, t: int, realised: Realised, state: BatteryState
) -> tuple[Realised, ACResult]:
    """A connected step with no more export than its limit, and its power flow.

    It begins with set-points as far as the devices can follow them, and the batteries' state then.

    Raises
    ------
    NoSolutionError, NotFoundError
        If the power flow has no solution, or none was found.
    """
    scenario = plant.scenario
    ac = flow.solve(realised.p_injection_kw, realised.q_injection_kvar)
    if not scenario.exports or scenario.outage[t]:
        return realised, ac
    limit_kw = float(scenario.export_max_kw[t])
    for _ in range(_MAX_ROUNDS):
        excess_kw = -ac.p_slack_kw - limit_kw
        if excess_kw <= LIMIT_TOLERANCE_KW:
            break
        held = _held_back(plant, realised, excess_kw)
        changes = [
            held.battery_kw - realised.battery_kw,
            held.pv_curtailed_kw - realised.pv_curtailed_kw,
            *(held.taken_kw[kind] - taken_kw for kind, taken_kw in realised.taken_kw.items()),
        ]
        moved = max(float(np.abs(each).max(initial=0.0)) for each in changes)
        if moved == 0.0:
            break  # nothing is left that the limiter could take
        realised = plant.realise(t, held, state, max(realised.clipped_kw, moved))
        ac = flow.solve(realised.p_injection_kw, realised.q_injection_kvar)
    return realised, ac


def _held_back(plant: Plant, powers: Powers, excess_kw: float) -> Powers:
    """Give and discharge less, then curtail what PV systems export; what owners use stays."""
    for kind, spare_kw in spare(plant, powers).items():
        if spare_kw.sum() > 0.0 and excess_kw > 0.0:
            off = part_of(spare_kw, excess_kw)
            powers = taking(powers, kind, powers.taken_kw[kind] + off)
            excess_kw -= float(off.sum())
    discharging = np.maximum(-powers.battery_kw, 0.0)
    less = np.zeros_like(discharging)
    if discharging.sum() > 0.0 and excess_kw > 0.0:
        less = part_of(discharging, excess_kw)
    held = replace(powers, battery_kw=powers.battery_kw + less)
    left_kw = excess_kw - float(less.sum())
    if left_kw <= 0.0 or powers.pv_export_kw.sum() <= 0.0:
        return held
    return curtailed(held, left_kw)
