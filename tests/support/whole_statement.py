"""A window's whole problem as the page states it, by cvxpy and SCIP: nothing of ``vppres.solve``.

Ratings of lines are cones of all lines in all steps here, which plans make row by row.
"""

from __future__ import annotations

from typing import NamedTuple

import cvxpy as cp
import numpy as np

from vppres.model.beyond_paper.ratings import LineRatings
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.statement import Statement

FACTORS = {"f1": 1.0, "f6": -1.0, "f7": 1.0, "own": 1.0}


class Whole(NamedTuple):
    """The best schedule that was found and what none exceeds, without tie-breakers; -inf: none."""

    value: float
    bound: float


def whole_problem(site: Site, data: WindowData, time_s: float = 60.0) -> Whole:
    """The optimum of a window, as near as the time allows."""
    rated = LineRatings.shape(site, data)
    beyond = (*beyond_paper(site, data), *(((LineRatings, rated),) if rated else ()))
    statement = Statement(site, data.n_steps, beyond)
    statement.write(data)
    w = site.weights
    factors = FACTORS | {"f2": -w.lambda_grid, "f3": -w.lambda_curt}
    F = sum(factors[name] * term for name, term in statement.terms.items())
    # Cost weighs so little that SCIP would stop before it counts.
    scale = 1e3 / float(site.customers.weight.max())
    problem = cp.Problem(cp.Maximize(scale * F), list(statement.families.values()))
    limits = {"limits/time": time_s, "limits/absgap": 1e-5 * scale, "limits/gap": 0.0}
    try:
        problem.solve(solver=cp.SCIP, scip_params=limits)
    except cp.SolverError:
        return Whole(-np.inf, np.inf)
    if problem.value is None or not np.isfinite(problem.value):
        return Whole(-np.inf, -np.inf if problem.status == cp.INFEASIBLE else np.inf)
    value = float(problem.value) / scale
    done = problem.status == cp.OPTIMAL
    return Whole(value, value + 1e-5 if done else np.inf)
