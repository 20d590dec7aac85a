"""The paper's constraints (Sections 3.1 and 3.2), one function per equation family, in its order.

Numbers in brackets count the paper's equations, and names with ``eq:`` are its labels. Every
function takes the site, the variables and the parameters of a window and returns named cvxpy
constraints. All lines of a family are one vectorised constraint: rows are steps, columns are items.

What a window has beyond the paper enters by parameters that the paper leaves at None: demand that
is added to the balances, ratings and limits that change with the steps.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

# Constraints by the names of their equations.
Named = dict[str, cp.Constraint]


# Battery storage.


def battery_modes(site: Site, v: Variables, p: Parameters) -> Named:
    """Charge or discharge, never both: P_ch <= P_max delta, P_dch <= P_max (1 - delta).

    ``P_max`` is what rating and inverter allow.
    """
    P_max = site.batteries.active_max_kw[None, :]
    return {
        "battery_charge_mode": v.P_ch <= cp.multiply(P_max, v.delta),
        "battery_discharge_mode": v.P_dch <= cp.multiply(P_max, 1 - v.delta),
    }


def battery_soc(site: Site, v: Variables, p: Parameters) -> Named:
    """SoC recursion with losses (2), from the measured SoC on."""
    per_energy = site.dt_h / site.batteries.energy_kwh[None, :]
    gain = cp.multiply(p.eta_ch, v.P_ch) - cp.multiply(p.inv_eta_dch, v.P_dch)
    return {
        "battery_soc_start": v.SoC[0] == p.SoC_0,
        "battery_soc_dynamics": v.SoC[1:] == v.SoC[:-1] + cp.multiply(per_energy, gain),
    }


def battery_soc_limits(site: Site, v: Variables, p: Parameters) -> Named:
    """SoC between its limits at the end of every step; what was measured may lie outside."""
    b = site.batteries
    lowest = b.soc_min[None, :] if p.SoC_min is None else p.SoC_min
    return {
        "battery_soc_min": v.SoC[1:] >= lowest,
        "battery_soc_max": v.SoC[1:] <= b.soc_max[None, :],
    }


def battery_inverter(site: Site, v: Variables, p: Parameters) -> Named:
    """Apparent power of batteries within their inverters' ratings (3), ``eq:batt_inverter``."""
    rating = _each_step(site.batteries.s_max_kva, v.P_batt) if p.S_max is None else p.S_max
    return {"battery_inverter_capacity": disc(v.P_batt, v.Q_batt, rating)}


def circular_charging(site: Site, v: Variables, p: Parameters) -> Named:
    """Charging comes from import and PV export, never from another battery (4)."""
    charging = cp.sum(v.P_ch, axis=1)
    available = v.P_grid + cp.sum(v.P_exp, axis=1)
    if p.P_fed_added is not None:
        available = available + p.P_fed_added
    return {"circular_charging": charging <= available}


# PV systems.


def pv_balance(site: Site, v: Variables, p: Parameters) -> Named:
    """PV power is used by the owner, exported or curtailed (5)."""
    return {"pv_balance": v.P_self + v.P_exp + v.P_curt == p.P_pv}


def pv_self_consumption(site: Site, v: Variables, p: Parameters) -> Named:
    """Self-consumption follows the owner's service (6), ``eq:min_pv``.

    ``P_self_max`` holds the equation's min(P_load, P_pv).
    """
    P_self = cp.multiply(p.P_self_max, v.x_served[:, site.owner])
    if p.P_self_added is not None:
        P_self = P_self + p.P_self_added
    return {"pv_self_consumption": v.P_self == P_self}


def pv_inverter(site: Site, v: Variables, p: Parameters) -> Named:
    """Apparent power of PV systems within their inverters' ratings (7), ``eq:pv_inverter``."""
    P = v.P_self + v.P_exp
    return {"pv_inverter_capacity": disc(P, v.Q_pv, _each_step(site.pv.s_max_kva, P))}


# Power balance.


def active_balance(site: Site, v: Variables, p: Parameters) -> Named:
    """Active balance at every bus (8), with its injection (9) and its load (10).

    The grid supplies the slack bus, which the paper leaves unsaid.
    """
    P_inj, P_load = injected_and_drawn(site, v, p)
    P_grid = at_slack_bus(site, v.P_grid)
    inflow = v.P_flow @ site.network.incidence.T
    return {"active_power_balance": P_inj + P_grid + inflow == P_load}


def injected_and_drawn(
    site: Site, v: Variables, p: Parameters
) -> tuple[cp.Expression, cp.Expression]:
    """Injection (9) and load (10) of every bus, (W, N) each."""
    P_inj = at_buses(site.pv_bus, v.P_exp) - v.P_batt @ site.battery_bus.T
    P_served = cp.multiply(p.P_load, v.x_served)
    P_load = at_buses(site.customer_bus, P_served) - at_buses(site.pv_bus, v.P_self)
    if p.P_added is not None:
        P_load = P_load + p.P_added
    return P_inj, P_load


