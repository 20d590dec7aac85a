"""The paper's constraints (Sections 3.1 and 3.2), one function per equation family.

Every function takes the site, the variables and the parameters of a window and returns named cvxpy
constraints. All lines of a family are one vectorised constraint: rows are steps, columns are items.
"""

from __future__ import annotations

from collections.abc import Callable

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

Named = dict[str, cp.Constraint]
Family = Callable[[Site, Variables, Parameters], Named]


def battery_modes(site: Site, v: Variables, p: Parameters) -> Named:
    """Charge or discharge, never both: P_ch <= P_max delta, P_dch <= P_max (1 - delta)."""
    P_max = site.batteries.p_max_kw[None, :]
    return {
        "battery_charge_mode": v.P_ch <= cp.multiply(P_max, v.delta),
        "battery_discharge_mode": v.P_dch <= cp.multiply(P_max, 1 - v.delta),
    }


def battery_soc(site: Site, v: Variables, p: Parameters) -> Named:
    """SoC recursion with losses, its start, and its limits."""
    b = site.batteries
    per_energy = site.dt_h / b.energy_kwh[None, :]
    gain = cp.multiply(p.eta_ch, v.P_ch) - cp.multiply(p.inv_eta_dch, v.P_dch)
    return {
        "battery_soc_start": v.SoC[0] == p.SoC_0,
        "battery_soc_dynamics": v.SoC[1:] == v.SoC[:-1] + cp.multiply(per_energy, gain),
        "battery_soc_min": v.SoC[1:] >= b.soc_min[None, :],
        "battery_soc_max": v.SoC[1:] <= b.soc_max[None, :],
    }


def circular_charging(site: Site, v: Variables, p: Parameters) -> Named:
    """Charging comes from import and PV export, never from another battery."""
    return {"circular_charging":
            cp.sum(v.P_ch, axis=1) <= v.P_grid + cp.sum(v.P_exp, axis=1)}


def pv_split(site: Site, v: Variables, p: Parameters) -> Named:
    """Self-consumption, export and curtailment; self-consumption follows the owner's service."""
    P_self = cp.multiply(p.P_self_max, v.x_served[:, site.owner])
    if v.cold is not None:
        P_self = P_self + cp.multiply(v.cold.P_self_cold, v.cold.z[:, site.owner])
    return {
        "pv_balance": v.P_self + v.P_exp + v.P_curt == p.P_pv,
        "pv_self_consumption": v.P_self == P_self,
    }


def power_balance(site: Site, v: Variables, p: Parameters) -> Named:
    """Active and reactive balance at every bus, the slack bus with the grid's supply."""
    A = site.network.incidence
    at_bus = site.customer_bus
    slack = sp.csr_array(([1.0], ([0], [0])), shape=(site.network.n_buses, 1))
    P_inj = v.P_exp @ site.pv_bus.T - v.P_batt @ site.battery_bus.T
    P_demand, Q_demand = _demand(v, p)
    P_load = P_demand @ at_bus.T - v.P_self @ site.pv_bus.T
    Q_inj = v.Q_pv @ site.pv_bus.T + v.Q_batt @ site.battery_bus.T
    Q_load = Q_demand @ at_bus.T
    P_grid = cp.reshape(v.P_grid, (v.P_grid.size, 1), order="C") @ slack.T
    Q_grid = cp.reshape(v.Q_grid, (v.Q_grid.size, 1), order="C") @ slack.T
    return {
        "active_power_balance": P_inj + P_grid + v.P_flow @ A.T == P_load,
        "reactive_power_balance": Q_inj + Q_grid + v.Q_flow @ A.T == Q_load,
    }


def grid_connection(site: Site, v: Variables, p: Parameters) -> Named:
    """Import only, none in an outage; reactive exchange is free while connected."""
    return {
        "grid_active_limit": v.P_grid <= p.P_grid_max,
        "grid_reactive_max": v.Q_grid <= p.Q_grid_max,
        "grid_reactive_min": v.Q_grid >= -p.Q_grid_max,
    }


def delta_lindistflow(site: Site, v: Variables, p: Parameters) -> Named:
    """Voltage drop along every line, in the delta form around the last AC point.

    The deltas telescope over the window, so the last AC point enters as one offset per line:
    ``u_j = u_i - 2 (r P + x Q) + delta`` with ``delta = u_j_ac - u_i_ac + 2 (r P_ac + x Q_ac)``.
    """
    net = site.network
    r = net.r_pu2_per_kw[None, :]
    x = net.x_pu2_per_kvar[None, :]
    drop = 2 * (cp.multiply(r, v.P_flow) + cp.multiply(x, v.Q_flow))
    return {
        "voltage_slack": v.u[:, 0] == net.v_slack_pu**2,
        "delta_lindistflow": v.u[:, 1:] == v.u[:, net.parent] - drop + p.delta,
    }


def voltage_limits(site: Site, v: Variables, p: Parameters) -> Named:
    """Squared voltage between the squared limits, at every bus but the slack bus."""
    net = site.network
    return squared_voltage_within(v, net.v_min_pu**2, net.v_max_pu**2)


def squared_voltage_within(v: Variables, u_min: float | cp.Expression,
                           u_max: float | cp.Expression) -> Named:
    """Squared voltage at every bus but the slack bus between bounds (pu²), fixed or variables."""
    return {"voltage_min": v.u[:, 1:] >= u_min, "voltage_max": v.u[:, 1:] <= u_max}


