"""The stages without the network: relaxations of growing size, each with its bound.

The proofs are in ``docs/method.md``, *Why the bounds hold*.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING, objective_scale
from vppres.solve.dispatch import cheapest, keep_dispatch
from vppres.solve.forms import Form, window_problem
from vppres.solve.programs import GAP_SHARE
from vppres.solve.result import Status
from vppres.solve.solvers import run
from vppres.solve.task import WindowTask


def everyone_served(task: WindowTask) -> None:
    """Supply all customers and curtail nothing: if that is feasible, no search is needed."""
    keep_dispatch(task, np.ones(task.data.load_kw.shape, dtype=bool))
    best = task.certificate.best
    if best is not None and task.everyone - best.service <= ROUNDING * task.everyone:
        smallest = task.site.customers.weight.min() * task.site.dt_h
        task.certificate.everyone_is_served(task.everyone, smallest)


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


def keep_a_steady_set(task: WindowTask) -> None:
    """An answer by rule, if switching rules left the searches none in their time."""
    for served in steady_sets(task.data):
        if task.certificate.answered:
            return
        keep_dispatch(task, served, network=True)


def steady_sets(data: WindowData) -> Iterator[Flags]:
    """Supply schedules (W, C) of hardly any actions, from the one of most service down.

    All customers are supplied throughout, or until power is first limited, or never. A customer
    whose rules forbid that stays as before the window, or takes the first of the others that they
    allow.
    """
    rules = data.switching
    if rules is None:
        return
    shape = data.load_kw.shape
    limited = np.flatnonzero(np.isfinite(data.grid_limit_kw))
    always = np.ones(shape, dtype=bool)
    until = always.copy()
    until[limited[0] if len(limited) else 0 :] = False
    as_before = np.tile(rules.served_before, (shape[0], 1))
    for wanted in (always, until, ~always):
        found = wanted.copy()
        for other in (always, until, ~always, as_before):
            broken = rules.broken(found)
            allowed = broken & ~rules.broken(other)
            found[:, allowed] = other[:, allowed]
        yield found
