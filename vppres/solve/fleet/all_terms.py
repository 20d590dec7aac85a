"""All terms at once, without the network: the relaxation that needs no grid of weights or prices.

``docs/method.md``, *Stages*.
"""

from __future__ import annotations

from functools import partial

from vppres.core.errors import InputError
from vppres.model.numerics import objective_scale
from vppres.solve.dispatch import keep_dispatch
from vppres.solve.fleet.masters import fleets_of
from vppres.solve.fleet.relaxation import fleet_of, fleet_problem
from vppres.solve.programs import GAP_SHARE, search_options
from vppres.solve.result import Status
from vppres.solve.solvers import run
from vppres.solve.task import WindowTask


def all_terms(task: WindowTask) -> None:
    """Search for the best supply schedule with the fleet as one battery, then with every battery.

    Where batteries would waste energy, their modes come next, and no other search.
    """
    for lumped in fleets_of(task.data):
        if lumped and not_bounded(task, lumped):
            continue
        if task.goes_on and not task.certificate.wasteful:
            task.search_to_its_gap(GAP_SHARE, partial(_search, task, lumped))


def require_bounds(task: WindowTask) -> None:
    """Refuse a page that the fleet has no bound of.

    Raises
    ------
    InputError
        If a family or the term that only the page has is not one of the fleet's, or the page lacks
        a family of the paper.
    """
    unknown = not_bounded(task, lumped=False)
    if unknown:
        name = unknown[0]
        changed = name in task.sheet.statement.changed
        said = f"a page without the paper's family {name}" if changed else f"the family {name}"
        raise InputError.of(
            "options",
            f"does not bound {'the term that paper_objective has' if name == 'own' else said}",
            "Use --method monolithic.",
            field="method",
            value="decomposed",
        )


def not_bounded(task: WindowTask, lumped: bool) -> list[str]:
    """Families and letters of the page that the fleet's relaxation does not bound.

    Families of letters that an addition leaves to the network are left to it too.
    """
    if not task.own:
        return []
    fleet = fleet_of(task.cache, task.data, lumped)
    statement = fleet.sheet.statement
    later = set(statement.named("of_network"))
    taken = fleet.joined.keys() | fleet.terms.keys()
    taken |= {name for name in statement.families if later & statement.letters_of(name)}
    return [name for name in task.own if name in statement.changed or name not in taken]


def _search(task: WindowTask, lumped: bool, gap: float) -> bool:
    """One search to a gap; whether it ended."""
    known = task.certificate
    problem = fleet_problem(task.cache, task.data, lumped, integer=True, goal="weighted")
    problem.write(task.data)
    scale = objective_scale(task.site)
    first = None if known.best is None else known.best.dispatch.served
    options = search_options(task.site, task.data)
    outcome = run(problem, task.spec, gap, task.search.left_s, scale, options, first)
    if not known.learn("aggregate", outcome):
        return False
    keep_dispatch(task, problem.value_of("x_served") > 0.5)
    return outcome.status == Status.OPTIMAL
