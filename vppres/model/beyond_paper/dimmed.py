"""Customers that may be dimmed: supplied with a share of their demand.

Whoever is served gets at least its least share, and what it lacks counts as service that is
missing. Behind the meter, (6) goes on with the whole demand. Without such customers no problem has
any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Self

import cvxpy as cp
import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Wholes
from vppres.model.beyond_paper.addition import Addition
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

NOISE = 1e-6
"""Share by which a solver misses a whole demand, or the least share."""


@dataclass(frozen=True, eq=False)
class DimmedDemand(Addition):
    """Variable and parameter of the n customers that may be dimmed.

    Parameters
    ----------
    site : Site
        Fixed data.
    customer : array of int, shape (n,)
        Their positions.
    dimmed : cvxpy.Variable, shape (W, n)
        Share of the demand that each does not get although it is served.
    P_whole : cvxpy.Parameter, shape (W, n)
        Their demand.
    """

    site: Site
    customer: Wholes
    dimmed: cp.Variable
    P_whole: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """No more than whether there are any."""
        return bool(site.customers.dimmable.any()) or None

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """What a window may dim."""
        customer = np.flatnonzero(site.customers.dimmable)
        size = (v.x_served.shape[0], len(customer))
        return cls(
            site,
            customer,
            cp.Variable(size, name="dimmed", bounds=[0, 1]),
            cp.Parameter(size, name="P_whole", nonneg=True),
        )

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """What is dimmed comes off the demand at the buses, active and reactive."""
        place = -site.customer_bus[:, self.customer]
        q_per_p = site.customers.q_per_p[self.customer]
        less_kw = cp.multiply(self.P_whole, self.dimmed)
        return {
            "P_added": less_kw @ place.T,
            "Q_added": less_kw @ place.multiply(q_per_p).T,
        }

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """No more than leaves the least share, and nothing of a customer that is off."""
        most = 1.0 - site.customers.least_share[self.customer]
        within = cp.multiply(most[None, :], v.x_served[:, self.customer])
        return {"dimmed_within_service": self.dimmed <= within}

    def terms(self) -> dict[str, cp.Expression]:
        """The service that is missing."""
        weight = self.site.customers.weight[self.customer]
        return {"own": -self.site.dt_h * cp.sum(self.dimmed @ weight)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the demand."""
        write(self.P_whole, data.load_kw[:, self.customer])

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """The service that is missing."""
        missing = dispatch.served - dispatch.supplied.astype(float)
        return {"own": -float((missing @ site.customers.weight).sum() * site.dt_h)}

    def read(self, found: Dispatch) -> Dispatch:
        """The share that each customer gets."""
        least = self.site.customers.least_share[self.customer]
        share = found.served.astype(float)
        dimmed = np.reshape(np.asarray(self.dimmed.value, dtype=float), self.dimmed.shape)
        left = np.where(dimmed < NOISE, 1.0, 1.0 - dimmed)
        share[:, self.customer] *= np.where(left < least + NOISE, least, left)
        return replace(found, share=share)
