"""Cuts on demand, loss and cost: what the fleet cannot carry, as inequalities without the fleet."""

from __future__ import annotations

from dataclasses import dataclass

import highspy
import numpy as np

from vppres.core.arrays import Floats
from vppres.model.numerics import SAME
from vppres.solve.deadline import Deadline
from vppres.solve.fleet.demand import DemandModel
from vppres.solve.programs import SOLVED, ProgramSolution, add_row, program_of
from vppres.solve.result import Status


@dataclass(frozen=True, eq=False)
class Cut:
    """``weights @ point <= most`` for every point the fleet can carry, shape (W + 2,)."""

    weights: Floats
    most: float

    def add_to(self, solver: highspy.Highs) -> None:
        """Add it to a solver whose first columns are demand, loss and cost."""
        columns = np.flatnonzero(self.weights)
        add_row(solver, columns, self.weights[columns], -np.inf, self.most)


class Reach:
    """Separates points of demand (W), loss and cost from what the fleet can carry.

    How far a point is outside is measured along one direction: less of all demand, more loss and
    more cost, in proportion to the most there can be. One step of it is carried for certain. Only
    right-hand sides change from point to point, so a solve starts where the last one ended.

    Parameters
    ----------
    model : DemandModel
        Filled with the window's data.
    """

    def __init__(self, model: DemandModel) -> None:
        program = program_of(model)
        W = model.n_steps
        self.places = np.concatenate([model.at(name) for name in ("load", "lost", "spent")])
        self.signs = np.concatenate([np.ones(W), [-1.0, -1.0]])
        # From any loss and cost there can be, one step leads to the worst, carried for certain.
        ranges = np.array(model.worst()) - np.array(model.least())
        direction = np.concatenate([model.load_kw, ranges])
        self.program = program
        self.direction = direction
        self.constant = np.append(np.zeros(W, dtype=bool), ranges <= 0.0)
        self.largest = float(direction.max() + model.fleet_kw)
        self.asked = len(program.lower) + np.arange(W + 2, dtype=np.int32)
        self.solver = self._new_solver()

    def _new_solver(self) -> highspy.Highs:
        """A solver of the fleet's program with one column more, the step along the direction."""
        solver = self.program.loaded_by_shares()
        step = len(self.program.cost)
        # The duals sum to the cost of a step in proportion to the direction: of order one.
        solver.addCol(max(self.direction.max(), 1.0), 0.0, np.inf, 0, [], [])
        for place, sign, towards in zip(self.places, self.signs, self.direction, strict=True):
            add_row(solver, np.array([place, step]), np.array([sign, towards]), 0.0, np.inf)
        return solver

    def separate(self, point: Floats, deadline: Deadline) -> tuple[Status, Cut | None]:
        """A cut that a point violates; none if the fleet can carry it."""
        count = len(self.asked)
        least = self.signs * point
        self.solver.changeRowsBounds(count, self.asked, least, np.full(count, np.inf))
        answer = ProgramSolution.of(self.solver, deadline)
        if answer.status != Status.OPTIMAL:
            return answer.status, None
        # The duals of a point outside support what is carried where the solution lies.
        weights = np.maximum(answer.row_dual[self.asked], 0.0) * self.signs
        size = float(np.abs(weights).max())
        if size == 0.0:
            return answer.status, None
        # A loss or cost of next to no price would join the whole window, and service be no number.
        weights[-2:][np.abs(weights[-2:]) < SAME * size] = 0.0
        most = self._most(weights, answer.row_dual[: self.asked[0]])
        # One that can have a single value alone has any price.
        most -= float(weights[self.constant] @ point[self.constant])
        weights[self.constant] = 0.0
        size = float(np.abs(weights).max()) or size
        cut = Cut(weights / size, most / size)
        # The search that found the point and this one may each be off.
        return answer.status, cut if cut.weights @ point > cut.most + 2.0 * SOLVED else None

    def _most(self, weights: Floats, prices: Floats) -> float:
        """Upper bound on a weighted sum of demand, loss and cost, from any prices of the rows.

        Weak duality: it holds whatever the tolerance of the prices, since no column is larger than
        ``largest``.
        """
        worth, left = self.program.priced(prices)
        left[self.places] -= weights
        two_sided = ~np.isfinite(self.program.x_lower)
        below = np.where(two_sided, np.abs(left), np.maximum(-left, 0.0))
        return -worth + float(below.sum()) * self.largest
