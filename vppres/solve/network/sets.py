"""Sets of customers that the network may carry: what is proven of all, and the next one to try.

``docs/method.md``, *Service in the network*, has the inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats
from vppres.solve.deadline import Deadline
from vppres.solve.programs import Program, ProgramSolution
from vppres.solve.result import Status

NEAR = 0.3
"""Units for which a set may be preferred because it is close to a linear solution. Twice as much
must stay below one unit, or the best set would no longer be told from the next."""

CLOSE = 0.03
"""Of the units for which a set may be preferred, how many a set may lack that ends a search."""

TOLERANCE = 1e-6
"""Feasibility tolerance of the solver: what a share or a whole number may be off by."""


@dataclass
class Known:
    """The set last tried, the bound on all, and the best set that is carried, in units."""

    tried: Floats
    bound: float
    best: Floats | None = None
    most: float = -np.inf

    def closed(self) -> bool:
        """Whether the best set has as much as the bound."""
        return self.most >= self.bound

    def take(self, found: ProgramSolution) -> None:
        """The next set to try, and what its search proves."""
        if found.status == Status.INFEASIBLE:
            self.bound = self.most
        elif found.status.has_answer:
            self.tried = np.round(found.x)
        self.bound = max(self.most, min(self.bound, float(np.floor(TOLERANCE - found.bound))))

    def follow(self, found: ProgramSolution, units: Floats) -> bool:
        """Try a set of a search that proves nothing, if it would be the best."""
        better = found.status.has_answer and units @ np.round(found.x) > self.most
        if better:
            self.tried = np.round(found.x)
        return bool(better)

    def improve(self, carried: Floats, units: float) -> None:
        """Keep a set that is carried if it is the best."""
        if units > self.most:
            self.best = carried
            self.most = units


class ServiceCuts:
    """What is known of the service of sets that are carried: ``units @ x <= most + gain @ x``."""

    def __init__(self, units: Floats) -> None:
        self.units = units
        self.gains: list[Floats] = []
        self.most_units: list[float] = []
        self.first_left: Floats = np.zeros(len(units))

    def add(self, left: Floats, most: float) -> float:
        """Add a bound ``most - left @ x``; returns its largest value.

        What serving somebody costs is left out but for the first: such rows are searched faster.
        """
        if not self.gains:
            self.first_left = left
        self.gains.append(np.maximum(-left, 0.0))
        self.most_units.append(most + TOLERANCE)
        return most + float(self.gains[-1].sum())

    def most(
        self,
        shares: Floats,
        at_least: float,
        deadline: Deadline,
        held: Floats | None = None,
        at_most: float = np.inf,
        most_nodes: int | None = None,
    ) -> ProgramSolution:
        """The set with the most units, at least so many; among equal ones one close to the shares.

        Closeness counts for less than ``NEAR`` of a unit, and the bound is raised by as much. Whose
        service or lack of it would alone cost too much by the first bound is decided beforehand;
        ``held`` decides more, where it is not NaN: the bound is that of such sets then. A close set
        of the units that no set exceeds ends the search, and so do so many nodes.
        """
        away = 1.0 - shares
        spare = self.most_units[0] + float(self.gains[0].sum()) - at_least
        cost = NEAR / max(1.0, float(away.sum())) * away - self.units
        low = self.first_left < -spare
        high = self.first_left <= spare
        if held is not None:
            low = np.where(np.isnan(held), low, held > 0.5)
            high = np.where(np.isnan(held), high, held > 0.5)
        program = Program(
            cost,
            low.astype(float),
            high.astype(float),
            sp.csc_array(self.units - np.array(self.gains)),
            np.full(len(self.gains), -np.inf),
            np.array(self.most_units),
            np.arange(len(cost)),
        )
        solver = program.loaded(1.0 - 2.0 * NEAR, most_nodes, enough=CLOSE - at_most)
        found = ProgramSolution.of(solver, deadline)
        return replace(found, bound=found.bound - NEAR)
