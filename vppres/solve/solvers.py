"""The table of solvers: what each can do, how it takes limits, how its bound is read."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import cvxpy as cp
import numpy as np

from vppres.core.arrays import Flags
from vppres.core.errors import InputError
from vppres.solve.compiled import COMPILER
from vppres.solve.deadline import LEAST_S, Deadline
from vppres.solve.direct import solve_by_clarabel, solve_by_highs
from vppres.solve.programs import DIRECT
from vppres.solve.result import Outcome, Status
from vppres.solve.selection import Selected

INTERIOR_POINTS = "clarabel"
"""Solver of all continuous problems with cones or squares, whichever solver is chosen: those of the
table are for binaries, and HiGHS takes no cones."""

COMPILE_S = 0.04
COMPILE_S_PER_ENTRY = 5e-6
"""What compiling takes: 0.02 to 0.04 s for a small problem of any kind, and 1 to 5 µs for each
number that a large one has as a variable or in a constraint, with cones or without."""


@dataclass(frozen=True)
class CvxpyResult:
    """How a solve by way of cvxpy ended."""

    word: str  #: cvxpy's word for it
    stats: Any  #: the solver's own figures
    has_values: bool  #: whether its variables got values


class Interface(NamedTuple):
    """How cvxpy asks a solver."""

    #: ``(absolute gap, seconds) -> options`` of the solver.
    options: Callable[[float, float], Mapping[str, Any]]
    #: ``answer -> value - bound`` in the solver's own (minimising) sense.
    slack: Callable[[CvxpyResult], float]
    #: ``answer -> Status`` for answers that cvxpy does not call optimal.
    ended: Callable[[CvxpyResult], Status]


@dataclass(frozen=True)
class SolverSpec:
    """One row of the table."""

    name: str  #: name on the command line
    cvxpy_name: str  #: name in cvxpy
    #: Whether it takes second-order cones together with binaries; otherwise inverters become
    #: polygons.
    mip_cones: bool
    #: How cvxpy asks it; HiGHS, which has none, is asked directly.
    interface: Interface | None = None

    @property
    def installed(self) -> bool:
        """Whether cvxpy finds it on this machine."""
        return self.cvxpy_name in _installed()


@cache
def _installed() -> frozenset[str]:
    """Solvers that cvxpy finds: it looks through the folders of the environment for each."""
    return frozenset(cp.installed_solvers())


def _scip_slack(answer: CvxpyResult) -> float:
    model = answer.stats["model"]
    return float(model.getPrimalbound() - model.getDualbound())


def _scip_ended(answer: CvxpyResult) -> Status:
    model = answer.stats["model"]
    if model.getNSols() == 0:
        return Status.NO_ANSWER
    return {
        "gaplimit": Status.OPTIMAL,
        "optimal": Status.OPTIMAL,
        "timelimit": Status.TIME_LIMIT,
    }.get(model.getStatus(), Status.INACCURATE)


def _scip_options(gap_abs: float, time_s: float) -> Mapping[str, Any]:
    # At its default tolerance SCIP 10 calls problems infeasible in which a PV system runs exactly
    # at its inverter's rating.
    limits = {"limits/gap": 0.0, "limits/absgap": gap_abs, "limits/time": time_s}
    return {"scip_params": {**limits, "numerics/feastol": 1e-7}}


SOLVERS: dict[str, SolverSpec] = {
    spec.name: spec
    for spec in (
        SolverSpec(DIRECT, cp.HIGHS, False),
        SolverSpec("scip", cp.SCIP, True, Interface(_scip_options, _scip_slack, _scip_ended)),
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
        raise InputError.of(
            "options",
            f"is not a known solver ({', '.join(SOLVERS)})",
            f"Installed here: {ready}.",
            field="solver",
            value=name,
        )
    if not spec.installed:
        raise InputError.of(
            "options",
            "is not installed",
            f"Install it, or use one of: {ready}.",
            field="solver",
            value=name,
        )
    return spec


def run(
    problem: Selected,
    spec: SolverSpec,
    gap_abs: float,
    time_s: float,
    scale: float = 1.0,
    more: Mapping[str, Any] = MappingProxyType({}),
    first: Flags | None = None,
) -> Outcome:
    """Solve a mixed-integer or linear problem and map its status honestly.

    ``scale`` is a factor in the problem's objective; gap, value and bound are meant without it.
    The time limit holds for compiling too. HiGHS gets ``more`` options and begins with the supply
    schedule ``first``; others do without.
    """
    if spec.interface is not None:
        return run_by_cvxpy(problem, spec, gap_abs, time_s, scale)
    deadline = Deadline(time_s)
    if not compiled_in_time(problem, deadline):
        return Outcome(Status.NO_ANSWER, np.nan, np.nan, deadline.spent_s, spec.name)
    found = solve_by_highs(problem, deadline, gap_abs * scale, more, first)
    value, bound = found.value / scale, found.bound / scale
    return replace(found, value=value, bound=bound, solve_s=deadline.spent_s)


def run_by_cvxpy(
    problem: cp.Problem | Selected,
    spec: SolverSpec,
    gap_abs: float,
    time_s: float,
    scale: float = 1.0,
) -> Outcome:
    """Solve by way of cvxpy."""
    interface = spec.interface
    assert interface is not None
    options = partial(interface.options, gap_abs * scale)
    deadline = Deadline(time_s)
    nothing = Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0, spec.name)
    selected = None
    if isinstance(problem, Selected):
        selected = problem
        if not compiled_in_time(selected, deadline):
            return replace(nothing, solve_s=deadline.spent_s)
        problem, x = as_cvxpy(selected)
    try:
        answer = _by_cvxpy(problem, spec.cvxpy_name, deadline, options)
    except cp.SolverError:
        return replace(nothing, status=Status.NUMERICAL, solve_s=deadline.spent_s)
    if selected is not None and answer is not None and answer.has_values:
        selected.put(np.asarray(x.value, dtype=float))
    status = Status.NO_ANSWER if answer is None else _status(answer, interface)
    nothing = replace(nothing, status=status, solve_s=deadline.spent_s)
    if answer is None or not status.has_answer:
        return nothing
    value = float(problem.objective.value)
    sign = 1.0 if isinstance(problem.objective, cp.Maximize) else -1.0
    bound = value + sign * max(interface.slack(answer), 0.0)
    return replace(nothing, value=value / scale, bound=bound / scale)


def _status(answer: CvxpyResult, interface: Interface) -> Status:
    """Status of an answer."""
    if answer.word == cp.OPTIMAL:
        return Status.OPTIMAL
    if answer.word in (
        cp.INFEASIBLE,
        cp.INFEASIBLE_INACCURATE,
        cp.settings.INFEASIBLE_OR_UNBOUNDED,
    ):
        return Status.INFEASIBLE
    if answer.word in (cp.UNBOUNDED, cp.UNBOUNDED_INACCURATE):
        return Status.UNBOUNDED
    if answer.word in (cp.USER_LIMIT, cp.OPTIMAL_INACCURATE) or answer.stats is not None:
        return interface.ended(answer)
    return Status.NUMERICAL


def run_conic(problem: Selected, time_s: float, scale: float = 1.0) -> Outcome:
    """Solve a continuous problem with cones or a quadratic objective by interior points.

    ``scale`` is a factor in the problem's objective; the value is meant without it. The time limit
    holds for compiling too.
    """
    deadline = Deadline(time_s)
    # Refinement costs as many iterations again and gains digits that are not used, unless they
    # lack.
    status = _interior_points(problem, deadline, refined=False)
    if status in (Status.INACCURATE, Status.NUMERICAL) and not deadline.passed:
        status = _interior_points(problem, deadline, refined=True)
    value = problem.value / scale if status.has_answer else np.nan
    return Outcome(status, value, value, deadline.spent_s, INTERIOR_POINTS)


def _interior_points(problem: Selected, deadline: Deadline, refined: bool) -> Status:
    """Status of a solve by interior points, with or without refined steps."""
    if not compiled_in_time(problem, deadline):
        return Status.NO_ANSWER
    left_s = max(deadline.left_s, LEAST_S)
    word = solve_by_clarabel(
        problem, {"time_limit": left_s, "iterative_refinement_enable": refined}
    )
    return {
        cp.OPTIMAL: Status.OPTIMAL,
        cp.OPTIMAL_INACCURATE: Status.INACCURATE,
        cp.INFEASIBLE: Status.INFEASIBLE,
        cp.UNBOUNDED: Status.UNBOUNDED,
        cp.USER_LIMIT: Status.NO_ANSWER,
    }.get(word, Status.NUMERICAL)


def compiled_in_time(problem: Selected, deadline: Deadline) -> bool:
    """Compile a problem; whether that was done in time. What would take longer is not begun."""
    if deadline.left_s < _compile_s(problem):
        return False
    problem.compile()
    return not deadline.passed


def _by_cvxpy(
    problem: cp.Problem,
    solver: str,
    deadline: Deadline,
    options: Callable[[float], Mapping[str, Any]],
) -> CvxpyResult | None:
    """Ask in what compiling leaves of the time; None where it left nothing.

    These are the steps of ``Problem.solve``, which hands a solver the whole limit however long
    compiling took.

    Raises
    ------
    cp.SolverError
        If the solver gave up.
    """
    if deadline.left_s < _compile_s(problem):
        return None
    data, chain, inverse = problem.get_problem_data(
        solver, canon_backend=COMPILER, solver_opts=dict(options(deadline.left_s))
    )
    if deadline.passed:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the status says it
        solution = chain.solve_via_data(
            problem, data, False, False, dict(options(max(deadline.left_s, LEAST_S)))
        )
        problem.unpack_results(solution, chain, inverse)
    stats = None if problem.solver_stats is None else problem.solver_stats.extra_stats
    return CvxpyResult(problem.status, stats, problem.variables()[0].value is not None)


def as_cvxpy(selected: Selected) -> tuple[cp.Problem, cp.Variable]:
    """A selection with its present numbers as a problem of one variable, without parameters."""
    numbers = selected.numbers()
    whole = np.asarray(selected.whole, dtype=int)
    x = cp.Variable(len(numbers.cost), integer=(whole,) if len(whole) else False)
    zero, end = selected.dims.zero, selected.dims.zero + selected.dims.nonneg
    left = numbers.limit - numbers.rows @ x
    # A row without coefficients that holds is left out: cvxpy reads no prices of it from SCIP.
    bare = abs(numbers.rows).sum(axis=1) == 0
    equal = np.flatnonzero(~bare[:zero] | (numbers.limit[:zero] != 0))
    least = zero + np.flatnonzero(~bare[zero:end] | (numbers.limit[zero:end] < 0))
    rows = [left[equal] == 0, left[least] >= 0]
    if selected.dims.soc:
        cones = cp.reshape(left[end:], (3, len(selected.dims.soc)), order="F")
        rows.append(cp.SOC(cones[0], cones[1:], axis=0))
    if not selected.conic:
        low, high = np.isfinite(selected.x_lower), np.isfinite(selected.x_upper)
        rows += [x[low] >= selected.x_lower[low], x[high] <= selected.x_upper[high]]
    if selected.added is not None:
        matrix, at_least = selected.added
        rows.append(selected.shown(matrix) @ x >= at_least)
    cost = numbers.cost @ x + numbers.offset
    sense = cp.Maximize(-cost) if selected.maximises else cp.Minimize(cost)
    return cp.Problem(sense, rows), x


def _compile_s(problem: cp.Problem | Selected) -> float:
    """Time for compiling a problem, in seconds; 0 for one that is compiled."""
    if isinstance(problem, Selected):
        return 0.0 if problem.is_compiled else COMPILE_S + COMPILE_S_PER_ENTRY * problem.entries
    if problem.compilation_time is not None:
        return 0.0
    parts = [*problem.variables(), *problem.constraints]
    entries = float(sum(part.size for part in parts))
    return COMPILE_S + COMPILE_S_PER_ENTRY * entries
