"""HiGHS and Clarabel asked with the numbers of selections, as cvxpy asks them.

The model, the options and their order are those of cvxpy's interfaces, and so are the answers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import clarabel
import cvxpy as cp
import highspy
import numpy as np
import scipy.sparse as sp
from cvxpy.reductions.solvers.conic_solvers.clarabel_conif import CLARABEL
from cvxpy.reductions.solvers.conic_solvers.highs_conif import HIGHS
from cvxpy.settings import SOLUTION_PRESENT

from vppres.core.arrays import Flags, Floats
from vppres.solve.programs import begin_with, program_of, stacked
from vppres.solve.selection import Selected

LARGEST_FACTOR = 1e6
"""Largest factor in an objective that interior points get as it is: in strict order they are up to
1e11, and from 1e9 on Clarabel calls problems unbounded that have a solution."""


class Start(NamedTuple):
    """What a search begins with: values of binaries, in their shape, by their letter."""

    letter: str
    values: Flags


def solve_by_highs(
    selected: Selected, options: Mapping[str, Any], start: Start | None = None
) -> tuple[str, Any, float]:
    """Solve a problem without cones: cvxpy's word for how it ended, HiGHS's figures, the least.

    A search begins with the values of ``start``.

    Raises
    ------
    ValueError
        If HiGHS does not know an option.
    NumericalError
        If a coefficient is not finite.
    """
    solver = highspy.Highs()
    solver.setOptionValue("log_to_console", False)
    for name, value in options.items():
        if solver.setOptionValue(name, value) == highspy.HighsStatus.kError:
            raise ValueError(f"HiGHS does not take {value!r} for its option {name}.")
    program = program_of(selected)
    if selected.added is not None:
        matrix, least = selected.added
        program = program.with_rows(sp.csc_array(selected.shown(matrix)), least)
    solver.passModel(program.model)
    if start is not None:
        begin_with(solver, selected.at(start.letter), start.values)
    solver.run()
    word = HIGHS.STATUS_MAP.get(solver.getModelStatus().name, cp.SOLVER_ERROR)
    if word in SOLUTION_PRESENT:
        selected.put(np.array(solver.getSolution().col_value))
    info = solver.getInfo()
    return word, info, info.objective_function_value + selected.offset


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
