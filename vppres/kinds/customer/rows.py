"""How long customers may be off at a time, as rows that may be broken at a price.

Of any K + 1 steps in a row a customer that may be off for K of them is served in one, or the last
of them counts as beyond the limit. That is as many steps as the customer is off beyond it, and no
service is infeasible for it. Without limits that say something no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

Limits = tuple[tuple[int, int], ...]
"""Customers with a limit, each with the steps that it may be off."""


@dataclass(frozen=True, eq=False)
class LongestTimeOff(Addition):
    """Variable and parameters of the longest times off.

    Parameters
    ----------
    limits : tuple of (int, int)
        Customers with a limit, each with its steps.
    beyond : cvxpy.Variable, shape (W, n)
        Whether a step is beyond the limit.
    asked : cvxpy.Parameter, shape (W, n)
        1 if a step may be beyond it.
    price : cvxpy.Parameter, shape (n,)
        Price of a step beyond it, in weighted customer hours.
    """

    rules: ClassVar[bool] = True

    limits: Limits
    beyond: cp.Variable
    asked: cp.Parameter
    price: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Customers with a limit and their steps."""
        limits = data.longest_off
        if limits is None:
            return None
        return tuple(zip(limits.customer.tolist(), limits.steps.tolist(), strict=True))

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Variables and parameters of the steps beyond a window's limits."""
        assert isinstance(shape, tuple)
        W, n = v.x_served.shape[0], len(shape)
        return cls(
            shape,
            cp.Variable((W, n), name="beyond", bounds=[0, 1]),
            cp.Parameter((W, n), name="beyond_asked", nonneg=True),
            cp.Parameter(n, name="price_beyond", nonneg=True),
        )

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Served once in the steps that each may be off and one more, or beyond the limit."""
        W = v.x_served.shape[0]
        served = [_band(W, steps + 1) @ v.x_served[:, customer] for customer, steps in self.limits]
        at_least_once = cp.vstack(served).T + self.beyond >= self.asked
        return {"longest_time_off": at_least_once}

    def terms(self) -> dict[str, cp.Expression]:
        """Penalty for the steps beyond the limits."""
        return {"f6": cp.sum(self.beyond @ self.price)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the window's limits."""
        limits = data.longest_off
        assert limits is not None
        write(self.asked, limits.asked.astype(float))
        write(self.price, limits.price)


def _band(n_steps: int, width: int) -> sp.csr_array:
    """Sums over the last ``width`` steps, the present one included, shape (W, W)."""
    ones = np.tri(n_steps) - np.tri(n_steps, k=-width)
    return sp.csr_array(ones)
