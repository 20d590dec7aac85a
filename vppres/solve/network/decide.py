"""A window enters the network: is its dispatch carried, and if not, who is served at what cost.

``docs/method.md``, *Service with the network*.
"""

from __future__ import annotations

from vppres.model.beyond_paper.ratings import has_ratings
from vppres.solve.dispatch import carried, dispatch_of, tie_breakers
from vppres.solve.fleet.masters import fleet_master
from vppres.solve.fleet.rungs import with_modes_of_batteries
from vppres.solve.levels import service_then_cost
from vppres.solve.network.large import LargeMaster
from vppres.solve.network.master import NetworkMaster, applies
from vppres.solve.programs import HALF_UNIT
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
    # Of a large window the tie-breakers take seconds to find that there is no answer: not where the
    # linear problem of the network carries less than the fleet.
    elif master is None or master.unit * (master.most_units + HALF_UNIT) > best.service:
        known.best = carried(task, best, tie_breakers)
        if known.best is not None:
            return
    before = known.best
    master = master or network_master(task)
    if master is not None:
        service_then_cost(master)
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
        # Whether the network allows the fleet's service, and the set that has it.
        as_much = master.most_units + HALF_UNIT > outcome.value
        if not task.is_huge and served is not None and as_much and master.carries(served):
            return False
        known.note("service", outcome)
        known.prove(outcome)
        if outcome.status.has_answer:
            known.bound_service(master.unit * outcome.bound)
    if not known.nothing_to_find:
        service_then_cost(master)
        use_surplus(task, master)
    return True


def use_surplus(task: WindowTask, master: NetworkMaster) -> None:
    """Search sets and modes for what a cut feeder curtails, and keep the better.

    A part has more PV power than it can use where its batteries are full, or where it has none:
    there customers have to match it, and the set of the most service may not.
    """
    known = task.certificate
    before = known.best
    if before is None or task.data.parts.whole or not task.goes_on:
        return
    if task.site.weights.lambda_curt * before.terms.f3 <= task.gap_to_best:
        return
    with_modes_of_batteries(task)
    found, known.best = known.best, before
    if found is not None and not found.in_network:
        charges = found.dispatch.charge_kw > found.dispatch.discharge_kw
        master.keep(found.dispatch.served, charges)


def network_master(task: WindowTask) -> NetworkMaster | None:
    """The master in the network, None where the window does not have its form."""
    if task.own or not applies(task.site, task.data):
        return None
    return LargeMaster(task) if task.is_large else NetworkMaster(task)
