"""What is left of the network where flows, reactive power and voltages are left out.

Every row follows from the paper's equations, so that a problem with these is a relaxation.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.model.constraints import AddedDemand, Named
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


def total_balance(
    site: Site, v: Variables, p: Parameters, added: AddedDemand | None = None
) -> Named:
    """Sum of the active balances (8) over all buses: lossless lines cancel."""
    P_served = cp.multiply(p.P_load, v.x_served)
    load = cp.sum(P_served, axis=1) - cp.sum(v.P_self, axis=1)
    if added is not None:
        load = load + cp.sum(added.P, axis=1)
    if p.P_drawn is not None:
        load = load + cp.sum(p.P_drawn, axis=1)
    supply = v.P_grid + cp.sum(v.P_exp, axis=1)
    return {"total_power_balance": supply == load + cp.sum(v.P_batt, axis=1)}


def inverter_active(site: Site, v: Variables) -> Named:
    """What the discs (3) and (7) imply for active power alone."""
    battery_kva = site.batteries.s_max_kva[None, :]
    pv_kva = site.pv.s_max_kva[None, :]
    return {
        "battery_charge_rating": v.P_ch <= battery_kva,
        "battery_discharge_rating": v.P_dch <= battery_kva,
        "pv_active_rating": v.P_self + v.P_exp <= pv_kva,
    }


def battery_room(site: Site, v: Variables, p: Parameters) -> Named:
    """What exclusivity implies together with the SoC limits; it cuts off no feasible dispatch.

    A battery that charges must have the room, whatever a fractional mode would discharge at the
    same time; likewise for discharging.
    """
    b = site.batteries
    per_energy = site.dt_h / b.energy_kwh[None, :]
    stored = cp.multiply(per_energy, cp.multiply(p.eta_ch, v.P_ch))
    drawn = cp.multiply(per_energy, cp.multiply(p.inv_eta_dch, v.P_dch))
    return {
        "battery_room": v.SoC[:-1] + stored <= b.soc_max[None, :],
        "battery_reserve": v.SoC[:-1] - drawn >= b.soc_min[None, :],
    }


def counts_of_alike(site: Site, x: cp.Expression) -> Named:
    """How many of each weight are served in each step, as whole numbers to branch on.

    They say nothing new, but one branch on such a number says of many customers what else takes one
    for each.
    """
    weights, kind = np.unique(site.customers.weight, return_inverse=True)
    alike = kind[:, None] == np.arange(len(weights))
    shared = alike[:, alike.sum(axis=0) > 1].astype(float)
    if not shared.size:
        return {}
    counts = cp.Variable((x.shape[0], shared.shape[1]), name="counts", integer=True)
    return {"counts_of_alike": counts == x @ shared}
