"""Programs as arrays, for masters that get columns and rows as they go; HiGHS solves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import highspy
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import NumericalError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.deadline import LEAST_S, Deadline
from vppres.solve.result import Outcome, Status
from vppres.solve.selection import Selected

DIRECT = "highs"
"""Solver of all programs here, whichever solver is chosen: rows are added as they go, and a linear
solve starts where the last one ended, which no common interface offers."""

SOLVED = 1e-6
"""To what problems are solved: what a solver may be off by from a whole number or a bound on one,
from a limit in its row's own unit, and, of interior points, from the optimum as a share."""

WHOLE_GAP = 1.0 - SOLVED
"""Gap of a search whose objective is a whole number: below one, the best number is known."""

HALF_UNIT = 0.5
"""What a sum of units may miss a whole number by and still be the number itself."""

GAP_SHARE = 0.8
"""Share of the window's gap that a search for a set may leave open; a dispatch and its tie-breakers
have the rest."""

NODES = 100
"""Nodes of a search that no certificate needs, for a cheaper set or for a feeder's bound: most end
with fewer, and a bound from an early end is one too."""

STOPPED = (
    highspy.HighsModelStatus.kInterrupt,
    highspy.HighsModelStatus.kSolutionLimit,
    highspy.HighsModelStatus.kObjectiveTarget,
)
"""Ends of a search that an option asked for."""

PROOF = MappingProxyType(
    {
        "mip_heuristic_run_feasibility_jump": False,
        "mip_heuristic_run_rins": False,
        "mip_heuristic_run_rens": False,
        "mip_allow_restart": False,
    }
)
"""Options for a search whose time goes into the proof: rounding finds answers at once, so HiGHS
solves no problem within the problem to find one, nor does it begin again at the root."""

SUMS_KEPT = sum(1 << rule for rule in (8, 9, 12))
"""HiGHS's rules of presolve that replace a whole number by the sum that it stands for, and leave
nothing to branch on: substitution of free columns, equations of two columns, aggregation."""

SEARCH_OF_SETS = MappingProxyType({**PROOF, "presolve_rule_off": SUMS_KEPT})
"""Options for a search for sets: the time goes into the proof, and it may branch on how many of a
weight are served in a step, where the problem or :func:`with_sums` counts them. Not for problems
most of whose columns are held: without its aggregation HiGHS 1.15.1 may write beyond its arrays
where presolve has removed half of a problem."""

SEARCH_WITH_RULES = MappingProxyType({**PROOF, "mip_heuristic_run_rins": True})
"""Options for a search for sets with switching rules and batteries. Good sets are hard to find: of
24 windows one left 19 open after 10 s; with HiGHS's problems within the problem it closed three of
them, and all 24 together were worth 0.3% more. Few nodes follow a root that takes long, and longer
with sums to branch on: 51 windows took 9% more time with them."""

SEARCH_UNSTORED = MappingProxyType({**SEARCH_OF_SETS, "mip_heuristic_run_rins": True})
"""Options for a search for sets with switching rules where nothing can be stored: many nodes are
needed there, and sums to branch on. Of 13 windows three more stayed open without them."""


