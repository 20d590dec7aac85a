"""Customers that may be dimmed: supplied with a share of their demand.

A customer that is supplied gets at least its least share, and what it lacks counts as service that
is missing. Some catch up: they take more than their demand within some steps after, which counts as
service again. Behind the meter, (6) goes on with the whole demand. Without such customers no
problem has any of this.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.contract.owed import MOST_SHARE, Owed
from vppres.core.arrays import Wholes
from vppres.model.beyond_paper.addition import Addition, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

NOISE = 1e-6
"""Share by which a solver misses a whole demand, or the least share."""


@dataclass(frozen=True, eq=False)
class DimmedDemand(Addition):
    """Variables and parameters of the n customers that may be dimmed, of which m catch up.

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
    steps : tuple of int
        Steps in which each of the m catches up.
    catching : array, shape (m, n)
        Places the m among the n.
    caught_up : cvxpy.Variable, shape (W, m)
        Share of its demand that each takes besides.
    catches : cvxpy.Variable, shape (W, m)
        1 for a step in which it may catch up, 0 for one in which it may be dimmed: who did both
        would make new of what has lapsed.
    P_owed : cvxpy.Variable, shape (W, m)
        What each may catch up in a step, as power.
    P_valid : cvxpy.Parameter, shape (W, m)
        The same of what it lacks from before the window.
    limited : cvxpy.Parameter, shape (W, m)
        1 for a step with a limit of import: only there is it dimmed to catch up.
    """

    calm: ClassVar[tuple[str, ...]] = ("dimmed",)

    site: Site
    customer: Wholes
    dimmed: cp.Variable
    P_whole: cp.Parameter
    steps: tuple[int, ...]
    catching: sp.csr_array
    caught_up: cp.Variable
    catches: cp.Variable
    P_owed: cp.Variable
    P_valid: cp.Parameter
    limited: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Steps in which each catches up, 0 for one that does not."""
        customers = site.customers
        if not customers.dimmable.any():
            return None
        owed = Owed.of(customers, site.dt_h)
        steps = np.zeros(len(customers), dtype=int) if owed is None else owed.steps
        return tuple(steps[customers.dimmable].tolist())

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """Variables and parameters of the customers that a window may dim."""
        assert isinstance(shape, tuple)
        customer = np.flatnonzero(site.customers.dimmable)
        steps = tuple(each for each in shape if each)
        W = v.x_served.shape[0]
        return cls(
            site,
            customer,
            cp.Variable((W, len(customer)), name="dimmed", bounds=[0, 1]),
            cp.Parameter((W, len(customer)), name="P_whole", nonneg=True),
            steps,
            sp.csr_array(np.eye(len(shape))[np.array(shape) > 0]),
            cp.Variable((W, len(steps)), name="caught_up", bounds=[0, MOST_SHARE - 1.0]),
            cp.Variable((W, len(steps)), name="catches", boolean=True),
            cp.Variable((W, len(steps)), name="P_owed", nonneg=True),
            cp.Parameter((W, len(steps)), name="P_valid", nonneg=True),
            cp.Parameter((W, len(steps)), name="import_limited", nonneg=True),
        )

    @property
    def missing(self) -> cp.Expression:
        """Share that each lacks, less than 0 where it catches up, (W, n)."""
        return self.dimmed - self.caught_up @ self.catching if self.steps else self.dimmed

    def taken(self, site: Site) -> dict[str, Taken]:
        """Dimmed power, taken off the demand, active and reactive."""
        place = -sp.csr_array(sp.eye_array(len(site.customers), format="csr")[self.customer])
        less_kw = cp.multiply(self.P_whole, self.missing)
        return {"customers": (less_kw @ place, less_kw @ place.multiply(site.customers.q_per_p))}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """No more than leaves the least share, and nothing of a customer that is off."""
        most = 1.0 - site.customers.least_share[self.customer]
        within = cp.multiply(most[None, :], v.x_served[:, self.customer])
        dimmed: Named = {"dimmed_within_service": self.dimmed <= within}
        return dimmed | (self._recovery(v) if self.steps else {})

    def _recovery(self, v: Variables) -> Named:
        """Rows of owed demand: it grows by what is dimmed and lapses when its steps are over."""
        W = self.caught_up.shape[0]
        x = v.x_served[:, self.customer] @ self.catching.T
        P = self.P_whole @ self.catching.T
        taken = cp.multiply(P, self.caught_up)
        dimmed = self.dimmed @ self.catching.T
        lacking = cp.multiply(P, dimmed)
        lasting = [_last(W, steps) @ lacking[:, k] for k, steps in enumerate(self.steps)]
        rows: Named = {
            "caught_up_within_service": self.caught_up <= (MOST_SHARE - 1.0) * x,
            "catches_up": self.caught_up <= (MOST_SHARE - 1.0) * self.catches,
            "or_is_dimmed": dimmed <= 1 - self.catches,
            "dimmed_if_limited": dimmed <= self.limited,
            "caught_up_of_owed": taken <= self.P_owed,
            "owed_lapses": self.P_owed <= self.P_valid + cp.vstack(lasting).T,
        }
        if W > 1:
            left = self.P_owed[:-1] + lacking[:-1] - taken[:-1]
            rows["owed_grows"] = self.P_owed[1:] <= left
        return rows

    def terms(self) -> dict[str, cp.Expression]:
        """The service that is missing."""
        weight = self.site.customers.weight[self.customer]
        return {"own": -self.site.dt_h * cp.sum(self.missing @ weight)}

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the demand."""
        write(self.P_whole, data.load_kw[:, self.customer])
        if self.steps:
            owed = data.owed or Owed.of(site.customers, site.dt_h)
            assert owed is not None
            limited = np.isfinite(data.grid_limit_kw).astype(float)
            write(self.limited, np.tile(limited[:, None], len(self.steps)))
            write(self.P_valid, owed.valid(data.n_steps)[:, self.customer] @ self.catching.T)

    @classmethod
    def worth(cls, site: Site, data: WindowData, dispatch: Dispatch) -> dict[str, float]:
        """The service that is missing."""
        missing = dispatch.served - dispatch.supplied.astype(float)
        return {"own": -float((missing @ site.customers.weight).sum() * site.dt_h)}

    def read(self, found: Dispatch) -> Dispatch:
        """The share that each customer gets."""
        least = self.site.customers.least_share[self.customer]
        share = found.served.astype(float)
        missing = np.reshape(np.asarray(self.missing.value, dtype=float), self.dimmed.shape)
        left = np.where(np.abs(missing) < NOISE, 1.0, 1.0 - missing)
        share[:, self.customer] *= np.where(left < least + NOISE, least, left)
        return replace(found, share=share)


def _last(n_steps: int, width: int) -> sp.csr_array:
    """Sums over the last ``width`` steps before each, shape (W, W)."""
    return sp.csr_array(np.tri(n_steps, k=-1) - np.tri(n_steps, k=-width - 1))
