"""The state that a feeder has without control, to which soft voltage limits give way.

All customers are supplied, batteries are idle, and PV power is exported as far as the connection
takes it and the highest voltage allows. A limit is never tighter than the voltages of that state,
so with grid no customer is switched off for a voltage that the feeder has by itself. Where its
demand is beyond what its lines carry, the feeder has no such state, and the AC limits stand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.losses import ACPoints, Sweeps
from vppres.model.beyond_paper.physical import taken_by_network
from vppres.model.data import PhasedWindow, WindowData
from vppres.model.formulas import bus_injections, lossless_flows, voltage_drop_pu2
from vppres.model.parts import at_items
from vppres.model.site import Site

GIVEN = (0.25, 0.0625, 0.0)
"""Shares by which voltages by phase give way, of what the feeder without control has beyond AC
limits: each is a dispatch more that is asked for where the one before it allows one."""


COLLAPSED_PU2 = 0.25
"""Squared voltage at the nose of a power flow, of that of the source, at the least: below it there
is no state of the feeder to which limits could give way, whatever a linear model says."""

KEPT_PU = 1e-4
"""Margin to the AC limits in a plan by phase: passes that agree may be off by as much."""


def giving_way(site: Site, data: WindowData) -> list[WindowData]:
    """A window with limits of its voltages that give way more and more, where limits are soft.

    First those of plans; then, where the feeder without control is beyond them, those of the AC
    voltages; then the voltages without control themselves. They are those of the window's own
    linearisation, so that this state is one of the last window's dispatches. In an island nothing
    gives way, and where the feeder without control has no power flow the AC limits stand.
    """
    if data.phased:
        return _phases_giving_way(site, data, data.phased)
    connected = data.with_grid
    if not site.soft_voltages or not connected.any():
        return [data]
    net = site.network
    own, pv_kw = _own_state(site, data)
    least, most = (net.u_pu2(np.full(net.n_buses, v)) for v in (net.v_min_ac_pu, net.v_max_ac_pu))
    if (connected & (own < least))[:, 1:].any():
        found = _ac_points(site, data, pv_kw).converged[:, None]
        own = np.where(found, own, np.clip(own, least, most))
    own = np.where(connected, own, np.nan)
    within_ac = np.clip(own, least, most)
    beyond = (own < net.u_min_pu2) | (own > net.u_max_pu2)
    beyond_ac = connected & (own != within_ac)
    states = [np.empty((0, net.n_buses))]
    if beyond[:, 1:].any():
        states.append(within_ac)
    if beyond_ac[:, 1:].any():
        states.append(own)
    return [replace(data, own_u_pu2=state) for state in states]


def _phases_giving_way(site: Site, data: WindowData, phased: PhasedWindow) -> list[WindowData]:
    """Windows whose voltage limits by phase give way one after another.

    Beyond the AC voltages they give way by a share of what is beyond first: a regulator that keeps
    its tap may leave next to nothing within, and all of it is seldom needed.
    """
    net = site.feeder
    found = [data]
    ac = net.v_min_ac_pu + KEPT_PU, net.v_max_ac_pu - KEPT_PU
    plans = net.v_min_pu, net.v_max_pu
    for (low, high), share in (*((ac, share) for share in GIVEN), (plans, 0.0)):
        last = found[0].phased
        u_min = np.maximum(last.u_min, _given(low**2, np.minimum(phased.u_min, low**2), share))
        u_max = np.minimum(last.u_max, _given(high**2, np.maximum(phased.u_max, high**2), share))
        if (u_min > last.u_min).any() or (u_max < last.u_max).any():
            tighter = replace(phased, u_min=u_min, u_max=u_max)
            found.insert(0, replace(data, phased=tighter))
    return found


def _given(limit: float, own: Floats, share: float) -> Floats | float:
    """A limit that gives way by a share of what the feeder without control is beyond it."""
    return limit + share * (own - limit) if share > 0.0 else limit


def with_own_state(site: Site, data: WindowData) -> WindowData:
    """A window whose limits give way as far as they may."""
    return giving_way(site, data)[-1]


def voltages_without_control(site: Site, data: WindowData) -> Floats:
    """Voltages to which the limits of the first step give way, in a linear model and by AC, (2, N).

    None, (0, N), where the limits stand.
    """
    net = site.network
    if not len(data.own_u_pu2):
        return data.own_u_pu2
    linear = net.v_pu(data.own_u_pu2[0])
    points = _ac_points(site, data, _own_state(site, data)[1])
    return np.stack([linear, np.where(points.converged[0], points.v_pu[0], linear)])


def u_without_sun_pu2(site: Site, data: WindowData) -> Floats:
    """Squared referred voltages with all customers and PV power behind the meters, (W, N)."""
    return _from_grid(site, data)[0]


def _from_grid(site: Site, data: WindowData) -> tuple[Floats, Floats, Floats, Floats]:
    """Voltages without exports, (W, N), import then in kW, (W,), PV power used and left, (W, P)."""
    net = site.network
    own_kw, spare_kw = sun_used_and_left(site, data)
    p_kw, q_kvar = _injected(site, data, own_kw)
    flows = lossless_flows(net, p_kw), lossless_flows(net, q_kvar)
    rise = data.delta_pu2 - voltage_drop_pu2(net, *flows)
    u = net.v_slack_pu**2 + rise @ net.downstream
    return np.asarray(u), -p_kw.sum(axis=1), own_kw, spare_kw


def _injected(site: Site, data: WindowData, pv_kw: Floats) -> tuple[Floats, Floats]:
    """Injections at the buses with all customers and so much PV power, in kW and kvar, (W, N)."""
    load_kw = data.all_cold().load_kw
    taken = taken_by_network(site, data)
    p_kw = bus_injections(site, {"pv": pv_kw, "customers": -load_kw}) - taken.kw
    q_kvar = bus_injections(site, {"customers": -load_kw * site.customers.q_per_p}) - taken.kvar
    # What is behind a line that is out has its own balance.
    p_kw, q_kvar = (np.where(data.parts.beyond, 0.0, each) for each in (p_kw, q_kvar))
    return p_kw, q_kvar


def flows_without_control(site: Site, data: WindowData) -> tuple[Floats, Floats]:
    """Flows of all lines without control, in kW and kvar, (W, L)."""
    p_kw, q_kvar = _injected(site, data, _own_state(site, data)[1])
    return lossless_flows(site.network, p_kw), lossless_flows(site.network, q_kvar)


def _own_state(site: Site, data: WindowData) -> tuple[Floats, Floats]:
    """Squared referred voltages without control, (W, N), and PV power then, (W, P)."""
    net = site.network
    u, imported_kw, own_kw, spare_kw = _from_grid(site, data)
    spare_kw = np.where(at_items(data.parts.beyond, site.pv_bus), 0.0, spare_kw)
    exported = bus_injections(site, {"pv": spare_kw})
    flows = lossless_flows(net, exported)
    raised = -voltage_drop_pu2(net, flows, np.zeros_like(flows)) @ net.downstream
    share = share_exported(site, data, imported_kw, spare_kw, raised, net.u_max_pu2 - u)
    return np.asarray(u + share * raised), own_kw + share * spare_kw


def sun_used_and_left(site: Site, data: WindowData) -> tuple[Floats, Floats]:
    """PV power behind the meters if all customers are supplied, and the rest, (W, P) each."""
    usable_kw = np.minimum(data.pv_kw, site.pv.s_max_kva)
    own_kw = np.minimum(site.behind_meter(data.all_cold().load_kw), usable_kw)
    return own_kw, usable_kw - own_kw


def share_exported(
    site: Site,
    data: WindowData,
    imported_kw: Floats,
    spare_kw: Floats,
    raised_pu2: Floats,
    room_pu2: Floats,
) -> Floats:
    """Share of the rest of PV power that is exported without control, (W, 1).

    What the connection takes, with an import (W,) that it replaces, and what the squared voltages
    that it raises, (W, .), have room for.
    """
    taken = _share_of(data.export_max_kw(site) + imported_kw, spare_kw.sum(axis=1))
    allowed = _share_of(room_pu2, raised_pu2).min(axis=1)
    return np.asarray(np.minimum(taken, allowed)[:, None])


def _ac_points(site: Site, data: WindowData, pv_kw: Floats) -> ACPoints:
    """Power flows of the feeder without control, with its PV power, (W, P)."""
    load_kw = data.all_cold().load_kw
    p_kw = bus_injections(site, {"pv": pv_kw, "customers": -load_kw})
    q_kvar = bus_injections(site, {"customers": -load_kw * site.customers.q_per_p})
    return Sweeps(site.network).solve(p_kw * data.with_grid, q_kvar * data.with_grid)


def _share_of(room: Floats, wanted: Floats) -> Floats:
    """How much of what is wanted there is room for, 0 to 1."""
    share = np.divide(room, wanted, out=np.ones_like(wanted), where=wanted > 0.0)
    return np.clip(share, 0.0, 1.0)
