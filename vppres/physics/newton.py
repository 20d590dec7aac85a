"""Newton's method for the AC power flow, on admittances that are made once.

The equations and steps are pandapower's, in its order of operations, so that the answers are its
own to the last bit. What a step costs there is bookkeeping: tables are written and read, and the
sparse Jacobian is put together anew. Here its pattern stays and only its numbers are written.
``docs/decisions/power-flow.md`` has the measurements.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from vppres.core.arrays import Complexes, Floats

MAX_STEPS = 10
"""Steps after which the method has failed; three to five are usual from a flat start."""


class Newton:
    """Newton's method in magnitudes and angles of the voltages.

    Parameters
    ----------
    y : sparse matrix, shape (N, N)
        Admittances of the buses for 1 MVA, of which columns are in order in each row.
    reference : int
        Position of the bus with the only source.
    v_source : float
        Its voltage in pu.
    """

    def __init__(self, y: sp.csr_matrix, reference: int, v_source: float) -> None:
        self.y = y
        n = self.y.shape[0]
        self.reference = reference
        self.v_source = v_source
        self.free = np.delete(np.arange(n), reference)
        entries = self.y.tocoo()
        self.row = entries.row
        self.column = entries.col
        self.admittance = entries.data
        self.diagonal = self.row == self.column
        self._keep_pattern(n)

    def _keep_pattern(self, n: int) -> None:
        """Store the positions of the derivatives of active and reactive power in the Jacobian.

        Its rows are active, then reactive power of the free buses; its columns angles, then
        magnitudes. ``order`` sorts the four blocks' numbers, one block after the other, by rows.
        """
        size = len(self.free)
        place = np.full(n, -1)
        place[self.free] = np.arange(size)
        self.used = (self.row != self.reference) & (self.column != self.reference)
        row = place[self.row[self.used]]
        column = place[self.column[self.used]]
        rows = np.concatenate([row, row, row + size, row + size])
        columns = np.concatenate([column, column + size, column, column + size])
        shape = (2 * size, 2 * size)
        # Numbered from 1, since a sparse matrix may drop zeros.
        pattern = sp.csr_matrix((1.0 + np.arange(len(rows)), (rows, columns)), shape=shape)
        self.order = pattern.data.astype(np.int64) - 1
        self.indices = pattern.indices
        self.begins = pattern.indptr
        self.shape = shape

    def flat(self) -> Complexes:
        """Voltages of 1 pu, the source's at the reference."""
        v = np.ones(self.y.shape[0], dtype=complex)
        v[self.reference] = self.v_source
        return v

    def again(self, v: Complexes) -> Complexes:
        """A start from voltages that were found, as pandapower keeps them: angles in degrees."""
        degrees = np.angle(v) * 180.0 / np.pi
        start: Complexes = np.abs(v) * np.exp(1j * np.pi / 180.0 * degrees)
        at = self.reference
        start[at] = self.v_source / np.abs(start[at]) * start[at]
        return start

    def solve(self, start: Complexes, s_mva: Complexes, tolerance_mva: float) -> Complexes | None:
        """Voltages that carry injections to a tolerance; None if the method does not converge.

        Voltages are in pu; the reference's injection is not used. ``tolerance_mva`` is the largest
        mismatch of active or reactive power at any bus.
        """
        v = start
        with np.errstate(all="ignore"):  # a step too long is judged by its mismatch
            for _ in range(MAX_STEPS):
                mismatch = self._mismatch(v, s_mva)
                largest = np.abs(mismatch).max(initial=0.0)
                if largest < tolerance_mva or not np.isfinite(largest):
                    break
                v = self._stepped(v, mismatch)
            else:
                largest = np.abs(self._mismatch(v, s_mva)).max(initial=0.0)
        return v if largest < tolerance_mva else None

    def _mismatch(self, v: Complexes, s_mva: Complexes) -> Floats:
        """Mismatch of active, then reactive power at the free buses."""
        missed = (v * np.conj(self.y @ v) - s_mva)[self.free]
        return np.concatenate([missed.real, missed.imag])

    def _stepped(self, v: Complexes, mismatch: Floats) -> Complexes:
        """Voltages after a step."""
        by_angle, by_magnitude = np.split(-1.0 * spsolve(self._jacobian(v), mismatch), 2)
        angle = np.angle(v)
        magnitude = np.abs(v)
        angle[self.free] += by_angle
        magnitude[self.free] += by_magnitude
        stepped: Complexes = magnitude * np.exp(1j * angle)
        return stepped

    def _jacobian(self, v: Complexes) -> sp.csr_matrix:
        """Derivatives of the mismatch.

        With ``I = Y V``: ``dS/d angle = j V conj(I - Y V)`` and ``dS/d |V| = V conj(Y V / |V|) +
        conj(I) V / |V|``, entry by entry of ``Y``; terms with ``I`` stand on the diagonal.
        """
        current = self.y @ v
        unit = v / np.abs(v)
        at = self.row[self.diagonal]
        drawn = -_times(self.admittance, v[self.column])
        drawn[self.diagonal] += current[at]
        by_angle = _times(_times(1j, v)[self.row], np.conj(drawn))
        by_magnitude = _times(v[self.row], np.conj(_times(self.admittance, unit[self.column])))
        by_magnitude[self.diagonal] += _times(np.conj(current), unit)[at]
        by_angle = by_angle[self.used]
        by_magnitude = by_magnitude[self.used]
        blocks = [by_angle.real, by_magnitude.real, by_angle.imag, by_magnitude.imag]
        numbers = np.concatenate(blocks)[self.order]
        return sp.csr_matrix((numbers, self.indices, self.begins), shape=self.shape)


def _times(one: Complexes | complex, other: Complexes) -> Complexes:
    """Product whose parts are rounded after each operation, as sparse products are.

    NumPy's own complex product may fuse a multiplication with an addition, which rounds once less.
    """
    real = one.real * other.real - one.imag * other.imag
    return real + 1j * (one.real * other.imag + one.imag * other.real)
