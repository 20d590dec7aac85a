"""The stages without the network: relaxations of growing size, each with its bound.

The proofs are in ``docs/method.md``, *Why the bounds hold*.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from vppres.model.numerics import ROUNDING, objective_scale
from vppres.solve.certificate import cost_gap_gbp
from vppres.solve.dispatch import cheapest, keep_dispatch
from vppres.solve.fleet.masters import Master
from vppres.solve.forms import Form, window_problem
from vppres.solve.programs import GAP_SHARE, HALF_UNIT, WHOLE_GAP
from vppres.solve.result import Status
from vppres.solve.solvers import run
from vppres.solve.task import COST_SHARE, WindowTask


def everyone_served(task: WindowTask) -> None:
    """Supply all customers and curtail nothing: if that is feasible, no search is needed."""
    keep_dispatch(task, np.ones(task.data.load_kw.shape, dtype=bool))
    best = task.certificate.best
    if best is not None and task.everyone - best.service <= ROUNDING * task.everyone:
        smallest = task.site.customers.weight.min() * task.site.dt_h
        task.certificate.everyone_is_served(task.everyone, smallest)


def service_then_cost(task: WindowTask, master: Master) -> None:
    """Service first, on the weights' grid, then the cost of all sets that serve as much."""
    known = task.certificate
    outcome, served = master.service(task.gap / master.unit)
    known.note("service", outcome)
    if served is None:
        known.prove(outcome)
        return
    keep_dispatch(task, served)
    service_bound = master.unit * outcome.bound
    known.bound_service(service_bound)
    if known.best is not None and service_bound - known.best.service <= task.gap:
        known.service_bound = service_bound
        _cost_level(task, master)


def _cost_level(task: WindowTask, master: Master) -> None:
    """Cheapest set that serves as much, the bound on the cost of all, and so the bound on F.

    A set that serves less than the search admits either serves too little to be better than the
    dispatch at hand, or costs at least what the linear relaxation says.
    """
    known = task.certificate
    best = known.best
    assert best is not None
    unit = master.unit
    needed = known.least_service_of_better()
    # Rounding must exclude no set of exactly that service.
    admitted = max(needed, best.service - HALF_UNIT * unit)
    everyone = known.service_bound - admitted < WHOLE_GAP * unit
    whole_time = master.deadline
    if known.certified:
        master.deadline = whole_time.part(COST_SHARE)
    outcome, served = master.cost(
        (admitted - ROUNDING) / unit, everyone, best.terms.f2, cost_gap_gbp(best.terms.f2)
    )
    master.deadline = whole_time
    known.note("cost_level", outcome)
    if not outcome.status.has_answer:
        return
    known.cost_bound_gbp = known.least_cost_gbp(outcome)
    bound = known.worth(known.service_bound, known.cost_bound_gbp)
    if admitted > needed:
        # Costs of sets that serve less: the linear relaxation is enough.
        least, _ = master.cost((needed - ROUNDING) / unit, False, np.inf, np.inf)
        known.note("least_cost", least)
        bound = max(bound, known.worth(admitted, known.least_cost_gbp(least)))
    known.bound = max(bound, best.value)
    if (
        served is not None
        and (served != best.dispatch.served).any()
        and outcome.value < best.terms.f2
    ):
        keep_dispatch(task, served)


def with_modes_of_batteries(task: WindowTask) -> None:
    """Served set, modes of all batteries and bound of the whole problem without the network.

    Where PV power must be curtailed, a relaxation charges and discharges at once to lose it. Real
    batteries do so in turns, and how much they lose takes their binaries to know.

    Service and curtailment may cancel to an objective near zero, or curtailment outweigh all
    service: the problem without binaries says how large the objective is, and so which gap the
    search needs.
    """
    form = Form("service", "relaxed", "relaxed", network=False)
    problem = window_problem(task.cache, task.data, form)
    problem.fill(task.data)
    outcome = run(problem, task.spec, 0.0, task.search.left_s, objective_scale(task.site))
    known = task.certificate
    known.note("modes_relaxed", outcome)
    if outcome.status == Status.OPTIMAL:
        known.bound_by(outcome.bound)
    if task.goes_on:
        task.search_to_its_gap(GAP_SHARE, partial(_search_modes, task))


def _search_modes(task: WindowTask, gap: float) -> bool:
    """One search for set and modes to a gap; whether it ended."""
    known = task.certificate
    form = Form("service", "integer", "integer", network=False)
    problem = window_problem(task.cache, task.data, form)
    problem.fill(task.data)
    outcome = run(problem, task.spec, gap, task.search.left_s, objective_scale(task.site))
    if not known.learn("modes", outcome):
        return False
    served = problem.value_of("x_served") > 0.5
    modes = {name: problem.value_of(name) for name in problem.binaries if name != "x_served"}
    known.keep(cheapest(task, served, modes=modes))
    return outcome.status == Status.OPTIMAL
