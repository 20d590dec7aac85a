"""Commercial solvers with size-limited free licences, which the benchmarks compare with."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from vppres.solve.result import Status
from vppres.solve.solvers import SOLVERS, Interface, SolverSpec


def _gurobi_slack(solved: cp.Problem) -> float:
    return float(solved.solver_stats.extra_stats.ObjVal - solved.solver_stats.extra_stats.ObjBound)


def _copt_slack(solved: cp.Problem) -> float:
    return float(solved.solver_stats.extra_stats.objval - solved.solver_stats.extra_stats.bestbnd)


def _no_bound(solved: cp.Problem) -> float:
    """Cvxpy hands on no bound of Xpress."""
    return np.nan


def _ended_with_values(solved: cp.Problem) -> Status:
    return Status.TIME_LIMIT if solved.variables()[0].value is not None else Status.NO_ANSWER


LICENSED: dict[str, SolverSpec] = {
    spec.name: spec
    for spec in (
        SolverSpec(
            "gurobi",
            cp.GUROBI,
            True,
            Interface(
                lambda gap, s: {"MIPGap": 0.0, "MIPGapAbs": gap, "TimeLimit": s, "Threads": 1},
                _gurobi_slack,
                _ended_with_values,
            ),
        ),
        SolverSpec(
            "copt",
            cp.COPT,
            True,
            Interface(
                lambda gap, s: {"RelGap": 0.0, "AbsGap": gap, "TimeLimit": s, "Threads": 1},
                _copt_slack,
                _ended_with_values,
            ),
        ),
        SolverSpec(
            "xpress",
            cp.XPRESS,
            True,
            Interface(
                lambda gap, s: {
                    "miprelstop": 0.0,
                    "mipabsstop": gap,
                    "maxtime": int(max(s, 1)),
                    "threads": 1,
                },
                _no_bound,
                _ended_with_values,
            ),
        ),
    )
}
"""By name, on one thread as the others are."""

ALL_SOLVERS = SOLVERS | LICENSED
"""The package's solvers, and these."""
