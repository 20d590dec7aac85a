"""The squares of the objective's last two terms, for solvers that take none with binaries.

A square is replaced by the largest of some of its tangents, which lies below it everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Variables

Squares = Literal["exact", "tangents", "none"]

TOUCHING = (1 / 8, 1 / 3, 2 / 3, 1.0)
"""Where tangents touch the square, on either side, as shares of the largest value; a line through
zero belongs to them. They miss at most 3 % of the largest square."""


@dataclass(frozen=True, eq=False)
class Tangents:
    """Largest flow of each line in each step, (W, L), and its square: where tangents touch."""

    reach: cp.Parameter
    reach_squared: cp.Parameter

    @classmethod
    def create(cls, site: Site, W: int) -> Tangents:
        """Parameters of a window of W steps."""
        shape = (W, site.network.n_lines)
        return cls(
            cp.Parameter(shape, name="flow_reach", nonneg=True),
            cp.Parameter(shape, name="flow_reach_squared", nonneg=True),
        )

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the largest flows of a window."""
        reach = np.tile(largest_flow(site, data), (data.n_steps, 1))
        write(self.reach, reach)
        write(self.reach_squared, reach**2)

    def f4(self, site: Site, v: Variables) -> cp.Expression:
        """Proxy of the ohmic losses, from below."""
        r = site.network.r_ohm[None, :]
        under = [self._under_square(flow) for flow in (v.P_flow, v.Q_flow)]
        return cp.sum(cp.multiply(r, under[0])) + cp.sum(cp.multiply(r, under[1]))

    def f5(self, site: Site, v: Variables) -> cp.Expression:
        """Squared utilisation by reactive power, from below."""
        shares = [
            cp.multiply(1 / assets.s_max_kva[None, :], Q)
            for assets, Q in ((site.pv, v.Q_pv), (site.batteries, v.Q_batt))
            if len(assets)
        ]
        return sum((cp.sum(under_square(share)) for share in shares), cp.Constant(0.0))

    def _under_square(self, flow: cp.Expression) -> cp.Expression:
        """Squares of flows, (W, L), from below."""
        touching = [
            2.0 * sign * share * cp.multiply(self.reach, flow) - share**2 * self.reach_squared
            for share in TOUCHING
            for sign in (1.0, -1.0)
        ]
        return cp.maximum(0.0, *touching)


def under_square(y: cp.Expression) -> cp.Expression:
    """Largest tangent of the squares of values between -1 and 1.

    Examples
    --------
    >>> y = cp.Variable(3, value=np.array([0.0, 1.0, -0.5]))
    >>> under_square(y).value.round(3).tolist()
    [0.0, 1.0, 0.222]
    """
    touching = [2.0 * sign * share * y - share**2 for share in TOUCHING for sign in (1.0, -1.0)]
    return cp.maximum(0.0, *touching)


def largest_flow(site: Site, data: WindowData) -> Floats:
    """What a line can carry at most: demand and devices behind it, all the same way, (L,)."""
    devices = site.network.place(site.batteries.bus) @ site.batteries.s_max_kva
    devices = devices + site.pv_bus @ site.pv.s_max_kva
    demand = data.all_cold().load_kw.max(axis=0) * np.hypot(1.0, site.customers.q_per_p)
    return np.asarray(site.network.downstream @ (devices + site.customer_bus @ demand))