@dataclass(frozen=True, eq=False)
class Program:
    """Minimise ``cost @ x`` where ``lower <= rows @ x <= upper``, with bounds on x."""

    #: Objective and bounds of the columns, (n,).
    cost: Floats
    x_lower: Floats
    x_upper: Floats
    rows: sp.csc_array  #: left-hand sides, (m, n)
    #: Right-hand sides, infinite where there is none, (m,).
    lower: Floats
    upper: Floats
    integer: Wholes  #: positions of the columns that are whole numbers

    def with_rows(
        self, rows: sp.csc_array, lower: Floats, upper: Floats | float = np.inf
    ) -> Program:
        """The program with rows ``lower <= rows @ x <= upper`` more."""
        return replace(
            self,
            rows=stacked(self.rows, rows),
            lower=np.append(self.lower, lower),
            upper=np.append(self.upper, np.broadcast_to(upper, lower.shape)),
        )

    def priced(self, prices: Floats) -> tuple[float, Floats]:
        """Worth of the rows at some prices, and reduced costs of the columns.

        By weak duality ``cost @ x >= worth + left @ x`` for every x that satisfies the rows,
        whatever the prices: those of a sign that a one-sided row forbids are taken as zero.
        """
        prices = self.allowed(prices)
        limits = np.where(prices > 0.0, self.lower, self.upper)
        used = prices != 0.0
        left: Floats = self.cost - self._by_columns @ prices
        return float(prices[used] @ limits[used]), left

    def least(self, prices: Floats) -> float:
        """Least cost of any x within its bounds, by any prices of the rows."""
        worth, left = self.priced(prices)
        return worth + float(np.minimum(left * self.x_lower, left * self.x_upper).sum())

    @cached_property
    def _by_columns(self) -> sp.csr_array:
        """The rows' transpose: turning them takes longer than a product with them."""
        return self.rows.T

    def allowed(self, prices: Floats) -> Floats:
        """Prices of rows, without those of a sign that a one-sided row forbids."""
        prices = np.where(np.isfinite(self.lower), prices, np.minimum(prices, 0.0))
        return np.where(np.isfinite(self.upper), prices, np.maximum(prices, 0.0))

    def with_held(self, columns: Wholes, values: Floats | Flags) -> Program:
        """The program with some columns held at their values, in the same shape."""
        lower = self.x_lower.copy()
        upper = self.x_upper.copy()
        lower[columns] = upper[columns] = values
        return replace(self, x_lower=lower, x_upper=upper)

    def loaded(
        self,
        gap_abs: float = 0.0,
        most_nodes: int | None = None,
        enough: float = -np.inf,
        more: Mapping[str, Any] = MappingProxyType({}),
    ) -> highspy.Highs:
        """A solver that has the program.

        A search ends at the first value of ``enough`` or less: one that nothing can be below.
        ``more`` are options of HiGHS.
        """
        solver = highspy.Highs()
        options: dict[str, Any] = {
            "output_flag": False,
            "mip_rel_gap": 0.0,
            "mip_abs_gap": gap_abs,
            "objective_target": enough,
            "threads": 1,
            **more,
        }
        if most_nodes is not None:
            options["mip_max_nodes"] = most_nodes
        for name, value in options.items():
            solver.setOptionValue(name, value)
        # A solver that refused its model crashes at the next call.
        if solver.passModel(self.model) == highspy.HighsStatus.kError:
            raise NumericalError(
                "HiGHS refuses a problem: its coefficients are not finite or too "
                "large. Check the data for extreme values."
            )
        return solver

    @property
    def model(self) -> highspy.HighsModel:
        """The program in HiGHS's own form."""
        model = highspy.HighsModel()
        lp = model.lp_
        lp.num_row_, lp.num_col_ = self.rows.shape
        lp.col_cost_ = self.cost
        lp.col_lower_ = self.x_lower
        lp.col_upper_ = self.x_upper
        lp.row_lower_ = self.lower
        lp.row_upper_ = self.upper
        lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        lp.a_matrix_.start_ = self.rows.indptr
        lp.a_matrix_.index_ = self.rows.indices
        lp.a_matrix_.value_ = self.rows.data
        if len(self.integer):
            kinds = [highspy.HighsVarType.kContinuous] * len(self.cost)
            for position in self.integer:
                kinds[position] = highspy.HighsVarType.kInteger
            lp.integrality_ = kinds
        return model


@dataclass(frozen=True, eq=False)
class ProgramSolution:
    """Status, value and dual bound of a program, values of its columns and duals of its rows.

    Duals of an infeasible program are those of the proof: a ray, without scale.
    """

    status: Status
    value: float
    bound: float
    x: Floats
    row_dual: Floats

    @classmethod
    def of(cls, solver: highspy.Highs, deadline: Deadline) -> ProgramSolution:
        """Run a solver until a deadline; duals come only without whole numbers."""
        # HiGHS counts the time of all runs of a solver together.
        solver.setOptionValue("time_limit", solver.getRunTime() + max(deadline.left_s, LEAST_S))
        solver.run()
        solution = solver.getSolution()
        info = solver.getInfo()
        whole = len(solver.getLp().integrality_) > 0
        value = info.objective_function_value
        bound = min(info.mip_dual_bound, value) if whole else value
        status = _status(solver.getModelStatus(), info.primal_solution_status)
        row_dual = np.asarray(solution.row_dual)
        if status == Status.INFEASIBLE and not whole:
            _, exists, ray = solver.getDualRay()
            row_dual = ray if exists else np.zeros(solver.getNumRow())
        return cls(status, value, bound, np.asarray(solution.col_value), row_dual)

    def outcome(self, solve_s: float) -> Outcome:
        """Outcome without values, after so many seconds."""
        return Outcome(self.status, self.value, self.bound, solve_s, DIRECT)


def begin_with(solver: highspy.Highs, columns: Wholes, values: Floats | Flags) -> None:
    """Give a search a set to begin with; HiGHS finds what the other columns are then.

    It need not look for an answer then, and leaves out whatever is no better.
    """
    solver.setSolution(columns.size, columns.ravel().astype(np.int32), values.ravel().astype(float))


def search_options(site: Site, data: WindowData) -> Mapping[str, Any]:
    """Options of HiGHS for a window's searches for sets: by its rules, and by what it can store."""
    if data.switching is None:
        return SEARCH_OF_SETS
    return SEARCH_UNSTORED if site.batteries.idle else SEARCH_WITH_RULES


def columns_of_alike(columns: Wholes, weight: Floats) -> list[Wholes]:
    """Columns, of (W, C), of the customers of equal weight in each step, where there are several.

    >>> columns_of_alike(np.arange(6).reshape(2, 3), np.array([1.0, 0.1, 1.0]))
    [array([0, 2]), array([3, 5])]
    """
    kinds = [np.flatnonzero(weight == each) for each in np.unique(weight)]
    return [step[kind] for step in columns for kind in kinds if len(kind) > 1]


