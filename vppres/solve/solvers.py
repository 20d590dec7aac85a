"""The table of solvers: what each can do, how it takes limits, how its bound is read."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpy.reductions.solvers.solver import Solver

from vppres.core.errors import InputError, Problem
from vppres.solve.deadline import Deadline
from vppres.solve.interior_points import (
    CLARABEL_INTERFACE,
    CLARABEL_WITHOUT_DUALS,
    HIGHS_WITHOUT_DUALS,
)
from vppres.solve.result import Outcome, Status

COMPILER = cp.settings.COO_CANON_BACKEND
"""cvxpy's compiler back end; for problems with many parameters it takes a third of the default's
time, and the compiled problem is the same."""

INTERIOR_POINTS = "clarabel"
"""Solver of all continuous problems with cones or squares, whichever solver is chosen: those of the
table are for binaries, and HiGHS takes no cones."""

LEAST_S = 0.01
"""Least time limit that is handed to a solver: some take zero for none."""

COMPILE_S = 0.04
COMPILE_S_PER_ENTRY = 5e-6
"""What compiling takes: 0.02 to 0.04 s for a small problem of any kind, and 1 to 5 µs for each
number that a large one has as a variable or in a constraint, with cones or without."""


@dataclass(frozen=True)
class SolverSpec:
    """One row of the table.

    Parameters
    ----------
    name : str
        Name on the command line.
    cvxpy_name : str
        Name in cvxpy.
    mip_cones : bool
        Whether it takes second-order cones together with binaries; otherwise inverters become
        polygons.
    options : callable
        ``(absolute gap, seconds) -> options`` of the solver.
    slack : callable
        ``problem -> value - bound`` of the last solve in the solver's own (minimising) sense.
    ended : callable
        ``problem -> Status`` for answers that cvxpy does not call optimal.
    """

    name: str
    cvxpy_name: str
    mip_cones: bool
    options: Callable[[float, float], Mapping[str, Any]]
    slack: Callable[[cp.Problem], float]
    ended: Callable[[cp.Problem], Status]

    @property
    def installed(self) -> bool:
        """Whether cvxpy finds it on this machine."""
        return self.cvxpy_name in _installed()

    @property
    def interface(self) -> str | Solver:
        """What cvxpy hands problems to."""
        return HIGHS_WITHOUT_DUALS if self.cvxpy_name == cp.HIGHS else self.cvxpy_name


@cache
def _installed() -> frozenset[str]:
    """What cvxpy finds: it looks through the folders of the environment for every solver."""
    return frozenset(cp.installed_solvers())


def _stats(problem: cp.Problem) -> Any:
    return problem.solver_stats.extra_stats


def _highs_slack(problem: cp.Problem) -> float:
    info = _stats(problem)
    # For a problem without binaries HiGHS leaves the MIP bound at its default of minus infinity.
    if not problem.is_mixed_integer():
        return 0.0
    return float(info.objective_function_value - info.mip_dual_bound)


def _highs_ended(problem: cp.Problem) -> Status:
    feasible = getattr(_stats(problem), "primal_solution_status", 0) == 2
    return Status.TIME_LIMIT if feasible else Status.NO_ANSWER


def _scip_slack(problem: cp.Problem) -> float:
    model = _stats(problem)["model"]
    return float(model.getPrimalbound() - model.getDualbound())


def _scip_ended(problem: cp.Problem) -> Status:
    model = _stats(problem)["model"]
    if model.getNSols() == 0:
        return Status.NO_ANSWER
    return {
        "gaplimit": Status.OPTIMAL,
        "optimal": Status.OPTIMAL,
        "timelimit": Status.TIME_LIMIT,
    }.get(model.getStatus(), Status.INACCURATE)


def _gurobi_slack(problem: cp.Problem) -> float:
    model = _stats(problem)
    return float(model.ObjVal - model.ObjBound)


def _copt_slack(problem: cp.Problem) -> float:
    model = _stats(problem)
    return float(model.objval - model.bestbnd)


def _xpress_slack(problem: cp.Problem) -> float:
    attributes = _stats(problem)
    # cvxpy does not hand them on in every version: without them there is no bound.
    if not attributes:
        return np.inf
    return float(attributes["mipobjval"] - attributes["bestbound"])


def _ended_with_values(problem: cp.Problem) -> Status:
    return Status.TIME_LIMIT if problem.variables()[0].value is not None else Status.NO_ANSWER


SOLVERS: dict[str, SolverSpec] = {
    spec.name: spec
    for spec in (
        SolverSpec(
            "highs",
            cp.HIGHS,
            False,
            lambda gap, s: {"mip_rel_gap": 0.0, "mip_abs_gap": gap, "time_limit": s},
            _highs_slack,
            _highs_ended,
        ),
        SolverSpec(
            "scip",
            cp.SCIP,
            True,
            # At its default tolerance SCIP 10 calls problems infeasible in which a PV system
            # runs exactly at its inverter's rating.
            lambda gap, s: {
                "scip_params": {
                    "limits/gap": 0.0,
                    "limits/absgap": gap,
                    "limits/time": s,
                    "numerics/feastol": 1e-7,
                }
            },
            _scip_slack,
            _scip_ended,
        ),
        SolverSpec(
            "gurobi",
            cp.GUROBI,
            True,
            lambda gap, s: {"MIPGap": 0.0, "MIPGapAbs": gap, "TimeLimit": s},
            _gurobi_slack,
            _ended_with_values,
        ),
        SolverSpec(
            "copt",
            cp.COPT,
            True,
            lambda gap, s: {"RelGap": 0.0, "AbsGap": gap, "TimeLimit": s},
            _copt_slack,
            _ended_with_values,
        ),
        SolverSpec(
            "xpress",
            cp.XPRESS,
            True,
            lambda gap, s: {"miprelstop": 0.0, "mipabsstop": gap, "maxtime": int(max(s, 1))},
            _xpress_slack,
            _ended_with_values,
        ),
    )
}


def find_solver(name: str) -> SolverSpec:
    """The row of a solver.

    Raises
    ------
    InputError
        If the name is not in the table, or the solver is not installed.

    Examples
    --------
    >>> find_solver("highs").mip_cones
    False
    """
    spec = SOLVERS.get(name)
    ready = ", ".join(s.name for s in SOLVERS.values() if s.installed)
    if spec is None:
        raise InputError(
            Problem(
                "options",
                f"is not a known solver ({', '.join(SOLVERS)})",
                f"Installed here: {ready}.",
                field="solver",
                value=name,
            )
        )
    if not spec.installed:
        raise InputError(
            Problem(
                "options",
                "is not installed",
                f"Install it, or use one of: {ready}.",
                field="solver",
                value=name,
            )
        )
    return spec


def run(
    problem: cp.Problem, spec: SolverSpec, gap_abs: float, time_s: float, scale: float = 1.0
) -> Outcome:
    """Solve a mixed-integer or linear problem and map its status honestly.

    ``scale`` is a factor in the problem's objective; gap, value and bound are meant without it.
    The time limit holds for compiling too.
    """
    return run_with(problem, spec, lambda s: spec.options(gap_abs * scale, s), time_s, scale)


def run_with(
    problem: cp.Problem,
    spec: SolverSpec,
    options: Callable[[float], Mapping[str, Any]],
    time_s: float,
    scale: float = 1.0,
) -> Outcome:
    """The same with options of one's own, of the seconds that are left."""
    deadline = Deadline(time_s)
    try:
        asked = _solve(problem, spec.interface, deadline, options)
    except cp.SolverError:
        return Outcome(Status.NUMERICAL, np.nan, np.nan, deadline.spent_s, spec.name)
    elapsed = deadline.spent_s
    status = _map_status(problem, spec) if asked else Status.NO_ANSWER
    if not status.has_answer:
        return Outcome(status, np.nan, np.nan, elapsed, spec.name)
    sign = 1.0 if isinstance(problem.objective, cp.Maximize) else -1.0
    value = float(problem.objective.value)
    bound = value + sign * max(spec.slack(problem), 0.0)
    return Outcome(status, value / scale, bound / scale, elapsed, spec.name)


