"""Rules of customers as rows, one function per family of switching; only where they are asked.

Minimum times are the turn-on and turn-off inequalities of Rajan and Takriti, *Minimum up/down
polytopes of the unit commitment problem with start-up costs* (IBM RC23628, 2005).

Longest times off may be broken at a price: of any K + 1 steps in a row a customer that may be off
for K of them is served in one, or the last of them counts as beyond the limit. That is as many
steps as the customer is off beyond it, and no service is infeasible for it.

A customer that may be dimmed and is supplied gets at least its least share, and what it lacks
counts as service that is missing. Some catch up: they take more than their demand within some steps
after, which counts as service again. Behind the meter, (6) goes on with the whole demand.

Without rules no problem has any of this.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Floats, Wholes
from vppres.kinds.customer.data import MOST_SHARE, RuleSteps
from vppres.model.beyond_paper.addition import Addition, Taken
from vppres.model.constraints import Named
from vppres.model.data import WindowData
from vppres.model.numerics import write
from vppres.model.site import Site
from vppres.model.variables import Parameters, Variables

NOISE = 1e-6
"""Share by which a solver misses a whole demand, or the least share."""


@dataclass(frozen=True, eq=False)
class ColdDemand:
    """Demand that a restoration adds: the variable z, (W, C), and what it is multiplied by."""

    z: cp.Variable
    P_cold: cp.Parameter
    Q_cold: cp.Parameter
    P_self_cold: cp.Parameter

    @classmethod
    def create(cls, site: Site, W: int) -> ColdDemand:
        """Variable and parameters of a window of W steps."""
        C = len(site.customers)
        P = len(site.pv)
        named = {
            name: cp.Parameter((W, width), name=name, nonneg=True)
            for name, width in (("P_cold", C), ("Q_cold", C), ("P_self_cold", P))
        }
        return cls(_zero_to_one((W, C), "z_cold"), **named)

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """The added self-consumption of each PV system."""
        return {"P_self_added": cp.multiply(self.P_self_cold, self.z[:, site.owner])}

    @property
    def taken(self) -> Taken:
        """The added demand."""
        return cp.multiply(self.P_cold, self.z), cp.multiply(self.Q_cold, self.z)

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the added demand, and the added self-consumption of PV owners."""
        cold = data.all_cold()
        added: Floats = cold.load_kw - data.load_kw
        write(self.P_cold, added)
        write(self.Q_cold, added * site.customers.q_per_p)
        write(self.P_self_cold, cold.self_limit_kw(site) - data.self_limit_kw(site))


class SwitchingModel(Addition):
    """Variables, parameters, constraints and price of the rules over W steps."""

    rules: ClassVar[bool] = True
    by_service: ClassVar[tuple[str, ...]] = ("z_cold",)

    def __init__(self, site: Site, x: cp.Expression, steps: RuleSteps) -> None:
        self.site = site
        self.x = x
        self.steps = steps
        W, C = x.shape
        self.on = _zero_to_one((W, C), "y_on")
        self.off = _zero_to_one((W, C), "y_off")
        self.cold = ColdDemand.create(site, W) if steps.cold else None
        self.x_before = cp.Parameter(C, name="x_before", nonneg=True)
        self.x_min = cp.Parameter((W, C), name="x_min", nonneg=True)
        self.x_max = cp.Parameter((W, C), name="x_max", nonneg=True)
        self.actions_left = cp.Parameter((steps.days, C), name="actions_left", nonneg=True)
        self.in_day = cp.Parameter((steps.days, W), name="in_day", nonneg=True)
        self.cold_before = cp.Parameter((W, C), name="cold_before", nonneg=True)
        self.price = cp.Parameter(name="price", nonneg=True)
        families = FAMILIES + ((cold_load,) if steps.cold else ())
        self.constraints = {name: c for family in families for name, c in family(self).items()}

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Minimum times and cold load in steps; None without rules on switching itself."""
        rules = data.switching
        return None if rules is None or rules.only_time_off else rules.steps

    @classmethod
    def create(cls, site: Site, v: Variables, shape: Hashable) -> Self:
        """The rules on the service of a window."""
        assert isinstance(shape, RuleSteps)
        return cls(site, v.x_served, shape)

    def parameters(self, site: Site) -> dict[str, cp.Expression]:
        """Self-consumption of the demand after restorations."""
        return {} if self.cold is None else self.cold.parameters(site)

    def taken(self, site: Site) -> dict[str, Taken]:
        """Demand after restorations."""
        return {} if self.cold is None else {"customers": self.cold.taken}

    def families(self, site: Site, v: Variables, p: Parameters) -> Named:
        """Rows on service and on what follows from it."""
        return self.constraints

    def terms(self) -> dict[str, cp.Expression]:
        """Price of the actions; switching off pays for the restoration too."""
        return {"f6": 2.0 * self.price * cp.sum(self.off)}

    @property
    def follow(self) -> list[cp.Variable]:
        """Variables that service decides, (W, C) each."""
        return [self.on, self.off] + ([] if self.cold is None else [self.cold.z])

    def fill(self, site: Site, data: WindowData) -> None:
        """Write the window's rules."""
        rules = data.switching
        assert rules is not None
        write(self.x_before, rules.served_before.astype(float))
        write(self.x_min, rules.served_min.astype(float))
        write(self.x_max, rules.served_max.astype(float))
        write(self.actions_left, np.minimum(rules.actions_left, 2.0 * data.n_steps))
        write(self.in_day, rules.in_day.astype(float))
        write(self.price, rules.price_per_action)
        if self.cold is not None:
            write(self.cold_before, rules.cold_before.astype(float))
            self.cold.fill(site, data)


