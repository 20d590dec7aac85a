"""Rows whose numbers are linear in parameters, and what becomes of them in a selection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats, Wholes


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