def _map_status(problem: cp.Problem, spec: SolverSpec) -> Status:
    """Status of the last solve."""
    if problem.status == cp.OPTIMAL:
        return Status.OPTIMAL
    if problem.status in (
        cp.INFEASIBLE,
        cp.INFEASIBLE_INACCURATE,
        cp.settings.INFEASIBLE_OR_UNBOUNDED,
    ):
        return Status.INFEASIBLE
    if problem.status in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE):
        return Status.UNBOUNDED
    if problem.status in (cp.USER_LIMIT, cp.OPTIMAL_INACCURATE) or _stats(problem) is not None:
        return spec.ended(problem)
    return Status.NUMERICAL


def run_conic(
    problem: cp.Problem, time_s: float, scale: float = 1.0, duals: bool = False
) -> Outcome:
    """Solve a continuous problem with cones or a quadratic objective by interior points.

    ``scale`` is a factor in the problem's objective; the value is meant without it. The time limit
    holds for compiling too. Constraints get their duals where they are asked for.
    """
    deadline = Deadline(time_s)
    interface = CLARABEL_INTERFACE if duals else CLARABEL_WITHOUT_DUALS
    # Refinement costs as many iterations again and gains digits nobody reads, unless they lack.
    status = _interior_points(problem, interface, deadline, refined=False)
    if status in (Status.INACCURATE, Status.NUMERICAL) and not deadline.passed:
        status = _interior_points(problem, interface, deadline, refined=True)
    value = float(problem.objective.value) / scale if status.has_answer else np.nan
    return Outcome(status, value, value, deadline.spent_s, INTERIOR_POINTS)


