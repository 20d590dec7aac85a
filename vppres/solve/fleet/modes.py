"""Modes of batteries, one battery at a time: what each proves at the prices of what all share.

Where more sun shines than anybody can use, batteries charge and discharge in turns to lose energy.
Each is free to choose its turns, and nothing joins them but balances; a search of all together
multiplies their branches. ``docs/method.md``, *Sun that nobody can use*.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.forms import WindowModel
from vppres.model.numerics import objective_scale
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.network.feeders import SEARCH, SHARED, Effort, Feeders
from vppres.solve.network.rows import Rows
from vppres.solve.programs import (
    DIRECT,
    NO_JUMPS,
    SUMS_KEPT,
    Program,
    ProgramSolution,
    columns_of,
    compiled,
    with_sums,
)
from vppres.solve.result import Outcome, Status
from vppres.solve.task import WindowTask

TIME_SHARE = 0.4
"""Share of the time left that the searches of batteries may take."""

EFFORT = Effort(most_lost=100.0, nodes=2000, gap=0.02, least_cut=0.01, room=1e-4, options=SEARCH)
"""How each battery is searched, in parts of the window's gap: nearly to the end."""

SET_GAP = 0.5
"""Part of the window's gap that the search with all cuts may leave open."""

SEARCH_OF_MODES = MappingProxyType(
    {
        **NO_JUMPS,
        "mip_heuristic_run_rens": False,
        "mip_heuristic_run_root_reduced_cost": False,
        "mip_allow_restart": False,
        "presolve_rule_off": SUMS_KEPT,
    }
)
"""Options of the search for set and modes. Of HiGHS's problems within the problem the one round its
best answer (RINS) is kept: without it searches take 1.4 times as long, with all of them 1.7."""

ROUNDS = 3
"""How often batteries are searched, each time at the prices of the cuts before: later rounds add
little, and many search in vain."""

SAME = 1e-6
"""Relative difference up to which two linear problems have the same optimum."""


@dataclass(frozen=True, eq=False)
class Apart:
    """What came of it: value and bound of F, who is served, and binaries by their names."""

    outcome: Outcome
    served: Flags | None
    modes: Mapping[str, Floats]


def modes_apart(task: WindowTask, model: WindowModel, relaxed: float, gap: float) -> Apart | None:
    """A bound by a cut of each battery, and set and modes of a search with these cuts.

    Parameters
    ----------
    task : WindowTask
        The window.
    model : WindowModel
        The whole problem without the network, filled.
    relaxed : float
        Its optimum without binaries.
    gap : float
        The window's gap.

    Returns
    -------
    Apart or None
        None where the problem without binaries is not what it is taken for, or time is up.
    """
    watch = Stopwatch()
    end = task.search.part(TIME_SHARE)
    unit = gap * objective_scale(task.site)
    plain, first = compiled(model.problem)
    program = _bounded(task, replace(plain, cost=plain.cost / unit), first)
    linear = ProgramSolution.of(program.by_shares().loaded(), end)
    alike = abs(-linear.value * gap - relaxed) <= SAME * max(abs(relaxed), 1.0)
    if linear.status != Status.OPTIMAL or not alike:
        return None
    places = _columns(task, first, "delta")
    battery = _battery_of_columns(task, first, program)
    program, linear = _with_cuts(program, linear, battery, places.ravel(), end)
    by_cuts = -linear.value * gap if linear.status == Status.OPTIMAL else relaxed
    bound = min(by_cuts, task.certificate.bound)
    enough = SET_GAP - bound / gap
    counted = with_sums(program, list(places.T))
    options = SEARCH_OF_MODES if task.data.switching is None else {}
    search = counted.loaded(SET_GAP, enough=enough, more=options)
    answer = ProgramSolution.of(search, task.search)
    if np.isfinite(answer.bound):
        bound = min(bound, -answer.bound * gap)
    if not answer.status.has_answer:
        return Apart(Outcome(answer.status, np.nan, bound, watch.spent_s, DIRECT), None, {})
    # What is within the gap of a bound that was known before has ended the search too.
    status = Status.OPTIMAL if answer.value <= enough else answer.status
    outcome = Outcome(status, -answer.value * gap, bound, watch.spent_s, DIRECT)
    binaries = {
        v.name(): np.round(answer.x[columns_of(first, v.name(), v.shape)])
        for v in model.problem.variables()
        if v.attributes["boolean"] and v.name() in first
    }
    served = binaries.pop("x_served") > 0.5
    return Apart(outcome, served, binaries)


def _columns(task: WindowTask, first: Mapping[str, int], name: str) -> Wholes:
    """Columns of a variable of batteries; energies have a row more than the window has steps."""
    rows = task.data.n_steps + (name == "SoC")
    return columns_of(first, name, (rows, len(task.site.batteries)))


def _bounded(task: WindowTask, program: Program, first: Mapping[str, int]) -> Program:
    """The program with the limits of batteries and binaries as bounds, which prices ask for."""
    lower = program.x_lower.copy()
    upper = program.x_upper.copy()
    limits = {
        "P_ch": task.site.batteries.active_max_kw,
        "P_dch": task.site.batteries.active_max_kw,
        "SoC": np.ones(len(task.site.batteries)),
    }
    for name, most in limits.items():
        columns = _columns(task, first, name)
        lower[columns] = np.maximum(lower[columns], 0.0)
        upper[columns] = np.minimum(upper[columns], most)
    lower[program.integer] = np.maximum(lower[program.integer], 0.0)
    upper[program.integer] = np.minimum(upper[program.integer], 1.0)
    return replace(program, x_lower=lower, x_upper=upper)


def _battery_of_columns(task: WindowTask, first: Mapping[str, int], program: Program) -> Wholes:
    """Battery of each column, ``SHARED`` where it has none."""
    battery = np.full(len(program.cost), SHARED)
    for name in ("P_ch", "P_dch", "SoC", "delta"):
        battery[_columns(task, first, name)] = np.arange(len(task.site.batteries))
    return battery


def _with_cuts(
    program: Program, linear: ProgramSolution, battery: Wholes, modes: Wholes, end: Deadline
) -> tuple[Program, ProgramSolution]:
    """A program and its linear solution with cuts of batteries more, as long as there are any."""
    for _ in range(ROUNDS):
        if linear.status != Status.OPTIMAL:
            break
        batteries = Feeders(program.by_shares(), linear, battery, modes)
        cuts = []
        for number in batteries.fractional:
            if end.passed:
                break
            found = batteries.search(int(number), end, EFFORT)
            cuts += [] if found.cut is None else [found.cut]
        if not cuts:
            break
        rows = Rows.joined(cuts)
        program = program.with_range(rows.matrix.tocsc(), rows.lower, rows.upper)
        linear = ProgramSolution.of(program.by_shares().loaded(), end)
    return program, linear
