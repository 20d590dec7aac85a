"""All terms at once, without the network: the relaxation that needs no grid of weights or prices.

``docs/method.md``, *Stages*.
"""

from __future__ import annotations

from functools import partial

from vppres.model.numerics import objective_scale
from vppres.solve.dispatch import keep_dispatch
from vppres.solve.fleet.masters import fleets_of, search_for_set
from vppres.solve.fleet.relaxation import fleet_problem
from vppres.solve.result import Status
from vppres.solve.task import WindowTask

GAP_SHARE = 0.8
"""Share of the window's gap that a search may leave open; the rest is for the tie-breakers."""


def all_terms(task: WindowTask) -> None:
    """Search for the best served set with the fleet as one battery, then with every battery.

    Where batteries would waste energy, their modes come next, and no other search.
    """
    for lumped in fleets_of(task.data):
        if task.goes_on and not task.certificate.wasteful:
            task.search_to_its_gap(GAP_SHARE, partial(_search, task, lumped))


def _search(task: WindowTask, lumped: bool, gap: float) -> bool:
    """One search to a gap; whether it ended."""
    known = task.certificate
    problem = fleet_problem(task.cache, task.data, lumped, integer=True, goal="weighted")
    problem.write(task.data)
    scale = objective_scale(task.site)
    first = None if known.best is None else known.best.dispatch.served
    time_s = task.search.left_s
    outcome = search_for_set(problem, task.spec, gap, time_s, scale, first)
    known.note("aggregate", outcome)
    if not outcome.status.has_answer:
        known.prove(outcome)
        return False
    known.bound_by(outcome.bound)
    keep_dispatch(task, problem.value_of("x_served") > 0.5)
    return outcome.status == Status.OPTIMAL
