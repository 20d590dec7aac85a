"""A window enters the network: is its dispatch carried, and if not, who is served at what cost.

``docs/method.md``, *Service with the network*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from vppres.core.arrays import Flags
from vppres.model.ratings import has_ratings
from vppres.solve.certificate import Candidate
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.dispatch import (
    carried,
    cheapest_by_rows,
    dispatch_of,
    tie_breakers,
)
from vppres.solve.fleet.masters import Master, fleets_of, master_of
from vppres.solve.fleet.rungs import with_modes_of_batteries
from vppres.solve.levels import service_then_cost
from vppres.solve.network.large import master_in_network
from vppres.solve.network.master import NetworkMaster, applies
from vppres.solve.programs import HALF_UNIT
from vppres.solve.result import Outcome
from vppres.solve.task import WindowTask


def enter_network(task: WindowTask, master: NetworkMaster | None) -> None:
    """Put the best dispatch into the network, at a higher cost or with others where it must be.

    A small window asks the tie-breakers first, and most need no master then. With phases the set
    itself comes first, if need be at a higher cost.
    """
    known = task.certificate
    best = known.best
    if best is None or best.in_network:
        return
    if master is None and task.is_large and not task.by_phase:
        master = network_master(task)
    known.best = None
    if task.by_phase:
        known.best = dispatch_of(task, best.dispatch.served)
        if known.certified:
            return
    elif master is None or worth_asking_tie_breakers(master, best):
        known.best = carried(task, best, tie_breakers)
        if known.best is not None:
            return
    before = known.best
    master = master or network_master(task)
    if master is not None:
        service_then_cost(task, InNetwork(task, master))
    if known.best is before:
        known.keep(dispatch_of(task, best.dispatch.served, fleet=False))


def decide_at_once(task: WindowTask, master: NetworkMaster) -> bool:
    """Decide a large window in the network, where that forbids what the fleet could do.

    In a huge window in any case: nothing else is compiled there, since the cheapest dispatch
    without the network alone has millions of numbers at 10,000 buses. So is one with ratings, of
    which the fleet knows none, and one that is cut: every battery counts for itself there, which
    takes long to search. Says whether it was decided.
    """
    known = task.certificate
    if not has_ratings(task.data) and task.data.parts.whole:
        fleet = fleet_master(task)
        assert fleet is not None
        outcome, served = fleet.service(task.gap / master.unit)
        if not task.is_huge and served is not None and not forbids(master, outcome, served):
            return False
        known.note("service", outcome)
        known.prove(outcome)
        if outcome.status.has_answer:
            known.bound_service(master.unit * outcome.bound)
    if not known.nothing_to_find:
        service_then_cost(task, InNetwork(task, master))
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
        InNetwork(task, master).keep(found.dispatch.served, charges)


def forbids(master: NetworkMaster, outcome: Outcome, served: Flags) -> bool:
    """Whether the network forbids the fleet's service, or the set that has it."""
    less = master.most_units + HALF_UNIT <= outcome.value
    return less or not master.carries(served)


def fleet_master(task: WindowTask) -> Master | None:
    """The master without the network, with the fleet that is tried first."""
    return master_of(task, fleets_of(task.data)[0])


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


@dataclass(frozen=True, eq=False)
class InNetwork:
    """The relaxation in the network, by its master."""

    task: WindowTask  #: the window
    master: NetworkMaster  #: its master

    stage = "network_"
    is_last = True

    @property
    def unit(self) -> float:
        """Granularity of the weights."""
        return self.master.unit

    @property
    def deadline(self) -> Deadline:
        """The window's."""
        return self.task.deadline

    @property
    def searches_cost(self) -> bool:
        """Whether a search for a cheaper set is worth its time.

        Rows of phases make nodes slow: a search for a set that is cheaper by a hundredth takes as
        long as all the rest there, so that one that is certified stays.
        """
        slow = self.task.data.phased is not None and self.task.certificate.certified
        return not (self.task.is_large or slow)

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, less what is curtailed with any schedule."""
        outcome, served = self.master.service(self.task.deadline.part(HALF))
        lost = self.task.site.weights.lambda_curt * self.master.least_curtailed_kwh
        return replace(outcome, bound=outcome.bound - lost / self.unit), served

    def least_cost(self, units_min: float, everyone: bool) -> Outcome:
        """Least cost of shares of customers; the rows of a large network in one piece take long."""
        fleet = fleet_master(self.task)
        if self.task.is_large and self.task.data.parts.whole and fleet is not None:
            return fleet.least_cost(units_min, everyone=False)
        return self.master.least_cost(units_min)

    def cheaper(
        self, units_min: float, everyone: bool, best: Candidate, gap_gbp: float, deadline: Deadline
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units, and a set that is cheaper than the best."""
        known = best.dispatch.served, best.terms.f2
        return self.master.cheaper(units_min, *known, gap_gbp, deadline)

    def keep(self, served: Flags, charges: Flags | None = None) -> None:
        """Keep a set's cheapest dispatch, with the tie-breakers if they find one, if it is best."""
        task, network = self.task, self.master.network
        found = cheapest_by_rows(task, served, task.answer_by(), charges, network=network)[1]
        task.certificate.keep(found)
