"""A window enters the network: is its dispatch carried, and if not, who is served at what cost.

``docs/method.md``, *Service with the network*.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.numerics import ROUNDING
from vppres.model.ratings import has_ratings
from vppres.solve.certificate import Candidate, cost_gap_gbp
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.dispatch import (
    carried,
    dispatch_of,
    netted,
    tie_breakers,
    ways_of_rows,
)
from vppres.solve.fleet.masters import Master, fleets_of, master_of
from vppres.solve.fleet.rungs import with_modes_of_batteries
from vppres.solve.network.large import master_in_network
from vppres.solve.network.master import NetworkMaster, applies
from vppres.solve.programs import HALF_UNIT, SOLVED
from vppres.solve.result import Outcome, Status
from vppres.solve.task import COST_SHARE, WindowTask


def enter_network(task: WindowTask, master: NetworkMaster | None) -> None:
    """Put the best dispatch into the network, at a higher cost or with others where it must be.

    A small window asks the tie-breakers first, and most need no master then.
    """
    best = task.certificate.best
    if best is None or best.in_network:
        return
    if task.by_phase:
        _by_phase(task, best)
        return
    if master is None and task.is_large:
        master = network_master(task)
    found = None
    if master is None or worth_asking_tie_breakers(master, best):
        found = carried(task, best, tie_breakers)
    if found is None:
        found = decided_anew(task, master or network_master(task), best)
    task.certificate.best = found


def _by_phase(task: WindowTask, best: Candidate) -> None:
    """Decide a window with phases: the set itself first, if need be at a higher cost."""
    known = task.certificate
    known.best = dispatch_of(task, best.dispatch.served)
    if not known.certified:
        known.keep(decided_anew(task, network_master(task), best))


def decide_at_once(task: WindowTask, master: NetworkMaster) -> bool:
    """Decide a large window in the network, where that forbids what the fleet could do.

    In a huge window in any case: nothing else is compiled there, since the cheapest dispatch
    without the network alone has millions of numbers at 10,000 buses. So is one with ratings, of
    which the fleet knows none, and one that is cut: every battery counts for itself there, which
    takes long to search. Says whether it was decided.
    """
    known = task.certificate
    if not has_ratings(task.data) and task.data.parts.whole:
        fleet = fleet_master(task, task.search)
        assert fleet is not None
        outcome, served = fleet.service(task.gap / master.unit)
        if not task.is_huge and served is not None and not forbids(master, outcome, served):
            return False
        known.note("service", outcome)
        known.prove(outcome)
        if outcome.status.has_answer:
            known.bound_service(master.unit * outcome.bound)
    if not known.nothing_to_find:
        known.best = InNetwork(task, master).decide()
        use_surplus(task, master)
    return True


def use_surplus(task: WindowTask, master: NetworkMaster) -> None:
    """Search sets and modes for what a cut feeder curtails beyond the least, and keep the better.

    The master takes curtailment for free. A part has more PV power than it can use where its
    batteries are full, or where it has none: there customers have to match it.
    """
    known = task.certificate
    before = known.best
    if before is None or task.data.parts.whole or not task.goes_on:
        return
    more_kwh = before.terms.f3 - master.least_curtailed_kwh
    if task.site.weights.lambda_curt * more_kwh <= task.gap_to_best:
        return
    with_modes_of_batteries(task)
    found, known.best = known.best, before
    if found is not None and not found.in_network:
        charges = found.dispatch.charge_kw > found.dispatch.discharge_kw
        known.keep(InNetwork(task, master).cheapest(found.dispatch.served, charges))


def forbids(master: NetworkMaster, outcome: Outcome, served: Flags) -> bool:
    """Whether the network forbids the fleet's service, or the set that has it."""
    less = master.most_units + HALF_UNIT <= outcome.value
    return less or not master.carries(served)


def fleet_master(task: WindowTask, deadline: Deadline) -> Master | None:
    """The master without the network, with the fleet that is tried first."""
    return master_of(task, fleets_of(task.data)[0], deadline)


def network_master(task: WindowTask) -> NetworkMaster | None:
    """The master in the network, None where the window does not have its form."""
    if task.own or not applies(task.site, task.data):
        return None
    return master_in_network(task.cache, task.data, task.deadline)


def worth_asking_tie_breakers(master: NetworkMaster, best: Candidate) -> bool:
    """Whether the tie-breakers may carry the dispatch of a large window.

    There they take seconds to find that there is no answer. The linear problem of the network is
    asked first: where it carries less than the fleet, they need not be.
    """
    return master.unit * (master.most_units + HALF_UNIT) > best.service


def decided_anew(
    task: WindowTask, master: NetworkMaster | None, best: Candidate
) -> Candidate | None:
    """A dispatch where the network forbids the cost of the one at hand, or the set itself.

    The master decides who is served; where there is none, the set stays and costs more.
    """
    if master is not None:
        found = InNetwork(task, master).decide()
        if found is not None:
            return found
    return dispatch_of(task, best.dispatch.served, fleet=False)


