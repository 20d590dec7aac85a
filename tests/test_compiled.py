"""Compiled problems give solvers the numbers that cvxpy gives them, and variables its values."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import NumericalError
from vppres.model.forms import Form, WindowModel
from vppres.model.objective import MOST_SQUARES, listed, weighted_squares
from vppres.model.site import Site
from vppres.model.tie_breakers import TieBreakerModel
from vppres.solve import compiled
from vppres.solve.compiled import COMPILER, Compiled, compiled_for, is_compiled
from vppres.solve.fleet.relaxation import AggregateModel
from vppres.solve.interior_points import CLARABEL_INTERFACE
from vppres.solve.result import Status
from vppres.solve.solvers import find_solver, run, run_conic

STEPS = 2


def tie_breakers(site: Site) -> cp.Problem:
    return TieBreakerModel(site, STEPS, curtailing=True, physical=True, moves=True).problem


def network_cost(site: Site) -> cp.Problem:
    return WindowModel(site, STEPS, Form("cost", "fixed", "relaxed", 0)).problem


def whole_numbers(site: Site) -> cp.Problem:
    """Binaries, a whole number that is none, bounds."""
    return AggregateModel(site, STEPS).grid_problem


def modes(site: Site) -> cp.Problem:
    return WindowModel(site, STEPS, Form("service", "integer", "integer", network=False)).problem


def filled(problem: cp.Problem, seed: int) -> cp.Problem:
    """With parameters drawn at random, some of them zero."""
    draw = np.random.default_rng(seed)
    for parameter in problem.parameters():
        parameter.value = np.maximum(draw.random(parameter.shape) - 0.2, 0.0)
    return problem


KINDS: list[tuple[Callable[[Site], cp.Problem], Any]] = [
    (tie_breakers, CLARABEL_INTERFACE),
    (network_cost, CLARABEL_INTERFACE),
    (whole_numbers, cp.HIGHS),
    (modes, cp.HIGHS),
]


@pytest.mark.parametrize(("make", "interface"), KINDS)
def test_other_parameters_give_the_numbers_that_cvxpy_gives(
    make: Callable[[Site], cp.Problem], interface: Any
) -> None:
    problem = filled(make(Site.of(tiny_scenario())), seed=1)
    known = Compiled(problem, interface)
    data, _, _ = filled(problem, seed=2).get_problem_data(interface, canon_backend=COMPILER)
    ours = known.numbers()
    np.testing.assert_array_equal(ours.cost, data["c"])
    np.testing.assert_array_equal(ours.limit, data["b"])
    squares = (
        sp.csc_array(sp.triu(data["P"])) if "P" in data else sp.csc_array((len(ours.cost),) * 2)
    )
    for one, other in ((ours.rows, data["A"]), (ours.squares, squares)):
        for part in ("indptr", "indices", "data"):
            np.testing.assert_array_equal(getattr(one, part), getattr(other, part))


@pytest.mark.parametrize(("make", "interface"), KINDS)
def test_variables_get_the_values_that_cvxpy_gives_them(
    make: Callable[[Site], cp.Problem], interface: Any
) -> None:
    problem = filled(make(Site.of(tiny_scenario())), seed=1)
    known = Compiled(problem, interface)
    _, chain, inverse = problem.get_problem_data(interface, canon_backend=COMPILER)
    draw = np.random.default_rng(3)
    x = draw.normal(size=len(known.x_lower))  # below zero, no whole numbers: cvxpy mends both
    solution = cp.reductions.Solution(cp.OPTIMAL, 0.0, {inverse[-1]["var_id"]: x}, {}, {})
    for reduction, how in reversed(list(zip(chain.reductions, inverse, strict=True))[:-1]):
        solution = reduction.invert(solution, how)
    known.put(x)
    for variable in problem.variables():
        np.testing.assert_array_equal(variable.value, solution.primal_vars[variable.id])


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
    assert is_compiled(problem, cp.HIGHS) and not is_compiled(problem, CLARABEL_INTERFACE)
    assert compiled_for(problem, CLARABEL_INTERFACE) is not known
    assert len(compiled._KEPT) == before + 1
    del problem, x
    gc.collect()
    assert len(compiled._KEPT) == before


@pytest.mark.parametrize("curtailing", [False, True])
def test_tie_breakers_are_compiled_without_further_variables(curtailing: bool) -> None:
    problem = TieBreakerModel(Site.of(tiny_scenario()), STEPS, curtailing).problem
    known = Compiled(filled(problem, seed=1), CLARABEL_INTERFACE)
    assert len(known.numbers().cost) == sum(v.size for v in problem.variables())


def test_very_many_squares_are_the_same_sum_with_variables_of_their_own() -> None:
    weight = np.array([1.0, 0.5, 2.0])
    few, many = cp.Variable((4, 3)), cp.Variable((MOST_SQUARES, 3))
    for x, own in ((few, 0), (many, many.size)):
        x.value = np.linspace(-1.0, 1.0, x.size).reshape(x.shape)
        found = weighted_squares(weight, x)
        assert found.value == pytest.approx(float(np.sum(weight * x.value**2)))
        known = Compiled(cp.Problem(cp.Minimize(found), [x >= 1.0]), CLARABEL_INTERFACE)
        assert len(known.numbers().cost) == x.size + own


def test_very_many_squares_of_a_list_need_no_variables() -> None:
    """A list's entries stand where those of the variable would, and have its weights."""
    weight = np.array([1.0, 0.5, 0.0])
    x = listed(cp.Variable((MOST_SQUARES, 3), name="x"))
    (entries,) = x.variables()
    entries.value = np.linspace(-1.0, 1.0, x.size)
    found = weighted_squares(weight, x)
    assert found.value == pytest.approx(float(np.sum(weight * x.value**2)))
    known = Compiled(cp.Problem(cp.Minimize(found), [x >= 1.0]), CLARABEL_INTERFACE).numbers()
    assert len(known.cost) == x.size
    assert known.squares.diagonal() == pytest.approx(2.0 * np.repeat(weight, MOST_SQUARES))
    assert isinstance(listed(cp.Variable((4, 3))), cp.Variable)
