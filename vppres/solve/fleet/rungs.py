"""The lower rungs of the ladder: relaxations without the network, each with its bound.

The proofs are in ``docs/method.md``, *Why a bound bounds*.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from vppres.model.forms import Form
from vppres.model.numerics import objective_scale
from vppres.solve.certificate import cost_gap_gbp
from vppres.solve.dispatch import (
    cheapest_with_modes,
    keep_dispatch,
    window_model,
    with_tie_breakers,
)
from vppres.solve.fleet.masters import (
    Master,
    least_cost_one_way,
)
from vppres.solve.fleet.modes import modes_apart
from vppres.solve.result import Status
from vppres.solve.solvers import run
from vppres.solve.task import COST_SHARE, WindowTask

NOTHING_LOST = 1e-6
"""Share of the gap by which the service of everyone may be missed: rounding of its sum."""

MODES_GAP_SHARE = 0.5
"""The same of the search with the modes of all batteries, which also leaves cost to its gap."""

ADMITTED_UNITS = 0.5
"""Units below the best service down to which cheaper sets are looked for: between two whole
numbers, so that rounding does not decide."""

EVERYONE_UNITS = 0.99
"""Units below the bound on service within which nobody connected can be left out."""

LONG_STEPS = 12
"""Steps from which on a cheaper set takes long to find. Of 97 slow windows, most of 21 quarter
hours, the network forbids 18 in any case: they take 0.3 s less each where it is asked first."""

UNITS_TOLERANCE = 1e-9
"""What is taken off a sum of weights so that rounding excludes no set of exactly that service."""


def everyone_served(task: WindowTask) -> None:
    """Serve everyone and curtail nothing: if that is feasible, no search is needed."""
    keep_dispatch(task, np.ones(task.data.load_kw.shape, dtype=bool))
    best = task.certificate.best
    if best is not None and task.everyone - best.service <= NOTHING_LOST * task.gap:
        smallest = task.site.customers.weight.min() * task.site.dt_h
        task.certificate.everyone_is_served(task.everyone, smallest)


def service_then_cost(task: WindowTask, master: Master) -> None:
    """Service first, on the weights' grid, then the cost of all sets that serve as much."""
    known = task.certificate
    outcome, served = master.service(task.gap / master.unit)
    known.note(f"{master.prefix}service", outcome)
    if served is None:
        known.prove(outcome)
        return
    keep_dispatch(task, served)
    service_bound = master.unit * outcome.bound
    known.bound_service(service_bound)
    if known.best is not None and service_bound - known.best.service <= task.gap:
        known.service_bound = service_bound
        if not refused_by_network(task):
            _cost_level(task, master)


def refused_by_network(task: WindowTask) -> bool:
    """Whether the network forbids the best dispatch, asked where a cheaper set takes long to find.

    With rules and in many steps that search takes seconds. Where its bound is not needed it is left
    out if it would be in vain: the sets that the network carries have a search of their own.
    """
    known = task.certificate
    takes_long = task.data.switching is not None or task.data.n_steps >= LONG_STEPS
    if not (takes_long and known.certified):
        return False
    assert known.best is not None
    carried = with_tie_breakers(task, known.best)
    if carried is None:
        known.refused = known.best
        return True
    known.best = carried
    return False


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
    admitted = max(needed, best.service - ADMITTED_UNITS * unit)
    everyone = known.service_bound - admitted < EVERYONE_UNITS * unit
    whole_time = master.deadline
    if known.certified:
        master.deadline = whole_time.part(COST_SHARE)
    outcome, served = master.cost(
        (admitted - UNITS_TOLERANCE) / unit, everyone, best.terms.f2, cost_gap_gbp(best.terms.f2)
    )
    master.deadline = whole_time
    known.note(f"{master.prefix}cost_level", outcome)
    if not outcome.status.has_answer:
        return
    one_way = _one_way(task, (needed - UNITS_TOLERANCE) / unit)
    known.cost_bound_gbp = max(known.least_cost_gbp(outcome), one_way)
    bound = known.worth(known.service_bound, known.cost_bound_gbp)
    if admitted > needed:
        # Costs of sets that serve less: the linear relaxation is enough.
        least, _ = master.cost((needed - UNITS_TOLERANCE) / unit, False, np.inf, np.inf)
        known.note(f"{master.prefix}least_cost", least)
        least_gbp = max(known.least_cost_gbp(least), one_way)
        bound = max(bound, known.worth(admitted, least_gbp))
    known.bound = max(bound, best.value)
    if (
        served is not None
        and (served != best.dispatch.served).any()
        and outcome.value < best.terms.f2
    ):
        keep_dispatch(task, served)