def inverter_discs(site: Site, v: Variables, p: Parameters) -> Named:
    """Apparent power of batteries and PV systems within their inverters' ratings (cones)."""
    return battery_disc(site, v, p) | pv_disc(site, v, p)


def battery_disc(site: Site, v: Variables, p: Parameters) -> Named:
    """Battery inverters alone."""
    return {"battery_inverter_capacity":
            _disc(v.P_batt, v.Q_batt, site.batteries.s_max_kva)}


def pv_disc(site: Site, v: Variables, p: Parameters) -> Named:
    """PV inverters alone."""
    return {"pv_inverter_capacity": _disc(v.P_self + v.P_exp, v.Q_pv, site.pv.s_max_kva)}


def inverter_polygons(sides: int, outer: bool = False) -> Family:
    """The same discs as polygons, for solvers without mixed-integer cones.

    The inscribed polygon with K sides and a vertex on the P axis lies inside the disc and loses at
    most ``1 - cos(pi / K)`` of the rating: 1.9 % at 16 sides, 0.5 % at 32. The outer polygon, for
    bounds, is made of tangents, two of them across the P axis, so that it is exact in P alone.
    """

    def family(site: Site, v: Variables, p: Parameters) -> Named:
        pairs = {
            "battery_inverter_capacity":
                (v.P_batt, v.Q_batt, site.batteries.s_max_kva),
            "pv_inverter_capacity": (v.P_self + v.P_exp, v.Q_pv, site.pv.s_max_kva),
        }
        turn, reach = (0.0, 1.0) if outer else (np.pi / sides, np.cos(np.pi / sides))
        angle = turn + 2 * np.pi * np.arange(sides) / sides
        return {name: _polygon(P, Q, S * reach, angle) for name, (P, Q, S) in pairs.items()}

    return family


def battery_half_polygon(sides: int) -> Family:
    """The inscribed polygon of batteries whose modes exclude each other, in ``|P|`` and Q.

    ``|P|`` is then charging plus discharging, so half of the sides say what all of them do.
    """

    def family(site: Site, v: Variables, p: Parameters) -> Named:
        angle = np.pi / sides + 2 * np.pi * np.arange(sides) / sides
        inside = site.batteries.s_max_kva * np.cos(np.pi / sides)
        return {"battery_inverter_capacity":
                _polygon(v.P_ch + v.P_dch, v.Q_batt, inside, angle[np.cos(angle) > 1e-9])}

    return family


def inverter_active(site: Site, v: Variables, p: Parameters) -> Named:
    """What the discs imply for active power alone; for relaxations without reactive power."""
    return {
        "battery_charge_rating": v.P_ch <= site.batteries.s_max_kva[None, :],
        "battery_discharge_rating": v.P_dch <= site.batteries.s_max_kva[None, :],
        "pv_active_rating": v.P_self + v.P_exp <= site.pv.s_max_kva[None, :],
    }


def total_balance(site: Site, v: Variables, p: Parameters) -> Named:
    """Sum of the active balances over all buses: lossless lines cancel."""
    load = cp.sum(_demand(v, p)[0], axis=1) - cp.sum(v.P_self, axis=1)
    return {"total_power_balance": v.P_grid + cp.sum(v.P_exp, axis=1)
            == load + cp.sum(v.P_batt, axis=1)}


def battery_headroom(site: Site, v: Variables, p: Parameters) -> Named:
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


def _demand(v: Variables, p: Parameters) -> tuple[cp.Expression, cp.Expression]:
    """Active and reactive demand of those served, higher after a restoration, (W, C) each."""
    P = cp.multiply(p.P_load, v.x_served)
    Q = cp.multiply(p.Q_load, v.x_served)
    if v.cold is None:
        return P, Q
    return (P + cp.multiply(v.cold.P_cold, v.cold.z), Q + cp.multiply(v.cold.Q_cold, v.cold.z))


def _disc(P: cp.Expression, Q: cp.Expression, s_max_kva: np.ndarray) -> cp.Constraint:
    """Second-order cones ``norm(P, Q) <= S``, one for each step and item."""
    S = np.broadcast_to(s_max_kva, P.shape).ravel(order="F")
    both = cp.vstack([cp.vec(P, order="F"), cp.vec(Q, order="F")])
    return cp.SOC(cp.Constant(S), both, axis=0)


def _polygon(P: cp.Expression, Q: cp.Expression, distance_kva: np.ndarray,
             angle: np.ndarray) -> cp.Constraint:
    """Half planes at a distance from the origin, one block of rows for each angle."""
    rhs = np.broadcast_to(distance_kva, P.shape)
    return (cp.vstack([np.cos(a) * P + np.sin(a) * Q for a in angle])
            <= np.vstack([rhs] * len(angle)))


NETWORK_FAMILIES: tuple[Family, ...] = (power_balance, delta_lindistflow, voltage_limits)
LUMPED_NETWORK_FAMILIES: tuple[Family, ...] = (total_balance, inverter_active, battery_headroom)
DEVICE_FAMILIES: tuple[Family, ...] = (battery_modes, battery_soc, circular_charging, pv_split,
                                       grid_connection)
