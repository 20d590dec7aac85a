"""Constraints that cvxpy has compiled: a linear map from their parameters to numbers.

cvxpy keeps the map of a whole problem, but puts its matrices together anew at every solve: as much
time as small problems take themselves. Here each constraint's map is kept, entry by entry, and what
becomes of its rows in a selection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import NumericalError


@dataclass(frozen=True, eq=False)
class Linear:
    """Rows ``matrix @ x`` with their limits, entry by entry."""

    #: Where an entry stands, (E,). The column behind the last one has the limits.
    row: Wholes
    column: Wholes
    #: What the entry is for the parameters' values with a 1 behind them, (E, parameters + 1).
    by: sp.csr_array
    shape: tuple[int, int]  #: rows and columns, that of the limits not among them

    @classmethod
    def constant(cls, matrix: sp.coo_array, limit: Floats, width: int) -> Linear:
        """Rows that no parameter changes; ``width`` is that of ``by``."""
        matrix = matrix.tocoo()
        count, size = matrix.shape
        limited = np.flatnonzero(limit)
        values = np.append(matrix.data, limit[limited])
        last = np.full(len(values), width - 1)
        by = sp.csr_array((values, (np.arange(len(values)), last)), shape=(len(values), width))
        return cls(
            np.append(matrix.row, limited).astype(np.int64),
            np.append(matrix.col, np.full(len(limited), size)).astype(np.int64),
            by,
            (count, size),
        )

    @classmethod
    def stacked(cls, parts: Sequence[Linear]) -> Linear:
        """Rows of several one below the other, of as many columns."""
        first = np.cumsum([0, *(part.shape[0] for part in parts)])
        width = max(part.by.shape[1] for part in parts)
        return cls(
            np.concatenate([part.row + above for part, above in zip(parts, first, strict=False)]),
            np.concatenate([part.column for part in parts]),
            sp.csr_array(sp.vstack([_widened(part.by, width) for part in parts], format="csr")),
            (int(first[-1]), parts[0].shape[1]),
        )

    def written(self, width: int) -> Linear:
        """Rows of as many values as a window writes."""
        return replace(self, by=_widened(self.by, width))

    def wider(self, size: int) -> Linear:
        """Rows of more columns; those that come behind are not used."""
        column = np.where(self.column == self.shape[1], size, self.column)
        return replace(self, column=column, shape=(self.shape[0], size))

    def between(self, first: int, end: int) -> Linear:
        """The rows from one on to before another."""
        inside = (self.row >= first) & (self.row < end)
        by = sp.csr_array(self.by[inside])
        shape = (end - first, self.shape[1])
        return Linear(self.row[inside] - first, self.column[inside], by, shape)

    def taken(self, rows: Wholes) -> Linear:
        """Some rows, in the order given."""
        count = len(rows)
        places = (np.arange(count), rows)
        return self.times(sp.csr_array((np.ones(count), places), shape=(count, self.shape[0])))

    def times(self, R: Any, T: Any = None) -> Linear:
        """``R @ rows @ T``: sums of rows, and what they are for ``(x, 1) = T @ (y, 1)``.

        What cancels is no entry of the result, whatever the parameters.
        """
        left = sp.csc_array(R)
        size = self.shape[1]
        right = sp.csr_array(sp.eye_array(size + 1, format="csr")) if T is None else sp.csr_array(T)
        ups = np.diff(left.indptr)[self.row].astype(np.int64)
        aways = np.diff(right.indptr)[self.column].astype(np.int64)
        count = ups * aways
        entry = np.repeat(np.arange(len(count)), count)
        within = np.arange(len(entry)) - np.repeat(np.cumsum(count) - count, count)
        up = left.indptr[self.row[entry]] + within // aways[entry]
        away = right.indptr[self.column[entry]] + within % aways[entry]
        rows, columns = left.shape[0], right.shape[1] - 1
        place = right.indices[away].astype(np.int64) * rows + left.indices[up]
        places, number = np.unique(place, return_inverse=True)
        factors = left.data[up] * right.data[away]
        sums = sp.csr_array((factors, (number, entry)), shape=(len(places), len(count)))
        by = sp.csr_array(sums @ self.by)
        by.eliminate_zeros()
        by.sort_indices()  # a sum of parameters is that of their order, to the last bit
        stays = np.diff(by.indptr) > 0
        column, row = np.divmod(places[stays], max(rows, 1))
        return Linear(row, column, sp.csr_array(by[stays]), (rows, columns))

    def plus(self, other: Linear) -> Linear:
        """The rows of both added up, one by one."""
        size = max(self.shape[1], other.shape[1])
        each = sp.eye_array(self.shape[0])
        both = sp.csr_array(sp.hstack([each, each]))
        return Linear.stacked([self.wider(size), other.wider(size)]).times(both)

    def constants(self, of: int) -> sp.csr_array:
        """The matrix of what no parameter changes; ``of`` is the number of the value 1."""
        inside = self.column < self.shape[1]
        values = self.by[inside][:, [of]].toarray().ravel()
        places = (self.row[inside], self.column[inside])
        return sp.csr_array((values, places), shape=self.shape)


def _widened(by: sp.csr_array, width: int) -> sp.csr_array:
    """Numbers of more values, on which they do not depend."""
    if by.shape[1] == width:
        return by
    return sp.csr_array((by.data, by.indices, by.indptr), shape=(by.shape[0], width))


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
    """A constraint compiled by itself."""

    rows: Linear  #: equalities, then limits from above, on columns and parameters of its own
    equalities: int  #: how many rows are equalities
    first: dict[int, int]  #: first column of each variable, by cvxpy's number of it
    parameters: list[tuple[cp.Parameter, int]]  #: parameters with their first places
    width: int  #: parameters and one more
    #: Bounds of the columns, those that cvxpy made among them.
    lower: Floats
    upper: Floats


def rows_of(constraint: cp.Constraint) -> cp.Expression:
    """Rows of an affine constraint that are zero or above; of a cone the members."""
    if isinstance(constraint, cp.SOC):
        radius, vector = constraint.args
        found = cp.vstack([cp.reshape(radius, (1, radius.size), order="F"), vector])
    else:
        left, right = constraint.args
        found = right - left
    return cp.vec(found, order="F")


def joined(constraints: list[cp.Constraint]) -> cp.Constraint:
    """The rows of affine constraints one after the other, as those of one constraint."""
    return cp.hstack([rows_of(each) for each in constraints]) >= 0


def affine(constraint: cp.Constraint) -> Affine:
    """Compile a constraint by itself."""
    if not constraint.size:
        none = np.zeros(0, dtype=np.int64)
        rows = Linear(none, none, sp.csr_array((0, 1)), (0, 0))
        return Affine(rows, 0, {}, [], 1, np.zeros(0), np.zeros(0))
    problem = cp.Problem(cp.Minimize(0), [_by_diagonals(constraint)])
    data, chain, _ = problem.get_problem_data(cp.HIGHS, canon_backend=COMPILER)
    program = data["param_prob"]
    size = len(data["c"])
    indices, begins, shape = program.reduced_A.problem_data_index
    # Limits stand behind the entries of the columns, which have the other sign.
    sign = np.where(np.arange(len(indices)) < begins[-2], -1.0, 1.0)
    by = sp.csr_array(sp.diags_array(sign) @ sp.csr_array(program.reduced_A.reduced_mat))
    column = np.repeat(np.arange(size + 1), np.diff(begins)).astype(np.int64)
    rows = Linear(np.asarray(indices, dtype=np.int64), column, by, (shape[0], size))
    first = program.param_id_to_col
    compiled, of_variable = chain.compose_var_id_map(), program.var_id_to_col
    numbers = ((x.id, compiled.get(x.id, [x.id])[0]) for x in problem.variables())
    lower, upper = _bounds(program, size)
    return Affine(
        rows,
        equalities=data["dims"].zero,
        first={own: of_variable[new] for own, new in numbers if new in of_variable},
        parameters=[(p, first[p.id]) for p in program.parameters],
        width=program.total_param_size + 1,
        lower=lower,
        upper=upper,
    )


def _by_diagonals(part: Any) -> Any:
    """A constraint or expression with diagonal matrices for its parameters times letters.

    The compiled rows are equal. For ``multiply`` cvxpy makes a matrix as long as the square of the
    parameter's size.
    """
    if not part.args or not part.parameters():
        return part
    args = [_by_diagonals(each) for each in part.args]
    if not isinstance(part, cp.multiply):
        return part.copy(args)
    factor, letters = args if args[1].variables() else args[::-1]
    if factor.parameters() and letters.variables():
        product = cp.diag(cp.vec(factor, order="F")) @ cp.vec(letters, order="F")
        return cp.reshape(product, part.shape, order="F")
    return part.copy(args)


def _bounds(program: Any, size: int) -> tuple[Floats, Floats]:
    """Bounds of the columns."""
    lower, upper = program.lower_bounds, program.upper_bounds
    x_lower: Floats = np.full(size, -np.inf) if lower is None else lower.copy()
    x_upper: Floats = np.full(size, np.inf) if upper is None else upper.copy()
    boolean = np.array([column for (column,) in program.x.boolean_idx], dtype=np.int64)
    x_lower[boolean] = np.maximum(x_lower[boolean], 0.0)
    x_upper[boolean] = np.minimum(x_upper[boolean], 1.0)
    return x_lower, x_upper


def checked(numbers: Numbers) -> Numbers:
    """The same, which are numbers: a solver may take for one what is none, or never end.

    Raises
    ------
    NumericalError
        If they are none.
    """
    factors = (numbers.squares.data, numbers.cost, numbers.rows.data)
    finite = all(np.isfinite(values).all() for values in factors)
    if not finite or np.isnan(numbers.limit).any():
        raise NumericalError(
            "A problem's coefficients are not finite. Check the data for extreme values."
        )
    return numbers
