"""The table of solvers, and how they are asked: each way maps its end to a status honestly.

HiGHS and Clarabel get the numbers of a selection as they are; other solvers are asked by cvxpy.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import Any, NamedTuple

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.solve.compiled import COMPILER
from vppres.solve.deadline import LEAST_S, Deadline, Stopwatch
from vppres.solve.programs import DIRECT, ProgramSolution, begin_with, program_of, stacked
from vppres.solve.result import Outcome, Status
from vppres.solve.selection import Selected

INTERIOR_POINTS = "clarabel"
"""Solver of all continuous problems with cones or squares, whichever solver is chosen: those of the
table are for binaries, and HiGHS takes no cones."""

LARGEST_FACTOR = 1e6
"""Largest factor in an objective that interior points get as it is: in strict order they are up to
1e11, and from 1e9 on Clarabel calls problems unbounded that have a solution."""

COMPILE_S = 0.04
COMPILE_S_PER_ENTRY = 5e-6
"""What compiling takes: 0.02 to 0.04 s for a small problem of any kind, and 1 to 5 µs for each
number that a large one has as a variable or in a constraint, with cones or without."""

NO_ANSWER = Outcome(Status.NO_ANSWER, np.nan, np.nan, 0.0)
"""End of a solve that there was no time for."""


class Interface(NamedTuple):
    """How cvxpy asks a solver."""

    #: ``(absolute gap, seconds) -> options`` of the solver.
    options: Callable[[float, float], Mapping[str, Any]]
    #: ``solved problem -> value - bound`` in the solver's own (minimising) sense.
    slack: Callable[[cp.Problem], float]
    #: ``solved problem -> Status`` for ends that cvxpy does not call optimal.
    ended: Callable[[cp.Problem], Status]


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


def _scip_slack(solved: cp.Problem) -> float:
    model = solved.solver_stats.extra_stats["model"]
    return float(model.getPrimalbound() - model.getDualbound())


def _scip_ended(solved: cp.Problem) -> Status:
    model = solved.solver_stats.extra_stats["model"]
    if model.getNSols() == 0:
        return Status.NO_ANSWER
    ends = {"gaplimit": "optimal", "optimal": "optimal", "timelimit": "time_limit"}
    return Status(ends.get(model.getStatus(), "inaccurate"))


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
    if spec is not None and spec.installed:
        return spec
    ready = ", ".join(s.name for s in SOLVERS.values() if s.installed)
    wrong, cure = f"is not a known solver ({', '.join(SOLVERS)})", f"Installed here: {ready}."
    if spec is not None:
        wrong, cure = "is not installed", f"Install it, or use one of: {ready}."
    raise InputError.of("options", wrong, cure, field="solver", value=name)


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
    deadline = Deadline(time_s)
    if not compiled_in_time(problem, deadline):
        return replace(NO_ANSWER, solve_s=deadline.spent_s, solver=spec.name)
    if spec.interface is None:
        found = solve_by_highs(problem, deadline, gap_abs * scale, more, first)
    else:
        asked, x = as_cvxpy(problem)
        found = run_by_cvxpy(asked, spec, gap_abs * scale, deadline.left_s)
        if x.value is not None:
            problem.put(np.asarray(x.value, dtype=float))
    value, bound = found.value / scale, found.bound / scale
    return replace(found, value=value, bound=bound, solve_s=deadline.spent_s)


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
    sign = -1.0 if selected.selection.maximises else 1.0
    value, bound = (sign * (each + selected.offset) for each in (found.value, found.bound))
    return Outcome(found.status, value, bound, watch.spent_s, DIRECT)


def run_by_cvxpy(problem: cp.Problem, spec: SolverSpec, gap_abs: float, time_s: float) -> Outcome:
    """Solve a problem of cvxpy, which does not count its own time for compiling."""
    interface = spec.interface
    assert interface is not None
    watch = Stopwatch()
    options = interface.options(gap_abs, max(time_s, LEAST_S))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # "may be inaccurate": the status says it
            problem.solve(spec.cvxpy_name, canon_backend=COMPILER, **options)
        status = ENDS.get(problem.status) or interface.ended(problem)
    except cp.SolverError:
        status = Status.NUMERICAL
    if not status.has_answer:
        return Outcome(status, np.nan, np.nan, watch.spent_s, spec.name)
    value = float(problem.objective.value)
    sign = 1.0 if isinstance(problem.objective, cp.Maximize) else -1.0
    bound = value + sign * max(interface.slack(problem), 0.0)
    return Outcome(status, value, bound, watch.spent_s, spec.name)


ENDS = {
    cp.OPTIMAL: Status.OPTIMAL,
    cp.INFEASIBLE: Status.INFEASIBLE,
    cp.INFEASIBLE_INACCURATE: Status.INFEASIBLE,
    cp.settings.INFEASIBLE_OR_UNBOUNDED: Status.INFEASIBLE,
    cp.UNBOUNDED: Status.UNBOUNDED,
    cp.UNBOUNDED_INACCURATE: Status.UNBOUNDED,
}
"""Statuses by cvxpy's words, those after which a solver need not be asked how it ended."""


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
    sense = cp.Maximize(-cost) if selected.selection.maximises else cp.Minimize(cost)
    return cp.Problem(sense, rows), x


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
    ended = solve_by_clarabel(problem, time_limit=left_s, iterative_refinement_enable=refined)
    return OF_CLARABEL.get(ended, Status.NUMERICAL)


OF_CLARABEL = {
    "Solved": Status.OPTIMAL,
    "AlmostSolved": Status.INACCURATE,
    "PrimalInfeasible": Status.INFEASIBLE,
    "DualInfeasible": Status.UNBOUNDED,
    "MaxIterations": Status.NO_ANSWER,
    "MaxTime": Status.NO_ANSWER,
}
"""Statuses by Clarabel's words; after another it gave up."""


def solve_by_clarabel(selected: Selected, **options: Any) -> str:
    """Solve a continuous problem with cones; Clarabel's word for how it ended.

    Raises
    ------
    NumericalError
        If a coefficient is not finite.
    """
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    for name, value in options.items():
        setattr(settings, name, value)
    numbers, dims = selected.numbers(), selected.dims
    rows, limit = numbers.rows, numbers.limit
    cones = [clarabel.ZeroConeT(dims.zero)] if dims.zero else []
    cones += [clarabel.NonnegativeConeT(dims.nonneg)] if dims.nonneg else []
    cones += [clarabel.SecondOrderConeT(size) for size in dims.soc]
    if selected.added is not None:
        matrix, least = selected.added
        more = sp.csc_array(-selected.shown(matrix))
        rows, limit = stacked(rows, more), np.append(limit, -least)
        cones.append(clarabel.NonnegativeConeT(len(least)))
    size = max(float(np.abs(numbers.cost).max(initial=0.0)) / LARGEST_FACTOR, 1.0)
    squares, cost = numbers.squares / size, numbers.cost / size
    solver = clarabel.DefaultSolver(squares, cost, rows, limit, cones, settings)
    found = solver.solve()
    ended = str(found.status)
    if ended in ("Solved", "AlmostSolved", "MaxIterations", "MaxTime"):
        x: Floats = np.array(found.x)
        selected.put(x)
        selected.duals = np.array(found.z) * size
    return ended


def compiled_in_time(problem: Selected, deadline: Deadline) -> bool:
    """Compile a problem; whether that was done in time. What would take longer is not begun."""
    needed_s = 0.0 if problem.is_compiled else COMPILE_S + COMPILE_S_PER_ENTRY * problem.entries
    if deadline.left_s < needed_s:
        return False
    problem.compile()
    return not deadline.passed
