"""Sets of customers that the network may carry: what is proven of all, and the next one to try.

``docs/method.md``, *Service with the network*, has the inequalities.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Floats
from vppres.solve.deadline import Deadline
from vppres.solve.programs import HALF_UNIT, SOLVED, Program, ProgramSolution
from vppres.solve.result import Status

BOUND_OFF = 1e-4
"""Units that a bound on a large window may be off by, which a solver has within its tolerance: what
a search proves gives way by it, and a set that lacks no more is asked for its dispatch."""

PREFERENCE = 0.3
"""Units for which a set may be preferred because it is close to a linear solution. Twice as much
must stay below one unit, or the best set would no longer be told from the next."""

PREFERENCE_LEFT = 0.03
"""Of the units for which a set may be preferred, how many a set may lack that ends a search."""


@dataclass
class SearchState:
    """The set last tried, the bound on all, and the best set that is carried, in units.

    ``shares`` is how far customers are served by the last linear solution.
    """

    tried: Floats
    bound: float
    shares: Floats
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
        self.bound = max(self.most, min(self.bound, float(np.floor(SOLVED - found.bound))))

    def exclude(self) -> None:
        """No set that is carried has as much as the bound."""
        self.bound = max(self.most, self.bound - 1.0)

    def improve(self, carried: Floats, units: float) -> None:
        """Keep a set that is carried if it is the best."""
        if units > self.most:
            self.best = carried
            self.most = units


class ServiceCuts:
    """Cuts on the service of sets that are carried: ``units @ x <= most + gain @ x``.

    ``able`` is 1 for who may be served.
    """

    def __init__(self, units: Floats, able: Floats) -> None:
        self.units = units
        self.able = able
        self.gains: list[Floats] = []
        self.most_units: list[float] = []
        self.first_left: Floats = np.zeros(len(units))
        self.raised: Floats = np.zeros(len(units))
        self.by_feeders = 0.0

    def add(self, left: Floats, most: float) -> float:
        """Add a bound ``most - left @ x``; returns its largest value.

        What supplying a customer costs is left out but for the first: such rows are searched
        faster.
        """
        if not self.gains:
            self.first_left = left
        self.gains.append(np.maximum(-left, 0.0))
        self.most_units.append(most + SOLVED)
        return most + float(self.gains[-1].sum())

    @property
    def first(self) -> float:
        """The first bound on all sets."""
        return self.most_units[0] + float(self.gains[0].sum()) - self.by_feeders

    def lower(self, raised: Floats, total: float) -> None:
        """Lower the first bound by what feeders' own searches take from it.

        ``raised`` is what the search of each customer's feeder takes, zero without one, and
        ``total`` the sum over the feeders. A departure from the linear solution costs a feeder that
        much for nothing, since its search has seen all of them.
        """
        self.raised = raised
        self.by_feeders = total
        gain = self.gains[0]
        searched = raised > 0.0
        self.gains.append(np.where(searched, 0.0, gain))
        self.most_units.append(self.most_units[0] + float(gain[searched].sum()) - total)

    def with_units(
        self, units: float, shares: Floats, held: Floats, deadline: Deadline
    ) -> ProgramSolution:
        """A set of just so many units; infeasible where no set that is carried has them.

        ``held`` decides the customers that it supplies where it is not NaN: of others nothing is
        proven then.
        """
        decided = np.flatnonzero(~np.isnan(held))
        program = self._program(shares, units).with_held(decided, held[decided])
        just = sp.csc_array(self.units[None, :])
        limits = np.array([units - HALF_UNIT]), np.array([units + HALF_UNIT])
        solver = program.with_range(just, *limits).loaded(
            1.0 - 2.0 * PREFERENCE, enough=PREFERENCE_LEFT - units
        )
        return ProgramSolution.of(solver, deadline)

    def _program(self, shares: Floats, at_least: float) -> Program:
        """The most units under all bounds, at least so many.

        Whose service or lack of it would alone cost too much by the first bound is decided.
        """
        away = 1.0 - shares
        spare = self.first - at_least + self.raised
        return Program(
            PREFERENCE / max(1.0, float(away.sum())) * away - self.units,
            (self.first_left < -spare).astype(float),
            (self.first_left <= spare) * self.able,
            sp.csc_array(self.units - np.array(self.gains)),
            np.full(len(self.gains), -np.inf),
            np.array(self.most_units),
            np.arange(len(self.units)),
        )
