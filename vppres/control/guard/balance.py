"""Whether the readings of a step agree with what the plant then took from the grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
class StepBefore:
    """Readings, expectation and decision of a step, to judge the readings of the next one by."""

    t: int
    #: Demand and PV power that count, in kW, (C,) and (P,), and demand as it was read.
    load_kw: Floats
    pv_kw: Floats
    read_kw: Floats
    #: What had been forecast, and the demand that stands in where a reading is doubted.
    expected_load_kw: Floats
    expected_pv_kw: Floats
    usual_kw: Floats
    #: Readings far from all that was expected, contradicted by the import, and standing still.
    far: Flags
    doubted: Flags
    frozen_load: Flags
    frozen_pv: Flags
    proven_kw: Floats  #: the most of each demand that an import has agreed with
    #: The least and the most demand that was far and has been shown to be right, (C,).
    least_kw: Floats
    most_kw: Floats
    most_import_kw: float  #: an import beyond it says nothing of the step
    served: Flags
    share: Floats  #: part of the demand of those served that they were to get, (C,)
    pv_curtailed_kw: Floats
    battery_kw: Floats

    @classmethod
    def nothing(cls, site: Site) -> StepBefore:
        """Before the first step."""
        c, pv = len(site.customers), len(site.pv)
        unknown_kw, unknown_pv_kw = np.full(c, np.nan), np.full(pv, np.nan)
        nobody = np.zeros(c, dtype=bool)
        return cls(
            t=-2,  # no step follows it
            load_kw=unknown_kw,
            pv_kw=unknown_pv_kw,
            read_kw=unknown_kw,
            expected_load_kw=unknown_kw,
            expected_pv_kw=unknown_pv_kw,
            usual_kw=unknown_kw,
            far=nobody,
            doubted=nobody,
            frozen_load=nobody,
            frozen_pv=np.zeros(pv, dtype=bool),
            proven_kw=np.zeros(c),
            least_kw=np.full(c, np.inf),
            most_kw=np.zeros(c),
            most_import_kw=np.inf,
            served=nobody,
            share=np.ones(c),
            pv_curtailed_kw=unknown_pv_kw,
            battery_kw=np.full(len(site.batteries), np.nan),
        )

    def decided(self, decision: Decision) -> StepBefore:
        """The step with what was decided for it."""
        plan, row = decision.dispatch, decision.row
        on = np.asarray(plan.served[row], dtype=bool)
        return replace(
            self,
            served=on,
            share=np.where(on, plan.supplied[row], 1.0),
            pv_curtailed_kw=plan.pv_curtailed_kw[row],
            battery_kw=plan.charge_kw[row] - plan.discharge_kw[row],
        )


def tolerance_kw(demand_kw: float) -> float:
    """Error in kW that meters may have at this demand."""
    return BALANCE_KW + BALANCE_SHARE * demand_kw


def feeder_off(seen: Observation) -> bool:
    """Whether nothing flowed in the step before: dark, or stopped by protection."""
    point = seen.operating_point
    return point is None or not np.any(point.p_injection_kw)


def mismatch_kw(site: Site, before: StepBefore, seen: Observation) -> float:
    """Import in kW of the step before beyond what its readings explain.

    ``seen`` is the observation after it. NaN where something was not measured, where nothing
    flowed, or where restored customers take more than their reading says.
    """
    cold = seen.switching.rules.cold
    if seen.import_kw is None or seen.battery_kw is None or feeder_off(seen) or cold:
        return np.nan
    demand = before.load_kw * served(before, seen)
    curtailed = curtailed_kw(site, before.pv_curtailed_kw, before.pv_kw, demand)
    taken = float(demand.sum() + seen.battery_kw.sum())
    if site.kinds:
        if seen.flexible_kw is None:
            return np.nan
        taken += seen.flexible_kw
    given = float((before.pv_kw - curtailed).sum())
    assert seen.operating_point is not None  # otherwise the feeder was off
    found = seen.import_kw - (taken - given + _losses_kw(site, seen.operating_point))
    return found if np.isfinite(found) else np.nan


def contradicts(off_kw: float, before: StepBefore, seen: Observation) -> bool:
    """Whether a mismatch is more than meters are off by."""
    served_kw = float(before.load_kw @ served(before, seen))
    return abs(off_kw) > tolerance_kw(served_kw) + seen.flexible_off_kw


def served(before: StepBefore, seen: Observation) -> Floats:
    """Part of the demand that each customer got, (C,)."""
    on = before.served if seen.served is None else seen.served
    return on * before.share


def _losses_kw(site: Site, point: OperatingPoint) -> float:
    """Losses, and what the network draws: what left the slack bus and arrived at no device."""
    leaving = point.p_flow_kw[site.network.parent == 0]
    network = site.network.islanded if point.island else site.network
    at_slack_kw = network.drawn(point.v_pu)[0][0]
    return float(leaving.sum() + point.p_injection_kw[1:].sum() + at_slack_kw)