def switching_actions(m: SwitchingModel) -> Named:
    """Changes of service: x(t) - x(t - 1) = y_on - y_off."""
    W, C = m.x.shape
    first = np.eye(W, 1)
    before = first @ cp.reshape(m.x_before, (1, C), order="C") + np.eye(W, k=-1) @ m.x
    return {"switching_balance": m.x - before == m.on - m.off}


def minimum_times(m: SwitchingModel) -> Named:
    """A customer switched on in the last U steps is supplied; likewise for off.

    With U = 1 this still says that no customer is switched on without being supplied. Steps before
    the U-th need no row: with the balance each says that no customer is switched off until then
    that was not served before the window, which the U-th says too.
    """
    W = m.x.shape[0]
    U_on, U_off = (min(steps, W) for steps in (m.steps.served, m.steps.unserved))
    return {
        "minimum_served": _band(W, U_on)[U_on - 1 :] @ m.on <= m.x[U_on - 1 :],
        "minimum_unserved": _band(W, U_off)[U_off - 1 :] @ m.off <= 1 - m.x[U_off - 1 :],
    }


def past_actions(m: SwitchingModel) -> Named:
    """Rows of the time before the window: bounds on the service, and the actions that are left."""
    actions = m.on + m.off
    # A window within one day has no use for a product with a parameter.
    of_day = cp.sum(actions, axis=0, keepdims=True) if m.steps.days == 1 else m.in_day @ actions
    return {
        "switching_served_min": m.x >= m.x_min,
        "switching_served_max": m.x <= m.x_max,
        "switching_limit": of_day <= m.actions_left,
    }


def cold_load(m: SwitchingModel) -> Named:
    """Demand is higher, z = 1, just for supplied customers restored in the last K steps.

    One restored in the last U steps is still supplied. Where K is larger, one that is supplied
    now and was not k steps ago was restored in between. Shares of customers meet these rows just
    where whole ones do in a mixture, which a bound on single restorations leaves open. A
    restoration before the window counts as long as it lasts.
    """
    cold = m.cold
    assert cold is not None
    W, C = m.x.shape
    K = m.steps.cold
    U = min(m.steps.served, K)
    last = min(K, W)
    rows: Named = {"cold_load_after": cold.z >= _band(W, U) @ m.on}
    for k in range(U + 1, min(K, W - 1) + 1):
        rows[f"cold_load_after_{k}"] = cold.z[k:] >= m.x[k:] - m.x[:-k]
    if last > U:
        before = np.ones((last - U, 1)) @ cp.reshape(m.x_before, (1, C), order="C")
        rows["cold_load_after_before"] = cold.z[U:last] >= m.x[U:last] - before
    return rows | {
        "cold_load_before": cold.z >= m.cold_before + m.x - 1,
        "cold_load_served": cold.z <= m.x,
        "cold_load_restored": cold.z <= _band(W, K) @ m.on + m.cold_before,
    }


