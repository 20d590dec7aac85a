"""The paper's formulas on arrays: injections, flows and voltage drop, one function each.

Controllers, their checks and the limits of the network use these. The same formulas stand in
:mod:`vppres.model.constraints` for cvxpy; the plant has its own on purpose, so that it can find
what is wrong here. Numbers in brackets count the paper's equations.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.scenario.network import Network

# PV systems.


def curtailed_kw(site: Site, wanted_kw: Floats, pv_kw: Floats, demand_kw: Floats) -> Floats:
    """Curtailment that is possible, nearest to what is wanted, (P,).

    The inverter passes no more than its rating, and what an owner uses cannot be curtailed.

    ``demand_kw`` is that of those who are served, (C,).
    """
    usable = np.minimum(pv_kw, site.pv.s_max_kva)
    own = np.minimum(site.behind_meter(demand_kw), usable)
    forced = pv_kw - usable
    return np.asarray(np.clip(wanted_kw, forced, forced + usable - own))


# Network.


def bus_injections(site: Site, given: Mapping[str, Floats]) -> Floats:
    """Net injections (..., N) without the grid's supply: (9) less (10), or (12) less (13).

    ``given`` is what ``pv`` (..., P), ``batteries`` (..., B), ``customers`` (..., C) and the units
    (..., n) of kinds of flexible power give, in kW or kvar: minus (1) for batteries, minus the
    demand of those served for customers, PV power with self-consumption. It is summed in the order
    given, which decides the last bit.
    """
    bus = {
        "pv": site.pv_bus,
        "batteries": site.battery_bus,
        "customers": site.customer_bus,
        **site.unit_bus,
    }
    first, *others = ((bus[devices] @ power.T).T for devices, power in given.items())
    return np.asarray(sum(others, start=first))


def lossless_flows(network: Network, injections: Floats) -> Floats:
    """Flows of all lines that balance the injections (8), (11), shape (..., L) for (..., N)."""
    return np.asarray((network.downstream @ -injections.T).T)


def voltage_drop_pu2(network: Network, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Drop of the squared voltage along the lines, ``2 (r P + x Q)`` of (21), shape (..., L).

    >>> net = Network([1], [2], [0.1], [0.2], slack_bus=1, base_kv=1.0)
    >>> voltage_drop_pu2(net, np.array([20.0]), np.array([10.0]))
    array([0.008])
    """
    active = network.r_pu2_per_kw * p_kw
    reactive = network.x_pu2_per_kvar * q_kvar
    return np.asarray(2 * (active + reactive))


def voltage_offset_pu2(network: Network, u_pu2: Floats, p_kw: Floats, q_kvar: Floats) -> Floats:
    """Residual of (21) at an AC point with squared voltages (..., N), shape (..., L).

    Here and below voltages are referred to the slack bus (``Network.u_pu2``).
    """
    rise = u_pu2[..., 1:] - u_pu2[..., network.parent]
    return np.asarray(rise + voltage_drop_pu2(network, p_kw, q_kvar))


def squared_voltages(network: Network, p_kw: Floats, q_kvar: Floats, offset_pu2: Floats) -> Floats:
    """Squared voltages of all buses from the slack bus on (21), (N,) for flows and offset (L,)."""
    rise = offset_pu2 - voltage_drop_pu2(network, p_kw, q_kvar)
    return np.asarray(network.v_slack_pu**2 + network.downstream.T @ rise)
