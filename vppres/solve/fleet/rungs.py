"""The lower rungs of the ladder: relaxations without the network, each with its bound.

The proofs are in ``docs/method.md``, *Why a bound bounds*.
"""

from __future__ import annotations

from collections.abc import Callable

import cvxpy as cp
import numpy as np

from vppres.model.forms import Form
from vppres.model.numerics import objective_scale
from vppres.solve.blocks import BLOCKS_SHARE, SOON_SHARE, BlockSearch
from vppres.solve.certificate import cost_gap_gbp
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.dispatch import (
    cheapest_with_modes,
    keep_dispatch,
    window_model,
    with_tie_breakers,
)
from vppres.solve.fleet.masters import (
    Master,
    fleets_of,
    least_cost_one_way,
    relaxation_of,
    search_for_set,
)
from vppres.solve.fleet.matching import exchanged
from vppres.solve.fleet.modes import modes_apart
from vppres.solve.fleet.relaxation import AggregateModel
from vppres.solve.fleet.steady import steady_sets
from vppres.solve.programs import compiled
from vppres.solve.result import Status
from vppres.solve.solvers import compiled_in_time, run
from vppres.solve.task import COST_SHARE, WindowTask

NOTHING_LOST = 1e-6
"""Share of the gap by which the service of everyone may be missed: rounding of its sum."""

ALL_TERMS_GAP_SHARE = 0.8
"""Share of the window's gap that the search with all terms at once may leave open: the levels after
it need little."""

MODES_GAP_SHARE = 0.5
"""The same of the search with the modes of all batteries, which also leaves cost to its gap."""

AGAIN = 0.999
"""Share of a gap below which another search to the smaller gap can tell anything new."""

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


def all_terms(task: WindowTask) -> None:
    """Served set and bound of the relaxation with all terms as weighted, to the gap of F.

    It needs no grid of weights or prices.
    """
    _to_its_gap(task, task.gap_so_far, _search_all_terms)


def _to_its_gap(task: WindowTask, gap: float, search: Callable[[WindowTask, float], bool]) -> None:
    """Search to a gap, and again where the answer says that it was more than there is."""
    if search(task, gap) and task.goes_on and task.gap_to_best < AGAIN * gap:
        search(task, task.gap_to_best)


def _search_all_terms(task: WindowTask, gap: float) -> bool:
    """One search with all terms to its share of a gap; whether it ended, or need not be.

    With switching rules one that does not end soon begins again with a better set.
    """
    model = relaxation_of(task.cache, task.data, integer=True, lumped=fleets_of(task.data)[0])
    model.fill(task.data)
    gap = ALL_TERMS_GAP_SHARE * gap
    if task.data.switching is not None:
        ended = _search_set(task, model, gap, task.search.part(SOON_SHARE))
        if ended or task.certificate.nothing_to_find:
            return ended
        _improve_in_blocks(task, model)
        if task.certificate.certified:
            return True
    return _search_set(task, model, gap, task.search)


def _search_set(task: WindowTask, model: AggregateModel, gap: float, deadline: Deadline) -> bool:
    """Search the best set with all terms, to a gap or a deadline; whether it ended."""
    known = task.certificate
    scale = objective_scale(task.site)
    first = None if known.best is None else known.best.dispatch.served
    options = None if task.data.switching is None else task.spec.with_rules
    outcome = search_for_set(
        model, model.problem, task.spec, gap, deadline.left_s, scale, first, options
    )
    known.note("aggregate", outcome)
    if not outcome.status.has_answer:
        known.prove(outcome)
        return False
    known.bound_by(outcome.bound)
    keep_dispatch(task, np.asarray(model.x.value) > 0.5)
    return outcome.status == Status.OPTIMAL


def _improve_in_blocks(task: WindowTask, model: AggregateModel) -> None:
    """Improve the best set so far a few steps at a time, or one that the rules allow at once."""
    known = task.certificate
    rules = task.data.switching
    assert rules is not None and model.switching is not None
    if not compiled_in_time(model.problem, cp.HIGHS, task.search):
        return
    watch = Stopwatch()
    program, first = compiled(model.problem)
    service, *follow = (
        (first[v.name()] + np.arange(v.size)).reshape(v.shape, order="F")
        for v in (model.x, *model.switching.follow)
    )
    gap = task.gap_so_far * objective_scale(task.site)
    deadline = task.search.part(BLOCKS_SHARE)
    blocks = BlockSearch(program, service, follow, rules, gap, deadline)
    best = known.best
    found = blocks.improved(
        steady_sets(task.site, task.data) if best is None else [best.dispatch.served]
    )
    if found is not None:
        known.note("blocks", found.outcome(watch.spent_s))
        keep_dispatch(task, found.x[service] > 0.5)


def shares(task: WindowTask) -> None:
    """Bound by shares of customers, which says how large the objective is."""
    _by_shares(task, "shares")


def _by_shares(task: WindowTask, stage: str) -> AggregateModel | None:
    """Bound by shares of customers, all terms as weighted; the solved model, if it has one."""
    known = task.certificate
    model = relaxation_of(task.cache, task.data, integer=False, lumped=fleets_of(task.data)[0])
    model.fill(task.data)
    outcome = run(model.problem, task.spec, 0.0, task.search.left_s, objective_scale(task.site))
    known.note(stage, outcome)
    if outcome.status != Status.OPTIMAL:
        known.prove(outcome)
        return None
    known.bound_by(outcome.bound)
    return model


def matched(task: WindowTask) -> None:
    """Customers whose demand takes up the sun of a dark step, bounded by shares of customers."""
    model = _by_shares(task, "matched")
    if model is None:
        return
    data = task.data
    site = task.site
    able = model.p["x_max"].value[0] > 0.5
    given_kw = float(np.minimum(data.pv_kw[0], site.pv.s_max_kva).sum() - data.network_kw[0])
    worth = site.customers.weight + site.weights.lambda_curt * data.load_kw[0]
    keep_dispatch(task, exchanged(worth * able, data.load_kw[0], given_kw)[None, :])


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
    gap = task.gap_to_best
    if outcome.status == Status.OPTIMAL:
        known.bound_by(outcome.bound)
        gap = task.limits.gap_at(known.bound)
        _one_battery_at_a_time(task, outcome.bound, gap)
    if not task.goes_on:
        return
    _to_its_gap(task, gap, _search_modes)


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
    """One search for set and modes to its share of a gap; whether it ended."""
    known = task.certificate
    form = Form("service", "integer", "integer", network=False)
    model = window_model(task.cache, task.data, form)
    model.fill(task.data)
    gap = MODES_GAP_SHARE * gap
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