RuleFamily = Callable[[SwitchingModel], Named]
FAMILIES: tuple[RuleFamily, ...] = (switching_actions, minimum_times, past_actions)


Limits = tuple[tuple[int, int], ...]
"""Customers with a limit, each with the steps that it may be off."""


@dataclass(frozen=True, eq=False)
class LongestTimeOff(Addition):
    """Variable and parameters of the longest times off."""

    rules: ClassVar[bool] = True

    limits: Limits  #: customers with a limit, each with its steps
    beyond: cp.Variable  #: whether a step is beyond the limit, (W, n)
    asked: cp.Parameter  #: 1 if a step may be beyond it, (W, n)
    price: cp.Parameter  #: price of a step beyond it, in weighted customer hours, (n,)

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Customers with a limit and their steps."""
        if data.switching is None or not len(data.switching.longest_off):
            return None
        limits = data.switching.longest_off
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
        assert data.switching is not None
        write(self.asked, data.switching.longest_off.asked.astype(float))
        write(self.price, data.switching.longest_off.price)


@dataclass(frozen=True, eq=False)
class DimmedDemand(Addition):
    """Variables and parameters of the n customers that may be dimmed, of which m catch up."""

    calm: ClassVar[tuple[str, ...]] = ("dimmed",)

    site: Site  #: fixed data
    customer: Wholes  #: their positions, (n,)
    dimmed: cp.Variable  #: share of the demand that each does not get although it is served, (W, n)
    P_whole: cp.Parameter  #: their demand, (W, n)
    most: cp.Parameter  #: the largest share of it that each may lack, (W, n)
    steps: tuple[int, ...]  #: steps in which each of the m catches up
    catching: sp.csr_array  #: places the m among the n, (m, n)
    caught_up: cp.Variable  #: share of its demand that each takes besides, (W, m)
    #: 1 for a step in which it may catch up, 0 for one in which it may be dimmed, (W, m): who did
    #: both would make new of what has lapsed.
    catches: cp.Variable
    P_owed: cp.Variable  #: what each may catch up in a step, as power, (W, m)
    P_valid: cp.Parameter  #: what it may catch up of what it lacks from before the window, (W, m)
    #: 1 for a step with a limit of import, (W, m): only there is it dimmed to catch up.
    limited: cp.Parameter

    @classmethod
    def shape(cls, site: Site, data: WindowData) -> Hashable | None:
        """Steps in which each catches up, 0 for one that does not."""
        customers = site.customers
        if not customers.dimmable.any():
            return None
        return tuple(customers.recovery_steps(site.dt_h)[customers.dimmable].tolist())

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
            cp.Parameter((W, len(customer)), name="most_dimmed", nonneg=True),
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
        within = cp.multiply(self.most, v.x_served[:, self.customer])
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
        lasting = [_band(W, steps, lag=1) @ lacking[:, k] for k, steps in enumerate(self.steps)]
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
        """Write the demand, and what of it may be dimmed.

        Who cannot be dimmed now catches nothing up: it gets its demand.
        """
        write(self.P_whole, data.load_kw[:, self.customer])
        most = 1.0 - site.customers.least_share_but(data.whole)[self.customer]
        write(self.most, np.tile(most, (data.n_steps, 1)))
        if self.steps:
            limited = np.isfinite(data.grid_limit_kw).astype(float)
            write(self.limited, np.tile(limited[:, None], len(self.steps)))
            owed_kw = data.owed.valid(data.n_steps)[:, self.customer] * (most > 0.0)
            write(self.P_valid, owed_kw @ self.catching.T)

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


def _zero_to_one(shape: tuple[int, int], name: str) -> cp.Variable:
    """A variable that the constraints keep from 0 to 1 in any case.

    Its bounds say so too: where constraints alone kept it below 1, HiGHS's presolve made numbers of
    the actions' balance that are none, and sometimes never ended, whatever its time limit.
    """
    return cp.Variable(shape, name=name, bounds=[0, 1])


def _band(n_steps: int, width: int, lag: int = 0) -> sp.csr_array:
    """Sums over ``width`` steps, the last of them ``lag`` before the present one, (W, W)."""
    return sp.csr_array(np.tri(n_steps, k=-lag) - np.tri(n_steps, k=-width - lag))
