"""Voltages and flows of a balanced network by what is injected at its buses, and their limits.

Lossless flows are sums of injections, so squared voltages are linear in them: the paper's lines
and buses with nothing left of them but their limits.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.formulas import lossless_flows, voltage_drop_pu2
from vppres.model.site import Site
from vppres.solve.network.rows import PER_PU2, ColumnPowers, Rows
from vppres.solve.programs import SOLVED
from vppres.solve.sizes import is_wide


class Reactance:
    """How the squared voltages of a site depend on what is injected at its buses.

    They are tables of all injections. In a wide network they follow from the flows, and rows of
    the tables are made where they are asked for.
    """

    def __init__(self, site: Site) -> None:
        net = site.network
        self.network = net
        self.tables: tuple[Floats, Floats, Floats] | None = None
        if not is_wide(site):
            fed = net.downstream.toarray()
            per_kw = 2.0 * (fed.T * net.r_pu2_per_kw) @ fed
            per_kvar = 2.0 * (fed.T * net.x_pu2_per_kvar) @ fed
            self.tables = per_kw, per_kvar, fed
        self.customer = _buses_of(site.customer_bus)
        self.battery = _buses_of(site.battery_bus)
        self.pv = _buses_of(site.pv_bus)

    def rows(self, bus: Wholes, held: Wholes) -> tuple[Floats, Floats]:
        """Squared voltages of buses per kW and kvar injected at every bus, (R, N) each.

        As they are where other buses, (R,), hold the voltage; bus 0 is the grid's.
        """
        if self.tables is not None:
            per_kw, per_kvar, _ = self.tables
            return per_kw[bus] - per_kw[held], per_kvar[bus] - per_kvar[held]
        net = self.network
        path = (self._paths[:, bus] - self._paths[:, held]).toarray().T
        r, x = (2.0 * path * each for each in (net.r_pu2_per_kw, net.x_pu2_per_kvar))
        return np.asarray(r @ self._paths), np.asarray(x @ self._paths)

    @cached_property
    def _paths(self) -> sp.csc_array:
        """Lines on the way to each bus, (L, N)."""
        return sp.csc_array(self.network.downstream)

    def raised(self, u_pu2: Floats | float, p_kw: Floats, q_kvar: Floats) -> Floats:
        """Squared voltages with what injections (W, N) add to them, (W, N)."""
        if self.tables is not None:
            per_kw, per_kvar, _ = self.tables
            return np.asarray(u_pu2 + p_kw @ per_kw + q_kvar @ per_kvar)
        net = self.network
        flows = lossless_flows(net, p_kw), lossless_flows(net, q_kvar)
        return np.asarray(u_pu2 - self.along(voltage_drop_pu2(net, *flows)))

    def along(self, rise_pu2: Floats) -> Floats:
        """Sum of what lines (W, L) add on the way to each bus, (W, N)."""
        fed = self._paths if self.tables is None else self.tables[2]
        return np.asarray(rise_pu2 @ fed)


class Buses:
    """Limits of a window's voltages and flows, and what both are in a solution.

    ``injected`` is what is injected at the buses, less what the network takes.
    """

    near = ()

    def __init__(self, reactance: Reactance, data: WindowData, injected: ColumnPowers) -> None:
        self.network = reactance.network
        self.data = data
        self.reactance = reactance
        self.injected = injected
        self.held: Wholes = np.zeros(data.n_steps, dtype=np.int64)
        if data.physics:
            self.held = data.physics.reference

    def flows(self, x: Floats) -> tuple[Floats, Floats]:
        """Active and reactive flows of a solution, (W, L) each."""
        p, q = (lossless_flows(self.network, each) for each in self.injected.at(x))
        return p, q

    def u_pu2(self, x: Floats) -> Floats:
        """Squared referred voltages of a solution, (W, N)."""
        return self._referred(self.reactance.raised(self._empty_u, *self.injected.at(x)))

    def _referred(self, u: Floats) -> Floats:
        """Squared voltages (W, N) as they are where another bus than the grid's holds them."""
        if not self.data.physics:
            return u
        net = self.network
        held_pu2 = net.u_pu2(net.held_pu)[self.held]
        return np.asarray(u + (held_pu2 - u[np.arange(len(u)), self.held])[:, None])

    @cached_property
    def _empty_u(self) -> Floats:
        """Squared voltages without any injection, (W, N)."""
        rise = self.reactance.along(self.data.delta_pu2)
        return np.asarray(self.network.v_slack_pu**2 + rise)

    def exceeded(self, x: Floats, over: float) -> list[Rows]:
        """Rows of voltages that exceed their limits by more than so many pu², and of flows."""
        return [*self._voltages(x, over), *self._flows(x)]

    def _voltages(self, x: Floats, over: float) -> list[Rows]:
        """Rows of the violated voltage limits: where no neighbour is further out."""
        net = self.network
        u = self.u_pu2(x)
        empty = self._referred(self._empty_u)
        found = []
        for sign, limit in zip((1.0, -1.0), self.data.u_limits_pu2(net), strict=True):
            beyond = sign * (limit - u)
            beyond[self.held == 0, 0] = -np.inf
            around = np.full_like(beyond, -np.inf)
            around[:, 1:] = beyond[:, net.parent]
            np.maximum.at(around.T, net.parent, beyond[:, 1:].T)
            t, bus = np.nonzero((beyond > over) & (beyond >= around))
            if not len(t):
                continue
            rows, kw, kvar = self.injected.sums(t, *self.reactance.rows(bus, self.held[t]))
            scale = PER_PU2 * sign
            least = scale * ((limit - empty)[t, bus] - (kw + kvar))
            found.append(Rows(scale * rows, least, np.full(len(t), np.inf)))
        return found

    def _flows(self, x: Floats) -> list[Rows]:
        """Tangents of the lines' flows that exceed their limits, as shares of these."""
        most = self.data.flow_max_kva
        if not len(most):
            return []
        p, q = self.flows(x)
        size = np.hypot(p, q)
        t, line = np.nonzero(size > most * (1.0 + SOLVED))
        if not len(t):
            return []
        fed = -self.network.downstream[line].toarray()
        share = most[t, line] * size[t, line]
        cos, sin = (each[t, line] / share for each in (p, q))
        rows, kw, kvar = self.injected.sums(t, cos[:, None] * fed, sin[:, None] * fed)
        return [Rows(rows, np.full(len(t), -np.inf), 1.0 - (kw + kvar))]


def _buses_of(places: sp.csr_array) -> Wholes:
    """Bus of each device, (k,), by a matrix (N, k) of ones."""
    return np.asarray(sp.csc_array(places).indices, dtype=np.int64)
