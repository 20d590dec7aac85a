"""Rows that follow from the paper's: a relaxation that lacks some of those keeps these.

Every row names in its docstring what it follows from, so that a problem with it is a relaxation.
"""

from __future__ import annotations

import cvxpy as cp

from vppres.model.constraints import Named
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables


def inverter_active(site: Site, v: Variables, p: Parameters) -> Named:
    """Limits on active power that follow from the discs (3) and (7) with exclusive modes."""
    battery_kva = site.batteries.s_max_kva[None, :]
    pv_kva = site.pv.s_max_kva[None, :]
    return {
        "battery_charge_rating": v.P_ch <= battery_kva,
        "battery_discharge_rating": v.P_dch <= battery_kva,
        "pv_active_rating": v.P_self + v.P_exp <= pv_kva,
    }


def battery_rated(site: Site, v: Variables, p: Parameters) -> Named:
    """Exclusive modes within the batteries' own ratings, without those of their inverters."""
    P_max = site.batteries.p_max_kw[None, :]
    return {
        "battery_charge_rated": v.P_ch <= cp.multiply(P_max, v.delta),
        "battery_discharge_rated": v.P_dch <= cp.multiply(P_max, 1 - v.delta),
    }


def battery_room(site: Site, v: Variables, p: Parameters) -> Named:
    """Limits from exclusive modes and SoC limits together; they cut off no feasible dispatch.

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


IMPLIED = (inverter_active, battery_room, battery_rated)