def reactive_balance(site: Site, v: Variables, p: Parameters) -> Named:
    """Reactive balance at every bus (11), with its injection (12) and its load (13), (14)."""
    Q_inj = v.Q_pv @ site.pv_bus.T + v.Q_batt @ site.battery_bus.T
    Q_served = cp.multiply(p.Q_load, v.x_served)
    Q_load = at_buses(site.customer_bus, Q_served)
    if p.Q_added is not None:
        Q_load = Q_load + p.Q_added
    Q_grid = at_slack_bus(site, v.Q_grid)
    inflow = v.Q_flow @ site.network.incidence.T
    return {"reactive_power_balance": Q_inj + Q_grid + inflow == Q_load}


# Grid connection and voltages.


def grid_connection(site: Site, v: Variables, p: Parameters) -> Named:
    """No exchange in an outage (15); import only, reactive exchange free while connected."""
    return {
        "grid_active_limit": v.P_grid <= p.P_grid_max,
        "grid_reactive_max": v.Q_grid <= p.Q_grid_max,
        "grid_reactive_min": v.Q_grid >= -p.Q_grid_max,
    }


def voltage_limits(site: Site, v: Variables, p: Parameters) -> Named:
    """Squared voltage between the squared limits, at every bus but the slack bus.

    Voltages referred to the slack bus have limits of their own behind a transformer's ratio.
    """
    u_min = p.u_min
    u_max = p.u_max
    return {"voltage_min": v.u[:, 1:] >= u_min, "voltage_max": v.u[:, 1:] <= u_max}


# Power flow approximation.


def voltage_slack(site: Site, v: Variables, p: Parameters) -> Named:
    """The grid holds the slack bus at its voltage, 1.0 pu in the paper."""
    return {"voltage_slack": v.u[:, 0] == site.network.v_slack_pu**2}


def delta_lindistflow(site: Site, v: Variables, p: Parameters) -> Named:
    """Voltage drop along every line, (21) ``eq:dist_flow_diff`` around the AC point (22) to (24).

    The deltas (18) to (20) telescope over the window, so the last AC point enters as one offset per
    line: ``u_j = u_i - 2 (r P + x Q) + delta`` with
    ``delta = u_j_ac - u_i_ac + 2 (r P_ac + x Q_ac)``.
    """
    net = site.network
    r = net.r_pu2_per_kw[None, :]
    x = net.x_pu2_per_kvar[None, :]
    drop = 2 * (cp.multiply(r, v.P_flow) + cp.multiply(x, v.Q_flow))
    u_j = v.u[:, 1:]
    u_i = v.u[:, net.parent]
    return {"delta_lindistflow": u_j == u_i - drop + p.delta}


def at_buses(bus: sp.csr_array, power: cp.Expression) -> cp.Expression:
    """The power of each step and item, (W, items), on the buses that ``bus`` places it, (W, N).

    Both ways compile to the same rows. cvxpy is slow where a product begins with parameters.
    """
    return (bus @ power.T).T if power.is_constant() else power @ bus.T


def at_slack_bus(site: Site, power: cp.Expression) -> cp.Expression:
    """The grid's power of each step, (W,), at the first bus and nowhere else, (W, N)."""
    slack = sp.csr_array(([1.0], ([0], [0])), shape=(site.network.n_buses, 1))
    return cp.reshape(power, (power.size, 1), order="C") @ slack.T


def _each_step(rating: Floats, power: cp.Expression) -> cp.Expression:
    """Ratings repeated in every step, (W, items)."""
    return cp.Constant(np.broadcast_to(rating, power.shape))


def disc(P: cp.Expression, Q: cp.Expression, S: cp.Expression) -> cp.Constraint:
    """Second-order cones ``norm(P, Q) <= S``, one for each step and item."""
    both = cp.vstack([cp.vec(P, order="F"), cp.vec(Q, order="F")])
    return cp.SOC(cp.vec(S, order="F"), both, axis=0)


FAMILIES = (
    battery_modes,
    battery_soc,
    battery_soc_limits,
    battery_inverter,
    circular_charging,
    pv_balance,
    pv_self_consumption,
    pv_inverter,
    active_balance,
    reactive_balance,
    grid_connection,
    voltage_limits,
    voltage_slack,
    delta_lindistflow,
)
"""The paper's families, in the paper's order."""


def made_by(site: Site, v: Variables, p: Parameters) -> dict[str, tuple[str, cp.Constraint]]:
    """All families of the paper by their names, each with the function that states it."""
    found: dict[str, tuple[str, cp.Constraint]] = {}
    for function in FAMILIES:
        found |= {family: (function.__name__, c) for family, c in function(site, v, p).items()}
    return found
