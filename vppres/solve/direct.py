"""HiGHS and Clarabel asked with the numbers of selections; Clarabel as cvxpy asks it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import CLARABEL
from cvxpy.settings import SOLUTION_PRESENT

from vppres.core.arrays import Flags, Floats
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.programs import DIRECT, ProgramSolution, begin_with, program_of, stacked
from vppres.solve.result import Outcome
from vppres.solve.selection import Selected

LARGEST_FACTOR = 1e6
"""Largest factor in an objective that interior points get as it is: in strict order they are up to
1e11, and from 1e9 on Clarabel calls problems unbounded that have a solution."""


def solve_by_highs(
    selected: Selected,
    deadline: Deadline,
    gap_abs: float = 0.0,
    more: Mapping[str, Any] = MappingProxyType({}),
    first: Flags | None = None,
    held: Mapping[str, Floats] = MappingProxyType({}),
) -> Outcome:
    """Solve a problem without cones, with options ``more`` of HiGHS.

    A search begins with the supply schedule ``first``. Letters of ``held`` have their values.

    Raises
    ------
    NumericalError
        If a coefficient is not finite.
    """
    watch = Stopwatch()
    program = program_of(selected)
    if selected.added is not None:
        matrix, least = selected.added
        program = program.with_rows(sp.csc_array(selected.shown(matrix)), least)
    for name, values in held.items():
        program = program.with_held(selected.at(name), values)
    solver = program.loaded(gap_abs, more=more)
    if first is not None:
        begin_with(solver, selected.at("x_served"), first)
    found = ProgramSolution.of(solver, deadline)
    if not found.status.has_answer:
        return Outcome(found.status, np.nan, np.nan, watch.spent_s, DIRECT)
    selected.put(found.x)
    sign = -1.0 if selected.maximises else 1.0
    value, bound = (sign * (each + selected.offset) for each in (found.value, found.bound))
    return Outcome(found.status, value, bound, watch.spent_s, DIRECT)


def _cones(dims: Any) -> list[Any]:
    """Clarabel's names of the kinds of rows."""
    zero = [clarabel.ZeroConeT(dims.zero)] if dims.zero else []
    nonneg = [clarabel.NonnegativeConeT(dims.nonneg)] if dims.nonneg else []
    return [*zero, *nonneg, *(clarabel.SecondOrderConeT(size) for size in dims.soc)]


def solve_by_clarabel(selected: Selected, options: Mapping[str, Any]) -> str:
    """Solve a continuous problem with cones; cvxpy's word for how it ended.

    Raises
    ------
    NumericalError
        If a coefficient is not finite.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, value in options.items():
        setattr(settings, name, value)
    numbers = selected.numbers()
    rows, limit, cones = numbers.rows, numbers.limit, _cones(selected.dims)
    if selected.added is not None:
        matrix, least = selected.added
        more = sp.csc_array(-selected.shown(matrix))
        rows, limit = stacked(rows, more), np.append(limit, -least)
        cones.append(clarabel.NonnegativeConeT(len(least)))
    size = max(float(np.abs(numbers.cost).max(initial=0.0)) / LARGEST_FACTOR, 1.0)
    squares, cost = numbers.squares / size, numbers.cost / size
    solver = clarabel.DefaultSolver(squares, cost, rows, limit, cones, settings)
    found = solver.solve()
    word: str = CLARABEL.STATUS_MAP.get(str(found.status), cp.SOLVER_ERROR)
    if word in SOLUTION_PRESENT:
        x: Floats = np.array(found.x)
        selected.put(x)
        selected.duals = np.array(found.z) * size
    return word
