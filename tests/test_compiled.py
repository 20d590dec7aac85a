"""Compiled problems give solvers the numbers that cvxpy gives them, and variables its values."""

from __future__ import annotations

import gc

import cvxpy as cp
import numpy as np
import pytest

from vppres.core.errors import NumericalError
from vppres.solve import compiled
from vppres.solve.compiled import compiled_for, is_compiled
from vppres.solve.result import Status
from vppres.solve.solvers import find_solver, run, run_conic

STEPS = 2


@pytest.mark.parametrize(("solver", "square"), [("highs", 0), ("clarabel", 0), ("clarabel", 1)])
def test_solved_as_by_cvxpy(solver: str, square: int) -> None:
    """The same answers bit for bit, whatever was solved before."""
    x = cp.Variable((2, 3), nonneg=True, name="x")
    price = cp.Parameter(3, nonneg=True)
    most = cp.Parameter(nonneg=True)
    total = price @ cp.sum(x, axis=0) + (cp.sum_squares(x) if square else 0.0)
    problem = cp.Problem(cp.Minimize(total), [cp.sum(x) >= most, x <= 0.7 * most])
    for prices in ([1.0, 2.0, 3.0], [3.0, 1.0, 2.0]):
        price.value = np.array(prices)
        most.value = 1.0 + prices[0]
        outcome = (
            run(problem, find_solver("highs"), 0.0, 10.0)
            if solver == "highs"
            else run_conic(problem, 10.0)
        )
        ours = np.array(x.value)
        options = {} if solver == "highs" else {"iterative_refinement_enable": False}
        other = cp.Problem(problem.objective, problem.constraints)
        assert other.solve(solver=solver.upper(), **options) == outcome.value
        np.testing.assert_array_equal(ours, x.value)


def test_whole_numbers_and_how_searches_end() -> None:
    """A knapsack of 4 and 3 and 3 in 6: both threes."""
    x = cp.Variable(3, boolean=True)
    room = cp.Parameter(nonneg=True, value=6.0)
    size = np.array([4.0, 3.0, 3.0])
    problem = cp.Problem(cp.Maximize(size @ x), [size @ x <= room])
    spec = find_solver("highs")
    outcome = run(problem, spec, 0.0, 10.0)
    assert (outcome.status, outcome.value, outcome.bound) == (Status.OPTIMAL, 6.0, 6.0)
    assert x.value.tolist() == [0.0, 1.0, 1.0]
    other = cp.Problem(cp.Maximize(size @ x), [size @ x <= room, cp.sum(x) >= 4.0])
    assert run(other, spec, 0.0, 10.0).status == Status.INFEASIBLE
    y = cp.Variable()
    endless = cp.Problem(cp.Maximize(y), [y >= 0.0])
    assert run(endless, spec, 0.0, 10.0).status in (Status.UNBOUNDED, Status.INFEASIBLE)


@pytest.mark.parametrize("solver", ["highs", "clarabel"])
def test_what_is_no_number_is_refused(solver: str) -> None:
    x = cp.Variable(2)
    factor = cp.Parameter(2, value=np.array([1.0, 2.0]))
    squares = cp.sum_squares(x) if solver == "clarabel" else cp.sum(x)
    problem = cp.Problem(cp.Minimize(squares), [cp.multiply(factor, x) >= 1.0])
    for wrong in (np.nan, np.inf):
        factor.save_value(np.array([1.0, wrong]))
        with pytest.raises(NumericalError, match="not finite"):
            if solver == "highs":
                run(problem, find_solver("highs"), 0.0, 10.0)
            else:
                run_conic(problem, 10.0)


def test_kept_as_long_as_the_problem_and_for_its_interface() -> None:
    x = cp.Variable(2, nonneg=True)
    problem = cp.Problem(cp.Minimize(cp.sum(x)), [x >= 1.0])
    gc.collect()
    before = len(compiled._KEPT)
    known = compiled_for(problem, cp.HIGHS)
    assert compiled_for(problem, cp.HIGHS) is known
    assert is_compiled(problem, cp.HIGHS) and not is_compiled(problem, cp.CLARABEL)
    assert compiled_for(problem, cp.CLARABEL) is not known
    assert len(compiled._KEPT) == before + 1
    del problem, x
    gc.collect()
    assert len(compiled._KEPT) == before
