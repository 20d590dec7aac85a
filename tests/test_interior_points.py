"""What is compiled here in a fraction of cvxpy's time is what cvxpy itself compiles, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp

from benchmarks.instances import packaged
from vppres.model.constraints import at_buses
from vppres.model.forms import Form, WindowModel
from vppres.model.polygons import Polygon
from vppres.model.site import Site
from vppres.model.tie_breakers import TieBreakerModel
from vppres.solve.compiled import COMPILER
from vppres.solve.interior_points import CLARABEL_INTERFACE, places

STEPS = 2


def tie_breakers(site: Site) -> cp.Problem:
    """All there is: cones, squares, moves, export, losses."""
    return TieBreakerModel(
        site, STEPS, curtailing=True, physical=True, moves=True, exporting=True, ending=True
    ).problem


def network_cost(site: Site) -> cp.Problem:
    return WindowModel(site, STEPS, Form("cost", "fixed", "relaxed", 0)).problem


def polygons(site: Site) -> cp.Problem:
    return WindowModel(site, STEPS, Form("service", "relaxed", "relaxed", 16, outer=True)).problem


def exponential(site: Site) -> cp.Problem:
    """Cones that no problem of ours has are left to cvxpy."""
    x = cp.Variable(2)
    return cp.Problem(cp.Minimize(cp.sum(cp.exp(x))), [cp.norm(x) <= 1.0, x[0] == 0.5])


def data_of(problem: cp.Problem, interface: Any) -> dict[str, Any]:
    """What a solver gets, for parameters drawn at random."""
    draw = np.random.default_rng(5)
    for parameter in problem.parameters():
        parameter.value = draw.random(parameter.shape)
    data, _, _ = problem.get_problem_data(interface, canon_backend=COMPILER)
    return dict(data)


def assert_same(ours: dict[str, Any], cvxpys: dict[str, Any]) -> None:
    for name in ("A", "P", "b", "c"):
        one, other = ours.get(name), cvxpys.get(name)
        if sp.issparse(one):
            for part in ("indptr", "indices", "data"):
                np.testing.assert_array_equal(getattr(one, part), getattr(other, part), name)
        else:
            np.testing.assert_array_equal(one, other, name)


@pytest.mark.parametrize("make", [tie_breakers, network_cost, polygons, exponential])
def test_compiled_as_by_cvxpy(make: Callable[[Site], cp.Problem]) -> None:
    site = Site.of(packaged())
    assert_same(data_of(make(site), CLARABEL_INTERFACE), data_of(make(site), cp.CLARABEL))


def test_places_of_two_cones_after_an_equality() -> None:
    x = cp.Variable(2)
    equality = cp.constraints.Zero(x)
    cones = cp.SOC(cp.Variable(2), cp.Variable((2, 2)), axis=0)
    # cvxpy: radii 0 and 1, then the vectors; Clarabel: each radius before its vector.
    assert places([equality, cones]).tolist() == [0, 1, 2, 5, 3, 4, 6, 7]


def test_solved_as_by_cvxpy() -> None:
    """The farthest point of a disc of radius 5 along (3, 4) is (3, 4)."""
    x = cp.Variable(2)
    radius = cp.Parameter(nonneg=True, value=5.0)
    problem = cp.Problem(cp.Maximize(3 * x[0] + 4 * x[1]), [cp.norm(x) <= radius])
    assert problem.solve(solver=CLARABEL_INTERFACE) == pytest.approx(25.0)
    np.testing.assert_allclose(x.value, [3.0, 4.0], rtol=1e-6)


def test_parameters_are_placed_on_buses_as_variables_are() -> None:
    bus = sp.csr_array(([1.0, 1.0, 1.0], ([2, 0, 2], [0, 1, 2])), shape=(3, 3))
    load = cp.Parameter((2, 3), value=np.arange(6.0).reshape(2, 3))
    power = cp.Variable((2, 3))
    power.value = load.value
    by_hand = [[1.0, 0.0, 2.0], [4.0, 0.0, 8.0]]
    for what in (load, power):
        assert at_buses(bus, what).value.tolist() == by_hand


def test_a_polygon_has_a_block_of_rows_for_each_angle() -> None:
    polygon = Polygon.inscribed(8)
    p_kw = np.array([[1.0, -2.0], [0.5, 3.0]])
    q_kvar = np.array([[0.0, 1.0], [2.0, -1.0]])
    constraint = polygon.contains(cp.Constant(p_kw), cp.Constant(q_kvar), np.array([2.0, 4.0]))
    left, right = (np.asarray(arg.value) for arg in constraint.args)
    for k, angle in enumerate(polygon.angles):
        block = slice(2 * k, 2 * k + 2)
        by_hand = np.cos(angle) * p_kw + np.sin(angle) * q_kvar
        np.testing.assert_allclose(left[block], by_hand, atol=1e-15)
        np.testing.assert_allclose(right[block], polygon.reach * np.array([[2.0, 4.0]] * 2))
