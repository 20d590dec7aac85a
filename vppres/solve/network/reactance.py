"""How the squared voltages of a site depend on injections: lossless flows are sums of them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats, Wholes
from vppres.model.formulas import lossless_flows, voltage_drop_pu2
from vppres.model.site import Site
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


def _buses_of(places: sp.csr_array) -> Wholes:
    """Bus of each device, (k,), by a matrix (N, k) of ones."""
    return np.asarray(sp.csc_array(places).indices, dtype=np.int64)