def _interior_points(
    problem: cp.Problem, interface: Solver, deadline: Deadline, refined: bool
) -> Status:
    """Status of a solve by interior points, with or without refined steps."""

    def options(time_s: float) -> Mapping[str, Any]:
        return {"time_limit": time_s, "iterative_refinement_enable": refined}

    try:
        if not _solve(problem, interface, deadline, options):
            return Status.NO_ANSWER
    except cp.SolverError:
        return Status.NUMERICAL
    return {
        cp.OPTIMAL: Status.OPTIMAL,
        cp.OPTIMAL_INACCURATE: Status.INACCURATE,
        cp.INFEASIBLE: Status.INFEASIBLE,
        cp.UNBOUNDED: Status.UNBOUNDED,
        cp.USER_LIMIT: Status.NO_ANSWER,
    }.get(problem.status, Status.NUMERICAL)


def _solve(
    problem: cp.Problem,
    interface: str | Solver,
    deadline: Deadline,
    options: Callable[[float], Mapping[str, Any]],
) -> bool:
    """Solve in what is left after compiling; whether there was time to ask the solver.

    These are the steps of ``Problem.solve``, which hands a solver the whole limit however long
    compiling took. A problem that could not be compiled in time is not begun.

    Raises
    ------
    cp.SolverError
        If the solver gave up.
    """
    if deadline.left_s < _compile_s(problem):
        return False
    data, chain, inverse = problem.get_problem_data(
        interface, canon_backend=COMPILER, solver_opts=dict(options(deadline.left_s))
    )
    if deadline.passed:
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the status says it
        solution = chain.solve_via_data(
            problem, data, False, False, dict(options(max(deadline.left_s, LEAST_S)))
        )
        problem.unpack_results(solution, chain, inverse)
    return True


def _compile_s(problem: cp.Problem) -> float:
    """What compiling a problem may take, 0 for one that is compiled."""
    if problem.compilation_time is not None:
        return 0.0
    parts = [*problem.variables(), *problem.constraints]
    entries = float(sum(part.size for part in parts))
    return COMPILE_S + COMPILE_S_PER_ENTRY * entries