def with_sums(program: Program, groups: Sequence[Wholes]) -> Program:
    """The program with a whole number more for the sum of each group of binary columns.

    A search may branch on it: one branch says of many columns what else takes one for each.
    """
    size = len(program.cost)
    sums = size + np.arange(len(groups))
    zero = np.zeros(len(groups))
    sizes = np.array([len(group) for group in groups], dtype=np.int64)
    rows = np.append(np.repeat(np.arange(len(groups)), sizes), np.arange(len(groups)))
    columns = np.concatenate([*groups, sums])
    values = np.append(np.ones(sizes.sum()), -np.ones(len(groups)))
    equal = sp.coo_array((values, (rows, columns)), shape=(len(groups), size + len(groups)))
    wider = sp.csc_array((len(program.lower), len(groups)))
    return replace(
        program,
        cost=np.append(program.cost, zero),
        x_lower=np.append(program.x_lower, zero),
        x_upper=np.append(program.x_upper, sizes),
        rows=sp.csc_array(sp.hstack([program.rows, wider])),
        integer=np.append(program.integer, sums),
    ).with_rows(sp.csc_array(equal), zero, zero)


def with_limits_of_columns(program: Program) -> tuple[Program, Flags]:
    """The program with rows of one column as limits of columns, and which rows are left, (m,).

    >>> rows = sp.csc_array([[-2.0, 0.0], [1.0, 1.0]])
    >>> free, inf = np.full(2, np.inf), np.inf
    >>> limits = np.array([-inf, 3.0]), np.array([4.0, 3.0])
    >>> program = Program(np.zeros(2), -free, free, rows, *limits, np.arange(0))
    >>> found, left = with_limits_of_columns(program)
    >>> found.x_lower.tolist(), found.x_upper.tolist(), left.tolist()
    ([-2.0, -inf], [inf, inf], [False, True])
    """
    rows = sp.csr_array(program.rows)
    rows.eliminate_zeros()
    alone = np.diff(rows.indptr) == 1
    column, factor = rows[alone].indices, rows[alone].data
    ends = np.stack([program.lower[alone] / factor, program.upper[alone] / factor])
    x_lower, x_upper = program.x_lower.copy(), program.x_upper.copy()
    np.maximum.at(x_lower, column, ends.min(axis=0))
    np.minimum.at(x_upper, column, ends.max(axis=0))
    kept = ~alone
    found = replace(
        program,
        x_lower=x_lower,
        x_upper=x_upper,
        rows=rows[kept].tocsc(),
        lower=program.lower[kept],
        upper=program.upper[kept],
    )
    return found, kept


def stacked(above: sp.csc_array, below: sp.csc_array) -> sp.csc_array:
    """Two sparse arrays of as many columns, one above the other; SciPy takes eight times as long.

    >>> stacked(sp.csc_array([[1.0, 0.0]]), sp.csc_array([[2.0, 3.0]])).toarray().tolist()
    [[1.0, 0.0], [2.0, 3.0]]
    """
    # Before a column's own entries stand those of earlier columns from the other array too.
    first = np.arange(above.nnz) + np.repeat(below.indptr[:-1], np.diff(above.indptr))
    second = np.arange(below.nnz) + np.repeat(above.indptr[1:], np.diff(below.indptr))
    values = np.empty(above.nnz + below.nnz)
    values[first] = above.data
    values[second] = below.data
    rows = np.empty(len(values), dtype=above.indices.dtype)
    rows[first] = above.indices
    rows[second] = below.indices + above.shape[0]
    shape = (above.shape[0] + below.shape[0], above.shape[1])
    return sp.csc_array((values, rows, above.indptr + below.indptr), shape=shape)


def program_of(selected: Selected) -> Program:
    """A selection with its present numbers."""
    numbers = selected.numbers()
    return Program(
        numbers.cost,
        selected.x_lower,
        selected.x_upper,
        numbers.rows,
        selected.row_lower(numbers.limit),
        numbers.limit,
        selected.whole,
    )


def _status(status: highspy.HighsModelStatus, primal: int) -> Status:
    """Status of HiGHS's end."""
    ends = {
        highspy.HighsModelStatus.kOptimal: Status.OPTIMAL,
        highspy.HighsModelStatus.kInfeasible: Status.INFEASIBLE,
        highspy.HighsModelStatus.kUnboundedOrInfeasible: Status.INFEASIBLE,
        highspy.HighsModelStatus.kUnbounded: Status.UNBOUNDED,
    }
    feasible = primal == highspy.SolutionStatus.kSolutionStatusFeasible
    if status == highspy.HighsModelStatus.kTimeLimit:
        return Status.TIME_LIMIT if feasible else Status.NO_ANSWER
    if status in STOPPED:
        return Status.GAP_OPEN if feasible else Status.NO_ANSWER
    return ends.get(status, Status.NUMERICAL)
