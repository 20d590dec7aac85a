"""The problem of a window in the network, and limits of it as solutions violate them.

It has no lines and buses: limits of voltages and tangents of discs are added where a solution
violates them, so every solution on the way is one of a relaxation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import highspy
import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Deadline
from vppres.solve.network.injections import Injections
from vppres.solve.network.rows import Rows, add, limited
from vppres.solve.programs import SOLVED, Program, ProgramSolution
from vppres.solve.result import Status
from vppres.solve.sizes import is_large

DISC = 2e-3
"""Share of its radius by which a disc may be exceeded in a relaxation: a bound need not be sharp
where few discs bind, and sharper ones take several times as many rounds."""


SETTLED = 1e-3
"""By how much a relaxation of a large window must still change for its limits to be looked for on:
most of the rounds add a handful of tangents that change nothing."""


class NetworkProgram:
    """Columns and rows of a window, and the limits of the network that were found so far.

    Attributes
    ----------
    found : list of Rows
        Limits on the program's columns.
    unfinished : array or None
        Columns of the model at the last solution that still violated limits when time was up.
    """

    def __init__(self, cache: ModelCache, data: WindowData) -> None:
        self.model = Injections(cache, data)
        self.found: list[Rows] = []
        self.unfinished: Floats | None = None
        self.is_large = is_large(cache.site, data.n_steps)
        program = self.model.program
        self.program = self._in_parts(program) if self.is_large else program
        if near := self.model.limits.near:
            self.found.append(self._limits(near))

    def _in_parts(self, program: Program) -> Program:
        """The program with reactive power given and taken apart.

        A simplex method begins with columns at their limits. As one column, the reactive power of
        an inverter that need not have any begins at all of it, and its disc is violated for
        nothing: that takes three times as many tangents.
        """
        parts = self.model.parts
        signed = len(program.cost) + np.arange(parts.shape[1] - len(program.cost))
        taken = parts[:, signed].tocoo().row
        lower = np.append(program.x_lower, np.zeros(len(taken)))
        lower[taken] = 0.0
        return replace(
            program,
            cost=np.append(program.cost, np.zeros(len(taken))),
            x_lower=lower,
            x_upper=np.append(program.x_upper, -program.x_lower[taken]),
            rows=sp.csc_array(program.rows @ parts),
        )

    @property
    def limits(self) -> int:
        """How many limits of the network are known."""
        return sum(len(rows.lower) for rows in self.found)

    def apart(self) -> NetworkProgram:
        """Copy with limits of its own from here on."""
        other = copy(self)
        other.found = list(self.found)
        other.unfinished = None
        return other

    def _limits(self, found: Sequence[Rows]) -> Rows:
        """Rows on the model's columns as rows on the program's."""
        rows = Rows.joined(found)
        if not self.is_large:
            return rows.wider(len(self.program.cost))
        return replace(rows, matrix=sp.csr_array(rows.matrix @ self.model.parts))

    def columns(self, answer: ProgramSolution) -> Floats:
        """The model's columns of a solution."""
        if self.is_large:
            return np.asarray(self.model.parts @ answer.x)
        return answer.x[: self.model.size]

    def with_cost(self, columns: Wholes, values: Floats) -> Program:
        """The program with an objective."""
        cost = np.zeros(len(self.program.cost))
        cost[columns] = values
        return replace(self.program, cost=cost)

    def loaded(self, program: Program) -> highspy.Highs:
        """A solver with the program and the limits that were violated so far."""
        return limited(program, self.found).loaded()

    def of_set(self, served: Floats | Flags) -> Program:
        """Least cost of a set."""
        return self.program.with_held(self.model.at("x_served"), served)

    def start(self, solver: highspy.Highs) -> None:
        """Let a solver begin with idle batteries, all PV power and all customers supplied.

        From there the energies need no steps; from nothing they take a third of them all.
        """
        columns, rows = self.model.start()
        kinds = highspy.HighsBasisStatus
        of_columns = np.full(solver.getNumCol(), kinds.kLower, dtype=object)
        of_columns[self.model.at("x_served")] = kinds.kUpper
        of_columns[columns] = kinds.kBasic
        of_rows = np.full(solver.getNumRow(), kinds.kBasic, dtype=object)
        of_rows[rows] = kinds.kUpper
        of_rows[rows[np.isfinite(self.program.lower[rows])]] = kinds.kLower
        basis = highspy.HighsBasis()
        basis.col_status = of_columns.tolist()
        basis.row_status = of_rows.tolist()
        basis.valid = True
        solver.setBasis(basis)

    def until_carried(
        self,
        solver: highspy.Highs,
        deadline: Deadline,
        over: float = DISC,
        enough: Callable[[ProgramSolution], bool] = lambda _: False,
    ) -> ProgramSolution:
        """Solve, add the limits that are violated, and again until none is.

        Or until a solution is enough, or a large relaxation has settled. A
        solver that meets limits only within a tolerance may violate the same ones for ever: then
        time ends it.
        """
        settled = SETTLED if self.is_large and over >= DISC else 0.0
        before = np.inf
        while True:
            answer = ProgramSolution.of(solver, deadline)
            if answer.status != Status.OPTIMAL or enough(answer):
                return answer
            if abs(answer.value - before) < settled:
                return answer
            before = answer.value
            x = self.columns(answer)
            violated = [
                *self.model.limits.exceeded(x, SOLVED),
                *self.model.disc_rows(x, over),
            ]
            if not violated:
                return answer
            if deadline.passed:
                self.unfinished = x
                return replace(answer, status=Status.NO_ANSWER)
            rows = self._limits(violated)
            self.found.append(rows)
            add(solver, rows)
