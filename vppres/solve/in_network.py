"""Service, cost and dispatch of a window whose network forbids what the fleet could do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vppres.model.data import Dispatch, Site, WindowData, evaluate
from vppres.solve.counts import Counts
from vppres.solve.levels import fleets_of
from vppres.solve.network_master import NetworkMaster
from vppres.solve.result import Outcome, Status
from vppres.solve.search import GRACE_S, Candidate, Search
from vppres.solve.stages import ModelCache, least_reactive, net_modes

Served = NDArray[np.bool_]
Polish = Callable[[Candidate], Candidate | None]

LARGE = 1500
"""Buses times steps beyond which the tie-breakers take seconds and are not asked in vain."""

SERVICE_SHARE = 0.5
"""Share of a window's time left that the search for a set may take."""


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
        if found is not None:
            self._bound_cost(found)
        return found

    def _bound_cost(self, found: Candidate) -> None:
        """Bound the cost of all sets that serve enough; in large windows the fleet's may do."""
        search, enough = self.search, (found.value - 1e-9) / self.master.unit
        large = is_large(self.cache.site, self.data)
        fleet = [("least_cost", self._least_of_fleet)] if large else []
        for name, bound in (*fleet, ("network_least_cost", self.master.least_cost)):
            if large and (search.bound - found.value <= search.gap or search.left_s <= 0.0):
                return
            least = bound(enough)
            search.note(name, least)
            if least.status == Status.OPTIMAL:
                weight = self.cache.site.weights.lambda_grid
                search.cost_bound_gbp = max(least.bound, 0.0)
                worth = search.service_bound - weight * search.cost_bound_gbp
                search.bound = min(search.bound, max(found.value, worth))

    def _least_of_fleet(self, units_min: float) -> Outcome:
        """Least cost of all sets with so many units, without the network."""
        demand = self.cache.demand(self.data, fleets_of(self.data)[0])
        return Counts(demand, self.data, GRACE_S).cost(units_min, False, np.inf, np.inf)[0]

    def _cheapest(self, served: Served) -> Candidate | None:
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
