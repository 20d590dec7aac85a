"""Compiled constraints have the numbers that cvxpy gives them; solvers' statuses are honest."""

from __future__ import annotations

import tracemalloc
from functools import partial

import cvxpy as cp
import numpy as np
import pytest

from tests.support.small_windows import DARK, OPEN, two_buses, window
from vppres.core.errors import NumericalError
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import ModelCache
from vppres.solve.compiled import affine, joined
from vppres.solve.forms import Form, window_problem
from vppres.solve.result import Status
from vppres.solve.solvers import find_solver, run, run_by_cvxpy, run_conic


@pytest.mark.parametrize(
    ("kind", "joins"),
    [("equal", False), ("most", False), ("equal", True), ("most", True), ("cone", True)],
)
def test_a_constraint_has_cvxpys_values_whatever_its_parameters(kind: str, joins: bool) -> None:
    x, y = cp.Variable((2, 3), nonneg=True), cp.Variable(2)
    price, most = cp.Parameter(3, nonneg=True), cp.Parameter(nonneg=True)
    left = x @ price - 2.0 * y
    constraint = {
        "equal": left == most,
        "most": left <= most * np.ones(2),
        "cone": cp.SOC(most * np.ones(2), cp.vstack([x @ price, y]), axis=0),
    }[kind]
    found = affine(joined([constraint]) if joins else constraint)
    rng = np.random.default_rng(0)
    for leaf in (x, y, price, most):
        leaf.save_value(rng.uniform(0.5, 1.5, leaf.shape))
    values = np.ones(found.width)
    for parameter, first in found.parameters:
        values[first : first + parameter.size] = np.ravel(parameter.value, order="F")
    columns = np.zeros(found.rows.shape[1] + 1)
    columns[-1] = -1.0
    for leaf in (x, y):
        first = found.first[leaf.id]
        columns[first : first + leaf.size] = np.ravel(leaf.value, order="F")
    rows = np.zeros(found.rows.shape[0])
    np.add.at(rows, found.rows.row, (found.rows.by @ values) * columns[found.rows.column])
    if kind == "cone":
        inside = np.stack([most.value * np.ones(2), x.value @ price.value, y.value])
        np.testing.assert_allclose(-rows.reshape(2, 3).T, inside)
    else:
        np.testing.assert_allclose(rows, left.value - most.value)


def test_products_of_many_parameters_take_memory_by_their_number() -> None:
    """Demand of 4,000 customers: cvxpy's own products would take the square of it, 130 MB."""
    demand, x = cp.Parameter((2, 2000)), cp.Variable((2, 2000))
    tracemalloc.start()
    product = cp.multiply(np.full(x.shape, 0.5), cp.multiply(x[:, ::-1], 4.0 * demand))
    found = affine(joined([product <= demand]))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20e6
    demand.value, x.value = (np.random.default_rng(n).uniform(size=x.shape) for n in (0, 1))
    values = found.rows.by @ np.append(np.ravel(demand.value, order="F"), 1.0)
    columns = np.append(np.ravel(x.value, order="F"), -1.0)
    rows = np.bincount(found.rows.row, values * columns[found.rows.column])
    np.testing.assert_allclose(
        rows, np.ravel(demand.value * (2.0 * x.value[:, ::-1] - 1.0), order="F")
    )


def test_whole_numbers_and_how_searches_end() -> None:
    """A knapsack of 4 and 3 and 3 in 6: both threes."""
    x = cp.Variable(3, boolean=True)
    room = cp.Parameter(nonneg=True, value=6.0)
    size = np.array([4.0, 3.0, 3.0])
    problem = cp.Problem(cp.Maximize(size @ x), [size @ x <= room])
    spec = find_solver("scip")
    asked = partial(run_by_cvxpy, spec=spec, gap_abs=0.0, time_s=10.0)
    outcome = asked(problem)
    assert (outcome.status, outcome.value, outcome.bound) == (Status.OPTIMAL, 6.0, 6.0)
    np.testing.assert_allclose(x.value, [0.0, 1.0, 1.0], atol=1e-9)
    other = cp.Problem(cp.Maximize(size @ x), [size @ x <= room, cp.sum(x) >= 4.0])
    assert asked(other).status == Status.INFEASIBLE
    y = cp.Variable()
    endless = cp.Problem(cp.Maximize(y), [y >= 0.0])
    assert asked(endless).status in (Status.UNBOUNDED, Status.INFEASIBLE)


@pytest.fixture
def day() -> Scenario:
    return two_buses([[5.0], [5.0]], [1.0], [OPEN, DARK])


@pytest.mark.parametrize("solver", ["highs", "clarabel"])
def test_what_is_no_number_is_refused(solver: str, day: Scenario) -> None:
    site, data = Site.of(day), window(day)
    conic = solver == "clarabel"
    form = Form(service="relaxed", exclusivity="relaxed", network=conic)
    problem = window_problem(ModelCache(site), data, form, conic)
    for wrong in (np.nan, np.inf):
        problem.fill(data)
        problem.values[problem.sheet._parameters[problem.statement.p.P_load.id]] = wrong
        with pytest.raises(NumericalError, match="not finite"):
            if conic:
                run_conic(problem, 10.0)
            else:
                run(problem, find_solver("highs"), 0.0, 10.0)
