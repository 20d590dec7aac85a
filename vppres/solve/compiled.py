"""Problems that cvxpy has compiled, asked for their numbers again without the way through cvxpy.

A compiled problem is a linear map from its parameters to the numbers that a solver gets. cvxpy
keeps the map, but puts its matrices together anew at every solve, sorts duals by constraints and
takes answers apart reduction by reduction: as much time as small problems take themselves. Here
patterns are kept and only numbers are written, the same to the last bit.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import cvxpy as cp
import numpy as np
import scipy.sparse as sp
from cvxpy.reductions.cvx_attr2constr import CONVEX_ATTRIBUTES, attributes_present
from cvxpy.reductions.solvers.solver import Solver

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import NumericalError
from vppres.solve.linear import Linear

COMPILER = cp.settings.COO_CANON_BACKEND
"""cvxpy's compiler back end; for problems with many parameters it takes a third of the default's
time, and the compiled problem is the same."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """Minimise ``x @ P @ x / 2 + cost @ x`` where ``limit - rows @ x`` lies in the cones.

    ``squares`` is the upper triangle of P, empty without squares; shapes are (n, n), (n,), (m, n)
    and (m,). What the objective has besides is ``offset``.
    """

    squares: sp.csc_array
    cost: Floats
    offset: float
    rows: sp.csc_array
    limit: Floats


@dataclass(frozen=True, eq=False)
class Affine:
    """A constraint compiled by itself.

    Parameters
    ----------
    rows : Linear
        Equalities, then limits from above, on columns and parameters of its own.
    equalities, cones : int
        How many rows are equalities; of how many cones the rows are radius and vector in turn.
    first : dict
        First column of each variable, by cvxpy's number of it.
    parameters : list
        Parameters with their first places.
    width : int
        Parameters and one more.
    lower, upper : array
        Bounds of the columns, those that cvxpy made among them.
    """

    rows: Linear
    equalities: int
    cones: int
    first: dict[int, int]
    parameters: list[tuple[cp.Parameter, int]]
    width: int
    lower: Floats
    upper: Floats


def affine(constraint: cp.Constraint) -> Affine:
    """Compile a constraint by itself; a second-order cone as the rows that lie in it."""
    cones = 0
    if isinstance(constraint, cp.SOC):
        radius, vector = constraint.args
        cones = radius.size
        inside = cp.vstack([cp.reshape(radius, (1, cones), order="F"), vector])
        constraint = inside >= 0
    if not constraint.size:
        none = np.zeros(0, dtype=np.int64)
        rows = Linear(none, none, sp.csr_array((0, 1)), (0, 0))
        return Affine(rows, 0, cones, {}, [], 1, np.zeros(0), np.zeros(0))
    compiled = Compiled(cp.Problem(cp.Minimize(0), [constraint]), cp.HIGHS)
    return compiled.affine(cones)


class Compiled:
    """A problem compiled for a solver: what of it stays the same, and how its numbers are written.

    Parameters
    ----------
    problem : cvxpy.Problem
        DPP; compiled here if it is not yet.
    interface : str or Solver
        cvxpy's interface of the solver.

    Attributes
    ----------
    dims : ConeDims
        Rows of each cone: equalities, then inequalities, then second-order cones.
    first : dict
        First column of each variable that has any, by cvxpy's number of the variable.
    whole : array
        Columns that are whole numbers.
    x_lower, x_upper : array, shape (n,)
        Bounds of the columns, infinite where there is none.
    """

    def __init__(self, problem: cp.Problem, interface: str | Solver) -> None:
        self.duals: Floats = np.zeros(0)
        data, chain, _ = problem.get_problem_data(interface, canon_backend=COMPILER)
        program = data["param_prob"]
        self.dims = data["dims"]
        self._program = program
        self._keep_map(program, data)
        self._keep_columns(problem, program, chain.compose_var_id_map())
        self._keep_bounds(program, len(data["c"]))

    def _keep_map(self, program: Any, data: dict[str, Any]) -> None:
        """The map from parameters to numbers, and the patterns of its matrices."""
        first = program.param_id_to_col
        self._parameters = [
            (slice(first[p.id], first[p.id] + p.size), p) for p in program.parameters
        ]
        self._constant = program.total_param_size
        self._cost = sp.csr_array(program.q)
        self._cost.sort_indices()
        self._rows = program.reduced_A.reduced_mat
        indices, begins, _ = program.reduced_A.problem_data_index
        self._entries = int(begins[-2])
        self._limited = indices[self._entries :]
        # Made anew, its indices are those of 32 bits that solvers take as they are.
        pattern = data["A"]
        parts = (pattern.data, pattern.indices, pattern.indptr)
        self._pattern = sp.csc_array(parts, shape=pattern.shape)
        self._squares = None
        self._triangle = sp.csc_array((len(data["c"]), len(data["c"])))
        if "P" in data:
            self._squares = program.reduced_P.reduced_mat
            numbered = sp.csc_array(data["P"], copy=True)
            numbered.data = 1.0 + np.arange(numbered.nnz)
            self._triangle = sp.csc_array(sp.triu(numbered))
            self._kept = self._triangle.data.astype(np.int64) - 1

    def _keep_columns(
        self, problem: cp.Problem, program: Any, places: dict[int, list[int]]
    ) -> None:
        """Where each variable stands in a solution, and what kinds of columns there are."""
        columns = program.var_id_to_col
        compiled = {v.id: places.get(v.id, [v.id])[0] for v in problem.variables()}
        self.first = {own: columns[new] for own, new in compiled.items() if new in columns}
        known = [v for v in problem.variables() if v.id in self.first]
        starts = [self.first[v.id] for v in known]
        self._places = [(v, k, k + v.size, v.shape) for v, k in zip(known, starts, strict=True)]
        self._empty = [v for v in problem.variables() if v.id not in self.first]
        # What cvxpy does with variables that are not simply free, if any is not.
        self._projects = bool(attributes_present(known, CONVEX_ATTRIBUTES))

    def _keep_bounds(self, program: Any, count: int) -> None:
        """Bounds of the columns, and which of them are whole numbers."""
        lower, upper = program.lower_bounds, program.upper_bounds
        self.x_lower: Floats = np.full(count, -np.inf) if lower is None else lower.copy()
        self.x_upper: Floats = np.full(count, np.inf) if upper is None else upper.copy()
        boolean = _positions(program.x.boolean_idx)
        self.x_lower[boolean] = np.maximum(self.x_lower[boolean], 0.0)
        self.x_upper[boolean] = np.minimum(self.x_upper[boolean], 1.0)
        self.whole: Wholes = np.concatenate([_positions(program.x.integer_idx), boolean])

    def row_lower(self, limit: Floats) -> Floats:
        """Lower ends of the rows of a problem without cones, (m,): its equalities come first."""
        lower = np.full(len(limit), -np.inf)
        lower[: self.dims.zero] = limit[: self.dims.zero]
        return lower

    def numbers(self) -> Numbers:
        """The numbers for the parameters' present values.

        Raises
        ------
        NumericalError
            If they are no numbers.
        """
        values = np.zeros(self._constant + 1)
        values[self._constant] = 1.0
        for place, parameter in self._parameters:
            values[place] = np.ravel(parameter.value, order="F")
        entries = self._rows @ values
        limit = np.zeros(self._pattern.shape[0])
        limit[self._limited] = entries[self._entries :]
        cost = self._cost @ values
        squares = self._triangle
        if self._squares is not None:
            squares = _like(squares, (self._squares @ values)[self._kept])
        rows = _like(self._pattern, -entries[: self._entries])
        found = Numbers(squares, cost[:-1], float(cost[-1]), rows, limit)
        _check(found)
        return found

    def affine(self, cones: int) -> Affine:
        """The rows of a problem without objective, entry by entry."""
        indices, begins, shape = self._program.reduced_A.problem_data_index
        width = self._constant + 1
        size = len(self.x_lower)
        sign = np.where(np.arange(len(indices)) < self._entries, -1.0, 1.0)
        by = sp.csr_array(sp.diags_array(sign) @ self._rows)
        column = np.repeat(np.arange(size + 1), np.diff(begins)).astype(np.int64)
        rows = Linear(np.asarray(indices, dtype=np.int64), column, by, (shape[0], size))
        first = dict(self.first)
        places = [(parameter, place.start) for place, parameter in self._parameters]
        equalities = 0 if cones else self.dims.zero
        return Affine(rows, equalities, cones, first, places, width, self.x_lower, self.x_upper)

    def put(self, x: Floats) -> None:
        """Give the variables the values of a solution."""
        for variable in self._empty:
            variable.save_value(np.zeros(variable.shape))
        for variable, first, end, shape in self._places:
            value = x[first:end].reshape(shape, order="F")
            variable.save_value(variable.project(value) if self._projects else value)


def compiled_for(problem: cp.Problem, interface: str | Solver) -> Compiled:
    """The compiled problem, which is kept as long as the problem is there."""
    known = _KEPT.get(problem)
    if known is None or known[0] != interface:
        known = _KEPT[problem] = interface, Compiled(problem, interface)
    return known[1]


def is_compiled(problem: cp.Problem, interface: str | Solver) -> bool:
    """Whether the problem needs no compiling any more."""
    known = _KEPT.get(problem)
    return known is not None and known[0] == interface


_KEPT: WeakKeyDictionary[cp.Problem, tuple[str | Solver, Compiled]] = WeakKeyDictionary()


def _positions(index: Any) -> Wholes:
    """Columns of a kind, which cvxpy has as tuples of one."""
    return np.array([column for (column,) in index], dtype=np.int64)


def _like(pattern: sp.csc_array, numbers: Floats) -> sp.csc_array:
    """A matrix of the same pattern with other numbers."""
    made = copy(pattern)
    made.data = numbers
    return made


def checked(numbers: Numbers) -> Numbers:
    """The same, which are numbers.

    Raises
    ------
    NumericalError
        If they are none.
    """
    _check(numbers)
    return numbers


def _check(numbers: Numbers) -> None:
    """Refuse what is no number: a solver may take it for one, or never end."""
    factors = (numbers.squares.data, numbers.cost, numbers.rows.data)
    finite = all(np.isfinite(values).all() for values in factors)
    if not finite or np.isnan(numbers.limit).any():
        raise NumericalError(
            "A problem's coefficients are not finite. Check the data for extreme values."
        )