def _one_way(task: WindowTask, units_min: float) -> float:
    """Bound on cost where the masters' would earn by importing and exporting at once, in GBP."""
    deadline = task.search.part(COST_SHARE) if task.certificate.certified else task.search
    outcome = least_cost_one_way(task, units_min, deadline)
    if outcome is None:
        return -np.inf
    task.certificate.note("one_way_cost", outcome)
    return task.certificate.least_cost_gbp(outcome)


def with_modes_of_batteries(task: WindowTask) -> None:
    """Served set, modes of all batteries and bound of the whole problem without the network.

    Where PV power must be curtailed, a relaxation charges and discharges at once to lose it. Real
    batteries do so in turns, and how much they lose takes their binaries to know.

    Service and curtailment may cancel to an objective near zero, or curtailment outweigh all
    service: the problem without binaries says how large the objective is, and so which gap the
    search needs. Where that was more than there is, it is done again.
    """
    form = Form("service", "relaxed", "relaxed", network=False)
    model = window_model(task.cache, task.data, form)
    model.fill(task.data)
    outcome = run(model.problem, task.spec, 0.0, task.search.left_s, objective_scale(task.site))
    known = task.certificate
    known.note("modes_relaxed", outcome)
    if outcome.status == Status.OPTIMAL:
        known.bound_by(outcome.bound)
        _one_battery_at_a_time(task, outcome.bound, task.limits.gap_at(known.bound))
    if not task.goes_on:
        return
    task.search_to_its_gap(task.gap_so_far, MODES_GAP_SHARE, partial(_search_modes, task))


def _one_battery_at_a_time(task: WindowTask, relaxed: float, gap: float) -> None:
    """Bound and set by a search of each battery alone; most windows are closed by that.

    With rules few steps are as soon searched at once.
    """
    few = task.data.n_steps < LONG_STEPS
    if task.data.ending or (task.data.switching is not None and few) or task.search.passed:
        return
    form = Form("service", "integer", "integer", network=False)
    model = window_model(task.cache, task.data, form)
    model.fill(task.data)
    found = modes_apart(task, model, relaxed, gap)
    if found is None:
        return
    known = task.certificate
    known.note("modes_apart", found.outcome)
    known.bound_by(found.outcome.bound)
    if found.served is not None:
        known.keep(cheapest_with_modes(task, found.served, found.modes))


def _search_modes(task: WindowTask, gap: float) -> bool:
    """One search for set and modes to a gap; whether it ended."""
    known = task.certificate
    form = Form("service", "integer", "integer", network=False)
    model = window_model(task.cache, task.data, form)
    model.fill(task.data)
    outcome = run(model.problem, task.spec, gap, task.search.left_s, objective_scale(task.site))
    known.note("modes", outcome)
    if not outcome.status.has_answer:
        known.prove(outcome)
        return False
    known.bound_by(outcome.bound)
    served = np.asarray(model.v.x_served.value) > 0.5
    binaries = [v for v in model.problem.variables() if v.attributes["boolean"]]
    modes = {v.name(): np.round(v.value) for v in binaries if v.name() != "x_served"}
    known.keep(cheapest_with_modes(task, served, modes))
    return outcome.status == Status.OPTIMAL
