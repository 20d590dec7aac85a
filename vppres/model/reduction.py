"""A network without the buses at which nothing happens, for problems with variables for lines.

``docs/decisions/reduction.md`` proves that nothing is lost but limits of voltages at the buses left
out, and whoever uses the reduction checks these on the whole network.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags, Names, Wholes
from vppres.model.data import WindowData
from vppres.model.formulas import lossless_flows, voltage_drop_pu2
from vppres.model.site import Site
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class Reduction:
    """A site whose network has only the buses that count.

    Buses that count are the slack bus, those with a customer, PV system or battery, and those at
    which ways to several of these part. Lines in series between them become one line, dead ends go.

    Parameters
    ----------
    whole : Site
        The site.
    site : Site
        The same with the reduced network.
    merged : sparse array, shape (L reduced, L)
        1 where a line is part of a reduced line.

    Examples
    --------
    ``Reduction.of(site).site.network.n_buses``
    """

    whole: Site
    site: Site
    merged: sp.csr_array

    @classmethod
    def of(cls, site: Site) -> Reduction | None:
        """The reduction of a site; None where nothing can go.

        Ratios, charging, shunts and fixed demand make every bus count.
        """
        net = site.network
        if net.draws or net.has_ratios:
            return None
        kept = _counting(site)
        if kept.all():
            return None
        near = _nearest_above(net, kept)
        ends = np.flatnonzero(kept)[1:]
        of_line = _reduced_line(net, kept)
        used = np.flatnonzero(of_line >= 0)
        merged = sp.csr_array(
            (np.ones(len(used)), (of_line[used], used)), shape=(len(ends), net.n_lines)
        )
        network = _with_lines(net, net.buses[near[ends]], net.buses[ends], merged)
        # A tree in breadth-first order loses buses, but the others may change places.
        place = np.array([network.bus_index[bus] - 1 for bus in net.buses[ends]])
        return cls(site, replace(site, network=network), merged[np.argsort(place)])

    def data(self, data: WindowData) -> WindowData:
        """A window of the paper's mode on the reduced network."""
        delta = np.asarray(data.delta_pu2 @ self.merged.T)
        own = None if data.own_u_pu2 is None else data.own_u_pu2[:, self._buses]
        return replace(data, delta_pu2=delta, own_u_pu2=own)

    @property
    def _buses(self) -> Wholes:
        """Places of the reduced network's buses in the whole one."""
        index = self.whole.network.bus_index
        return np.array([index[bus] for bus in self.site.network.buses])

    def reduced(self, dispatch: Dispatch) -> Dispatch:
        """A dispatch with the flows and voltages that the reduced network has."""
        buses = self._buses
        return replace(
            dispatch,
            v_pu=dispatch.v_pu[:, buses],
            p_flow_kw=dispatch.p_flow_kw[:, buses[1:] - 1],
            q_flow_kvar=dispatch.q_flow_kvar[:, buses[1:] - 1],
        )

    def expanded(self, data: WindowData, dispatch: Dispatch) -> Dispatch:
        """A dispatch of the reduced network on the whole one, with all flows and voltages."""
        site = self.whole
        net = site.network
        demand = data.load_kw * dispatch.served
        given_kw = dispatch.pv_self_kw + dispatch.pv_export_kw
        net_kw = dispatch.discharge_kw - dispatch.charge_kw
        p_kw, q_kvar = (
            np.asarray(pv @ site.pv_bus.T + batt @ site.battery_bus.T - load @ site.customer_bus.T)
            for pv, batt, load in (
                (given_kw, net_kw, demand),
                (dispatch.pv_q_kvar, dispatch.batt_q_kvar, demand * site.customers.q_per_p),
            )
        )
        p_flow_kw = lossless_flows(net, p_kw)
        q_flow_kvar = lossless_flows(net, q_kvar)
        rise = data.delta_pu2 - voltage_drop_pu2(net, p_flow_kw, q_flow_kvar)
        return replace(
            dispatch,
            p_flow_kw=p_flow_kw,
            q_flow_kvar=q_flow_kvar,
            v_pu=net.v_pu(net.v_slack_pu**2 + rise @ net.downstream),
        )

    def within_limits(self, data: WindowData, dispatch: Dispatch, tolerance_pu2: float) -> bool:
        """Whether all voltages of the whole network are within their limits."""
        net = self.whole.network
        lowest, highest = data.u_limits_pu2(net)
        u = net.u_pu2(dispatch.v_pu)
        within = (u >= lowest - tolerance_pu2) & (u <= highest + tolerance_pu2)
        return bool(within[:, 1:].all())


def _counting(site: Site) -> Flags:
    """Buses that count, (N,)."""
    net = site.network
    used: Flags = np.zeros(net.n_buses, dtype=bool)
    for placed in (site.customer_bus, site.pv_bus, site.battery_bus):
        used |= placed.sum(axis=1) > 0
    behind = np.asarray(net.downstream @ used) > 0  # whether a line leads to any of them
    ways = np.bincount(net.parent[behind], minlength=net.n_buses)
    used |= ways > 1
    used[0] = True
    return used


def _nearest_above(net: Network, kept: Flags) -> Wholes:
    """The next bus that counts on the way to the slack bus, (N,); the slack bus is its own."""
    near = np.zeros(net.n_buses, dtype=int)
    for line, above in enumerate(net.parent):
        near[line + 1] = above if kept[above] else near[above]
    return near


def _reduced_line(net: Network, kept: Flags) -> Wholes:
    """The reduced line that each line is part of, (L,); -1 where it leads to nothing."""
    number = np.cumsum(kept) - 2  # the line that ends at a bus that counts
    found = np.full(net.n_lines, -1)
    for line in range(net.n_lines - 1, -1, -1):
        if kept[line + 1]:
            found[line] = number[line + 1]
        above = net.parent[line]
        if found[line] >= 0 and above > 0 and not kept[above]:
            found[above - 1] = found[line]
    return found


def _with_lines(net: Network, start: Names, end: Names, merged: sp.csr_array) -> Network:
    """A network of merged lines: impedances in series add up."""
    return Network(
        start,
        end,
        merged @ net.r_ohm,
        merged @ net.x_ohm,
        slack_bus=net.buses[0],
        base_kv=net.base_kv,
        v_slack_pu=net.v_slack_pu,
        v_min_pu=net.v_min_pu,
        v_max_pu=net.v_max_pu,
        v_min_ac_pu=net.v_min_ac_pu,
        v_max_ac_pu=net.v_max_ac_pu,
    )