@dataclass(frozen=True, eq=False)
class InNetwork:
    """Decides a window by the master in the network."""

    task: WindowTask  #: the window
    master: NetworkMaster  #: its master

    def decide(self) -> Candidate | None:
        """The cheapest dispatch of the set with the most service, and bounds on F and cost.

        A set that serves less than the dispatch is worth has a lower ``F``; any other costs at
        least the bound, and none serves more than the bound on service.
        """
        known = self.task.certificate
        search = self.task.deadline.part(HALF)
        outcome, served = self.master.service(search)
        known.note("network_service", outcome)
        if served is None:
            known.prove(outcome)
            return None
        lost = self.task.site.weights.lambda_curt * self.master.least_curtailed_kwh
        known.service_bound = self.master.unit * outcome.bound - lost
        known.bound_service(known.service_bound)
        found = self.cheapest(served)
        if found is None:
            return None
        self._bound_cost(found)
        return self._cheaper(found)

    def _cheaper(self, found: Candidate) -> Candidate:
        """A cheaper set that serves as much, where the bound on cost leaves room for one.

        Rows of phases make nodes slow: a search for a set that is cheaper by a hundredth takes as
        long as all the rest there, so that one that is certified stays.
        """
        known = self.task.certificate
        gap_gbp = cost_gap_gbp(found.terms.f2)
        if self.task.is_large or found.terms.f2 - known.cost_bound_gbp <= gap_gbp:
            return found
        if self.task.data.phased is not None and self._certified(found):
            return found
        units = float(np.ceil(found.service / self.master.unit - SOLVED))
        share = COST_SHARE if self._certified(found) else HALF
        deadline = self.task.deadline.part(share)
        first = found.dispatch.served
        outcome, served = self.master.cost_level(units, first, found.terms.f2, gap_gbp, deadline)
        known.note("network_cost_level", outcome)
        known.cost_bound_gbp = max(known.cost_bound_gbp, outcome.bound)
        # A schedule that serves a unit less gains no more than the least cost there can be.
        fewer = known.worth(self.master.unit * (units - 1.0), known.cost.least_gbp)
        as_much = known.worth(known.service_bound, outcome.bound)
        known.bound_by(max(found.value, fewer, as_much))
        other = None if served is None else self.cheapest(served)
        return other if other is not None and other.value > found.value else found

    def _bound_cost(self, found: Candidate) -> None:
        """Bound the cost of all sets by what the fleet must pay, and so ``F`` of all sets.

        First by the LP relaxation of the fleet, then, if that may close the gap, by that with the
        rows of the network. Where parts tell batteries apart, the first takes longer.
        """
        known = self.task.certificate
        unit = self.master.unit
        needed = found.value + known.lambda_grid * known.cost.least_gbp
        enough = (needed - ROUNDING) / unit
        served = (found.service - ROUNDING) / unit
        known.cost_bound_gbp = -np.inf  # until now that of sets without the network
        bounds = (("least_cost", self._fleet_cost), ("network_least_cost", self._network_cost))
        cut = self.task.is_large and not self.task.data.parts.whole
        for name, least in bounds[cut:]:
            cost_gbp = self._bound(name, least(enough))
            known.bound_by(max(found.value, known.worth(known.service_bound, cost_gbp)))
            if np.ceil(served) > np.ceil(enough):
                # Sets that serve as much as this one, not only as much as it is worth, cost more.
                cost_gbp = max(cost_gbp, self._bound(name, least(served)))
            known.cost_bound_gbp = max(known.cost_bound_gbp, cost_gbp)
            done = self._certified(found) or self.task.deadline.passed
            if done or self.task.is_huge or not self._closable(found):
                break

    def _certified(self, found: Candidate) -> bool:
        """Whether a dispatch is within the gaps of the bound."""
        known = self.task.certificate
        return known.limits.met(known.bound, found.value)

    def _closable(self, found: Candidate) -> bool:
        """Whether any bound on cost, none of which exceeds a known cost, may certify a dispatch.

        Large windows, whose bounds take a second, ask for no other where a unit of service is open.
        """
        known = self.task.certificate
        least = known.worth(known.service_bound, found.terms.f2)
        return not self.task.is_large or known.limits.met(least, found.value)

    def _bound(self, name: str, outcome: Outcome) -> float:
        """A stage's lower bound on cost in GBP."""
        self.task.certificate.note(name, outcome)
        return self.task.certificate.least_cost_gbp(outcome)

    @cached_property
    def _fleet(self) -> Master | None:
        """The fleet's master, in its share of the time."""
        return fleet_master(self.task, self.task.deadline.part(COST_SHARE))

    def _fleet_cost(self, units_min: float) -> Outcome:
        """Least cost of shares of customers with so many units, without the network."""
        if self._fleet is None:
            return Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0)
        return self._fleet.cost(units_min, False, np.inf, np.inf)[0]

    def _network_cost(self, units_min: float) -> Outcome:
        """Least cost of shares of customers with so many units, in the network."""
        return self.master.least_cost(float(np.ceil(units_min - SOLVED)))

    def cheapest(self, served: Flags, charges: Flags | None = None) -> Candidate | None:
        """Cheapest dispatch of a set, with the tie-breakers if they find one."""
        found = netted(self.task, *self.master.cheapest(served, self.task.answer_by(), charges))
        return found and carried(self.task, found, *ways_of_rows(self.task))
