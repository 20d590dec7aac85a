"""Proofs of single feeders: cuts from their own searches at the prices of what all share.

Feeders that leave the slack bus share balances alone, since no line's voltage drop reaches beyond
the slack bus. ``docs/method.md``, *Service with the network*.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.scenario.network import Network
from vppres.solve.deadline import Deadline
from vppres.solve.network.sets import BOUND_OFF
from vppres.solve.programs import NODES, PROOF, SOLVED, Program, ProgramSolution

SHARED = -1
"""Feeder of what belongs to none: the grid's columns, rows over several feeders."""

MOST_LOST = 2.0
"""Units of service by which a feeder's search may fall below its linear problem. Whose service, or
lack of it, would alone cost more is decided beforehand, and no cut takes more than that away."""

GAP = 0.05
"""Units that a feeder's search may leave open."""

SEARCH = MappingProxyType({**PROOF, "mip_heuristic_run_root_reduced_cost": False})
"""How HiGHS searches a feeder: for the bound."""


def feeder_of_buses(network: Network) -> Wholes:
    """Number of the feeder of each bus, (N,), counted from the slack bus, which has none."""
    feeder = np.full(network.n_buses, SHARED)
    count = 0
    for line, parent in enumerate(network.parent):
        if parent == 0:
            feeder[line + 1] = count
            count += 1
        else:
            feeder[line + 1] = feeder[parent]
    return feeder


def feeder_of_rows(rows: sp.csr_array, feeder: Wholes) -> Wholes:
    """Feeder of each row by that of its columns, (m,); ``SHARED`` with several, or with none."""
    entries = feeder[rows.indices]
    found = np.full(rows.shape[0], SHARED)
    full = np.flatnonzero(np.diff(rows.indptr))
    starts = rows.indptr[full]
    lowest = np.minimum.reduceat(entries, starts)
    highest = np.maximum.reduceat(entries, starts)
    found[full] = np.where(lowest == highest, lowest, SHARED)
    return found


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a feeder's search."""

    binaries: Wholes  #: positions among all binaries of those of the feeder
    served: Floats  #: their values in its answer, NaN without one
    raised: float  #: by how much it costs at least more than without binaries


class Feeders:
    """A linear problem over several feeders, and the prices at which its solution joins them.

    Parameters
    ----------
    program : Program
        Minimise; with all rows of the solution.
    solution : ProgramSolution
        Its optimum, with prices.
    feeder : array
        Feeder of each column, ``SHARED`` where it has none.
    binaries : array
        Columns that are to be zero or one.
    """

    def __init__(
        self, program: Program, solution: ProgramSolution, feeder: Wholes, binaries: Wholes
    ) -> None:
        self.program = program
        self.x = solution.x
        self.feeder = feeder
        self.binaries = binaries
        self.rows = sp.csr_array(program.rows)
        self.of_row = feeder_of_rows(self.rows, feeder)
        self.prices = program.allowed(solution.row_dual)
        of_shared = np.where(self.of_row == SHARED, self.prices, 0.0)
        self.cost = np.asarray(program.cost - of_shared @ program.rows)
        self.reduced = np.asarray(program.cost - self.prices @ program.rows)

    @property
    def fractional(self) -> Wholes:
        """Feeders in which a binary is a fraction, in order."""
        values = self.x[self.binaries]
        fraction = np.abs(values - np.round(values)) > SOLVED
        feeders = np.unique(self.feeder[self.binaries[fraction]])
        return np.asarray(feeders[feeders != SHARED])

    def search(self, number: int, deadline: Deadline, most_lost: float = MOST_LOST) -> Found:
        """Search one feeder with its binaries, the shared rows by their prices.

        Whatever departs from what is decided beforehand costs the feeder more than ``most_lost``.
        """
        columns = np.flatnonzero(self.feeder == number)
        rows = np.flatnonzero(self.of_row == number)
        binary = np.isin(columns, self.binaries)
        program = self._own(columns, rows, binary, most_lost)
        least = program.least(self.prices[rows])
        nodes = None if np.isinf(most_lost) else NODES
        solver = program.loaded(GAP, nodes, more=SEARCH)
        found = ProgramSolution.of(solver, deadline)
        of_column = np.zeros(len(self.feeder), dtype=np.int64)
        of_column[self.binaries] = np.arange(len(self.binaries))
        places = of_column[columns[binary]]
        answered = found.status.has_answer
        served = np.round(found.x[binary]) if answered else np.full(len(places), np.nan)
        bound = min(found.bound, least + most_lost)
        raised = bound - BOUND_OFF - least
        return Found(places, served, raised if raised > 0.0 else 0.0)

    def _own(self, columns: Wholes, rows: Wholes, binary: Flags, most_lost: float) -> Program:
        """A feeder's problem; binaries that would cost too much to change are decided."""
        lower = self.program.x_lower[columns].copy()
        upper = self.program.x_upper[columns].copy()
        left = self.reduced[columns]
        decided = binary & (left < -most_lost)
        lower[decided] = upper[decided]
        upper[binary & (left > most_lost)] = 0.0
        return Program(
            self.cost[columns],
            lower,
            upper,
            sp.csc_array(self.rows[rows][:, columns]),
            self.program.lower[rows],
            self.program.upper[rows],
            np.flatnonzero(binary),
        )
