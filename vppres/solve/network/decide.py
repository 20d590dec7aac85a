"""Service, cost and dispatch of a window whose network forbids what the fleet could do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.terms import evaluate
from vppres.solve.dispatch import ModelCache, least_reactive, net_modes
from vppres.solve.fleet.counts import Counts
from vppres.solve.fleet.masters import cost_gap_gbp, fleets_of
from vppres.solve.network.master import TOLERANCE, NetworkMaster
from vppres.solve.result import Outcome
from vppres.solve.search import GRACE_S, Candidate, Search

Polish = Callable[[Candidate], Candidate | None]

LARGE = 1500
"""Buses times steps beyond which the tie-breakers take seconds and are not asked in vain."""

SERVICE_SHARE = 0.5
FLEET_SHARE = 0.1
COST_SHARE = 0.04
"""Shares of the time left for the searches of a set, of the fleet's cost and of a cheaper set."""


def is_large(site: Site, data: WindowData) -> bool:
    """Whether a window is large."""
    return site.network.n_buses * data.n_steps > LARGE


@dataclass(frozen=True, eq=False)
class InNetwork:
    """Decides a window by the master in the network.

    Attributes
    ----------
    cache : ModelCache
        Compiled problems of the site.
    data : WindowData
        The window.
    master : NetworkMaster
        Its master.
    search : Search
        Keeps stages, bounds and time.
    polish : callable, optional
        The tie-breakers of a candidate; without them only reactive power is polished.
    """

    cache: ModelCache
    data: WindowData
    master: NetworkMaster
    search: Search
    polish: Polish | None

    def decide(self) -> Candidate | None:
        """The cheapest dispatch of the set with the most service, and bounds on F and cost.

        A set that serves less than the dispatch is worth has a lower ``F``; any other costs at
        least the bound, and none serves more than the bound on service.
        """
        search = self.search
        outcome, served = self.master.service(SERVICE_SHARE)
        search.note("network_service", outcome)
        if served is None:
            search.prove(outcome)
            return None
        search.service_bound = self.master.unit * outcome.bound
        search.bound = min(search.bound, search.service_bound)
        found = self._cheapest(served)
        if found is None:
            return None
        self._bound_cost(found)
        return self._cheaper(found)

    def _cheaper(self, found: Candidate) -> Candidate:
        """A cheaper set that serves as much, where the bound on cost leaves room for one."""
        search = self.search
        gap_gbp = cost_gap_gbp(found.terms.f2)
        if (is_large(self.cache.site, self.data)
                or found.terms.f2 - search.cost_bound_gbp <= gap_gbp):
            return found
        units = float(np.ceil(found.service / self.master.unit - TOLERANCE))
        outcome, served = self.master.cost_level(units, found.terms.f2, gap_gbp, COST_SHARE)
        search.note("network_cost_level", outcome)
        search.cost_bound_gbp = max(search.cost_bound_gbp, outcome.bound)
        other = None if served is None else self._cheapest(served)
        return other if other is not None and other.value > found.value else found

    def _bound_cost(self, found: Candidate) -> None:
        """Bound the cost of all sets by what the fleet must pay, and so ``F`` of all sets.

        A set with ``F`` above the candidate's serves more than that ``F``. Where the fleet's bound
        is not enough, that of shares of customers in the network may be.
        """
        search = self.search
        unit = self.master.unit
        enough = (found.value - 1e-9) / unit
        for name, least in (("cost_level", self._fleet_cost), ("network_least_cost",
                                                               self._network_cost)):
            cost_gbp = self._bound(name, least(enough, found))
            worth = search.service_bound - self.cache.site.weights.lambda_grid * cost_gbp
            search.bound = min(search.bound, max(found.value, worth))
            if search.bound - found.value <= search.gap or search.left_s <= 0.0:
                break
        served = (found.service - 1e-9) / unit
        if np.ceil(served) > np.ceil(enough):
            cost_gbp = max(cost_gbp, self._bound("cost_level", self._fleet_cost(served, found)))
        search.cost_bound_gbp = cost_gbp

    def _bound(self, name: str, outcome: Outcome) -> float:
        """A stage's lower bound on cost, 0 if it has none."""
        self.search.note(name, outcome)
        return max(outcome.bound, 0.0) if outcome.status.has_answer else 0.0

    @cached_property
    def _fleet(self) -> Counts:
        """The fleet's master; cuts of its first answer serve the second too."""
        demand = self.cache.demand(self.data, fleets_of(self.data)[0])
        return Counts(demand, self.data, max(FLEET_SHARE * self.search.left_s, 1.0))

    def _fleet_cost(self, units_min: float, found: Candidate) -> Outcome:
        """Least cost of all sets with so many units, without the network."""
        return self._fleet.cost(units_min, False, found.terms.f2, cost_gap_gbp(found.terms.f2))[0]

    def _network_cost(self, units_min: float, _: Candidate) -> Outcome:
        """Least cost of shares of customers with so many units, in the network."""
        return self.master.least_cost(float(np.ceil(units_min - TOLERANCE)))

    def _cheapest(self, served: Flags) -> Candidate | None:
        """Cheapest dispatch of a set, with the tie-breakers if they find one."""
        outcome, dispatch = self.master.cheapest(served, GRACE_S)
        self.search.note("network_dispatch", outcome)
        if dispatch is None:
            return None
        netted, done = net_modes(self.cache.site, self.data, dispatch)
        if not done:
            return None
        polished = self.polish(self._candidate(netted)) if self.polish is not None else None
        return polished or self._candidate(self._with_least_reactive(netted))

    def _with_least_reactive(self, dispatch: Dispatch) -> Dispatch:
        """A dispatch with the least reactive power that its active power needs."""
        time_s = max(self.search.left_s, GRACE_S)
        outcome, better = least_reactive(self.cache, self.data, dispatch, time_s)
        self.search.note("reactive_power", outcome)
        return better

    def _candidate(self, dispatch: Dispatch) -> Candidate:
        """A dispatch that the network carries, with what it is worth."""
        weights = self.cache.site.weights
        terms = evaluate(self.cache.site, self.data, dispatch)
        value = terms.upper_levels(weights)
        return Candidate(dispatch, terms, value + weights.lambda_grid * terms.f2, value, terms.f2,
                         True)
