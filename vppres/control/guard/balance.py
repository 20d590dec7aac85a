"""Whether the readings of a step agree with what the plant then took from the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.contract.operating_point import OperatingPoint
from vppres.core.arrays import Flags, Floats
from vppres.model.formulas import curtailed_kw
from vppres.model.site import Site

BALANCE_KW = 1.0
BALANCE_SHARE = 0.01
"""Error of meters: the first plus the second of the demand.

Meters of class 1 are off by at most that share each.
"""


@dataclass(frozen=True, eq=False)
class Commanded:
    """Decision for a step: customers (C,), PV systems (P,), batteries (B,)."""

    served: Flags
    pv_curtailed_kw: Floats
    battery_kw: Floats
    share: Floats | None = None

    @classmethod
    def of(cls, decision: Decision) -> Commanded:
        """The step's row of a decision."""
        plan = decision.dispatch
        row = decision.row
        return cls(
            np.asarray(plan.served[row], dtype=bool),
            plan.pv_curtailed_kw[row],
            plan.charge_kw[row] - plan.discharge_kw[row],
            None if plan.share is None else plan.share[row],
        )


@dataclass(frozen=True, eq=False)
class LoadAndPVReadings:
    """Demand (C,) and PV power (P,) of one step in kW."""

    load_kw: Floats
    pv_kw: Floats


def tolerance_kw(demand_kw: float) -> float:
    """Error in kW that meters may have at this demand."""
    return BALANCE_KW + BALANCE_SHARE * demand_kw


def feeder_off(seen: Observation) -> bool:
    """Whether nothing flowed in the step before: dark, or stopped by protection."""
    point = seen.operating_point
    return point is None or not np.any(point.p_injection_kw)


def mismatch_kw(
    site: Site, commanded: Commanded, seen: Observation, readings: LoadAndPVReadings
) -> float | None:
    """Import of the step before beyond what readings of that step explain.

    ``commanded`` was decided for that step, and ``seen`` is the observation after it.

    Returns
    -------
    float or None
        In kW; None where something was not measured, where nothing flowed, or where restored
        customers take more than their reading says.
    """
    cold = seen.switching.rules.cold
    if seen.import_kw is None or seen.battery_kw is None or feeder_off(seen) or cold:
        return None
    demand = readings.load_kw * served(commanded, seen)
    curtailed = curtailed_kw(site, commanded.pv_curtailed_kw, readings.pv_kw, demand)
    taken = float(demand.sum() + seen.battery_kw.sum())
    if site.kinds:
        if seen.flexible_kw is None:
            return None
        taken += seen.flexible_kw
    given = float((readings.pv_kw - curtailed).sum())
    assert seen.operating_point is not None  # otherwise the feeder was off
    found = seen.import_kw - (taken - given + _losses_kw(site, seen.operating_point))
    return found if np.isfinite(found) else None


def contradicts(
    off_kw: float, commanded: Commanded, seen: Observation, readings: LoadAndPVReadings
) -> bool:
    """Whether a mismatch is more than meters are off by."""
    served_kw = float(readings.load_kw @ served(commanded, seen))
    return abs(off_kw) > tolerance_kw(served_kw) + seen.flexible_off_kw


def served(commanded: Commanded, seen: Observation) -> Flags | Floats:
    """Part of the demand that each customer got, (C,)."""
    on = commanded.served if seen.served is None else seen.served
    if commanded.share is None:
        return on
    return on * np.where(commanded.served, commanded.share, 1.0)


def _losses_kw(site: Site, point: OperatingPoint) -> float:
    """Losses, and what the network draws: what left the slack bus and arrived at no device."""
    leaving = point.p_flow_kw[site.network.parent == 0]
    network = site.network.islanded if point.island else site.network
    at_slack_kw = network.drawn(point.v_pu)[0][0]
    return float(leaving.sum() + point.p_injection_kw[1:].sum() + at_slack_kw)
