"""Which of equal supply schedules is taken: one that serves sooner, and keeps on who is on.

Service and cost leave many schedules alike, and which of them a search meets first depends on the
solver. Where forecasts may be wrong, or an outage may last longer than a window, what is put off
may never come (``docs/method.md``, *Equal plans*).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.terms import Terms
from vppres.solve.compiled import Numbers
from vppres.solve.deadline import Deadline
from vppres.solve.dispatch import HELD_ABS, HELD_REL, SERVICE_HELD_REL
from vppres.solve.fleet.all_terms import not_bounded
from vppres.solve.fleet.masters import fleets_of, set_of
from vppres.solve.fleet.relaxation import Fleet, FleetProblem, fleet_of
from vppres.solve.programs import NODES, search_options
from vppres.solve.solvers import NO_ANSWER, compiled_in_time, solve_by_highs
from vppres.solve.task import WindowTask

STAYS = 0.5
"""What all customers that stay on count together, in units of service that come a step sooner."""


class Sooner(FleetProblem):
    """The fleet's schedules of enough service and no more cost, the soonest first.

    A customer's step counts its weight once for each step that is left of the window.
    """

    def __init__(self, site: Site, fleet: Fleet) -> None:
        super().__init__(site, fleet, integer=True, goal="sooner")
        self.worth = np.zeros((0, 0))

    def write_equals(self, data: WindowData, served: Flags, terms: Terms) -> None:
        """Write a window and what schedules as good as one have at least; its own is among them."""
        site = self.fleet.site
        self.service_min = service_of(site, terms) - missed(service_of(site, terms))
        self.write(data)
        # Where import has no limit all stays as it is.
        free = np.isinf(data.grid_limit_kw)[:, None]
        self.limits |= {
            "service_max": np.where(free, served, self.limits["service_max"]),
            "service_min": np.where(free, -served.astype(float), 0.0),
            "cost_most": terms.f2 + missed_gbp(terms.f2),
        }
        left = np.arange(data.n_steps, 0, -1)[:, None]
        unit = self.grid or float(site.customers.weight.min())
        self.worth = left * site.customers.weight * site.dt_h / unit
        if data.on_before is not None:
            self.worth[0] += STAYS * data.on_before / len(data.on_before)

    def numbers(self) -> Numbers:
        """The numbers with what serving sooner is worth."""
        n = super().numbers()
        n.cost[self.at("x_served")] -= self.worth
        return n


def is_settled(site: Site, data: WindowData, served: Flags) -> bool:
    """Whether no schedule of as much service is asked for that serves sooner, or keeps more on.

    So it is where customers of a weight that are left out of a step of limited supply are followed
    by none of that weight in another such step.
    """
    limited = np.isfinite(data.grid_limit_kw)
    silent = bool(data.physics) or data.open_ended  # the paper is, on which of equal plans is taken
    if not silent or served[limited].all():
        return True
    before = data.on_before
    if before is not None and limited[0]:
        now = served[0]
        if (before & ~now).any() and (now & ~before).any():  # some go off, and others on
            return False
    if site.batteries.idle:
        return True
    weight = site.customers.weight
    of_weight = (served[np.ix_(limited, weight == each)] for each in np.unique(weight))
    return not any(_put_off(alike) for alike in of_weight)


def _put_off(served: Flags) -> bool:
    """Whether a step leaves out some, and a later one serves any."""
    lacking = ~served.all(axis=1)
    return bool(lacking.any() and served[np.argmax(lacking) + 1 :].any())


def sooner(task: WindowTask, served: Flags, terms: Terms, deadline: Deadline) -> Iterator[Flags]:
    """Schedules of no less service and no more cost than one that serve sooner, by each fleet.

    A fleet that does not know all that the page has would find what no dispatch is worth.
    """
    for lumped in fleets_of(task.data):
        if not_bounded(task, lumped):
            continue
        fleet = fleet_of(task.cache, task.data, lumped)
        problem = task.cache.problem(Sooner, fleet=fleet)
        problem.write_equals(task.data, served, terms)
        outcome = NO_ANSWER
        if compiled_in_time(problem, deadline):
            more = {**search_options(task.site, task.data), "mip_max_nodes": NODES}
            outcome = solve_by_highs(problem, deadline, more=more, first=served)
        task.certificate.note("sooner", outcome)
        found = set_of(problem, outcome)
        if found is not None and (found != served).any():
            yield found


def as_good(site: Site, found: Terms, known: Terms) -> bool:
    """Whether a plan is worth as much as another, both by service and by cost."""
    service = service_of(site, known)
    enough = service_of(site, found) >= service - 2.0 * missed(service)
    return enough and found.f2 <= known.f2 + 2.0 * missed_gbp(known.f2)


def service_of(site: Site, terms: Terms) -> float:
    """F without cost and tie-breakers."""
    return terms.upper_levels(site.weights) + site.weights.lambda_grid * terms.f2


def missed(service: float) -> float:
    """Service that the dispatch of as much service may miss."""
    return SERVICE_HELD_REL * (1.0 + abs(service))


def missed_gbp(cost_gbp: float) -> float:
    """Cost by which the dispatch of a cost may exceed it, in GBP."""
    return HELD_REL * abs(cost_gbp) + HELD_ABS
