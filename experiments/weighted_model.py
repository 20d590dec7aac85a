"""The paper's objective as it is printed, all five terms in one sum, and its squares.

Most solvers take no squares together with binaries. There a square is replaced by the largest of
some of its tangents, which lies below it everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats
from vppres.model import objective as terms
from vppres.model.beyond_paper.table import Beyond
from vppres.model.data import WindowData
from vppres.model.numerics import Polygon, write
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.model.variables import Variables
from vppres.solve.forms import DISCS

Squares = Literal["exact", "tangents", "none"]

TOUCHING = (1 / 8, 1 / 3, 2 / 3, 1.0)
"""Where tangents touch the square, on either side, as shares of the largest value; a line through
zero belongs to them. They miss at most 3 % of the largest square."""


class WeightedModel:
    """A window with all five terms in one objective, as cvxpy has it.

    Parameters
    ----------
    site : Site
        Fixed data.
    n_steps : int
        Steps W of the window.
    beyond : tuple
        What it has beyond the paper.
    polygon_sides : int
        Sides of the inverters' polygons, 0 for the discs.
    squares : {"none", "tangents", "exact"}
        What stands for f4 and f5.
    """

    def __init__(
        self, site: Site, n_steps: int, beyond: Beyond, polygon_sides: int, squares: Squares
    ) -> None:
        self.site = site
        self.squares = squares
        self.tangents = Tangents.create(site, n_steps) if squares == "tangents" else None
        self.statement = Statement(site, n_steps, beyond)
        self.v = self.statement.v
        named = dict(self.statement.families)
        for name in DISCS if polygon_sides else ():
            named[name] = inside(Polygon.inscribed(polygon_sides), named[name])
        self.problem = cp.Problem(self.objective(), list(named.values()))

    def objective(self) -> cp.Maximize:
        """F as it is printed."""
        w = self.site.weights
        known = self.statement.terms
        weight = {"f1": 1.0, "f2": -w.lambda_grid, "f3": -w.lambda_curt, "f6": -1.0, "f7": 1.0}
        linear = sum((weight[name] * term for name, term in known.items()), cp.Constant(0.0))
        return cp.Maximize(linear - self._squares())

    def _squares(self) -> cp.Expression:
        """f4 and f5 as weighted, by what stands for them."""
        w = self.site.weights
        args = (self.site, self.v, self.statement.p)
        if self.squares == "none":
            return cp.Constant(0.0)
        if self.tangents is not None:
            f4 = self.tangents.f4(self.site, self.v)
            f5 = self.tangents.f5(self.site, self.v)
        else:
            f4 = terms.f4_flows(*args)
            f5 = terms.f5_reactive(*args)
        return w.lambda_l * f4 + w.lambda_q * f5

    def fill(self, data: WindowData) -> None:
        """Write the window's data."""
        self.statement.write(data)
        if self.tangents is not None:
            self.tangents.fill(self.site, data)

    def dispatch(self) -> Dispatch:
        """The last solution."""
        return self.statement.dispatch()


def inside(polygon: Polygon, disc: cp.SOC) -> cp.Constraint:
    """A polygon in the place of discs."""
    radius, (P, Q) = disc.args[0], disc.args[1]
    sides = [np.cos(a) * P + np.sin(a) * Q - polygon.reach * radius for a in polygon.angles]
    return cp.hstack(sides) <= 0


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
