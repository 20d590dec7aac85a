"""Rows of a program that are made as they are needed, and how it gets them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import highspy
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.solve.programs import Program

PER_PU2 = 1e3
"""Rows of voltages are in thousandths of pu²."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows ``lower <= matrix @ x <= upper``."""

    matrix: sp.csr_array
    lower: Floats
    upper: Floats

    @classmethod
    def of(
        cls,
        columns: Wholes,
        values: Floats,
        lower: Floats | float,
        upper: Floats | float,
        size: int,
    ) -> Rows:
        """Rows of equal length: ``columns`` and ``values`` have shape (R, k)."""
        count, width = columns.shape
        matrix = sp.csr_array(
            (
                np.broadcast_to(values, columns.shape).astype(float).ravel(),
                (np.repeat(np.arange(count), width), columns.ravel()),
            ),
            shape=(count, size),
        )
        return cls(
            matrix,
            np.broadcast_to(lower, count).astype(float),
            np.broadcast_to(upper, count).astype(float),
        )

    def part(self, which: Flags | Wholes | slice) -> Rows:
        """Some of the rows."""
        return Rows(self.matrix[which], self.lower[which], self.upper[which])

    def wider(self, size: int) -> Rows:
        """Rows of a program with more columns behind."""
        m = self.matrix
        shape = (m.shape[0], size)
        return replace(self, matrix=sp.csr_array((m.data, m.indices, m.indptr), shape=shape))

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """All rows of several."""
        return cls(
            sp.csr_array(sp.vstack([part.matrix for part in parts])),
            np.concatenate([part.lower for part in parts]),
            np.concatenate([part.upper for part in parts]),
        )


@dataclass(frozen=True, eq=False)
class ColumnPowers:
    """ColumnPowers at K places in each step by a problem's columns: ``by_kw @ x`` and a known part.

    Places are buses, which are given power, or assets of a phased feeder, which draw it.
    ``by_kw`` and ``by_kvar`` are (W * K, n), one step after the other; ``kw`` and ``kvar`` (W, K).
    """

    by_kw: sp.csr_array
    by_kvar: sp.csr_array
    kw: Floats
    kvar: Floats

    def at(self, x: Floats) -> tuple[Floats, Floats]:
        """ColumnPowers in a solution, (W, K) each."""
        kw = self.kw + (self.by_kw @ x).reshape(self.kw.shape)
        return kw, self.kvar + (self.by_kvar @ x).reshape(self.kvar.shape)

    def sums(
        self, steps: Wholes, per_kw: Floats, per_kvar: Floats
    ) -> tuple[sp.csr_array, Floats, Floats]:
        """Sums of powers in some steps with factors (R, K): rows, and what kW and kvar are known.

        A sum is ``rows @ x`` and both of these.
        """
        count, K = per_kw.shape
        places = np.repeat(np.arange(count), K), (steps[:, None] * K + np.arange(K)).ravel()
        by_kw, by_kvar = (
            sp.csr_array((factors.ravel(), places), shape=(count, self.kw.size))
            for factors in (per_kw, per_kvar)
        )
        for each in (by_kw, by_kvar):
            each.eliminate_zeros()
        rows = sp.csr_array(by_kw @ self.by_kw + by_kvar @ self.by_kvar)
        return rows, by_kw @ self.kw.ravel(), by_kvar @ self.kvar.ravel()


def limited(program: Program, rows: list[Rows]) -> Program:
    """A program with limits in it."""
    if not rows:
        return program
    limits = Rows.joined(rows)
    return program.with_rows(limits.matrix.tocsc(), limits.lower, limits.upper)


def add(solver: highspy.Highs, rows: Rows) -> None:
    """Add rows to a solver that keeps its basis."""
    m = rows.matrix
    solver.addRows(
        m.shape[0],
        rows.lower,
        rows.upper,
        m.nnz,
        m.indptr[:-1].astype(np.int32),
        m.indices.astype(np.int32),
        m.data,
    )
