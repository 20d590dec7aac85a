"""Cuts on demand, loss and cost: what the fleet cannot carry, as inequalities without the fleet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vppres.model.data import Floats
from vppres.model.demand import DemandModel
from vppres.solve.programs import Answer, Program, compiled
from vppres.solve.result import Status

INSIDE = 1e-9
"""Share of the way to a point that may be missing for the point to count as carried."""
VIOLATED_KW = 2e-6
"""By how much a point must violate a cut to count as cut off: what programs are solved to."""
ROUNDING = 1e-9
"""Relative slack of a cut, for the rounding of what it is computed from."""


@dataclass(frozen=True, eq=False)
class Cut:
    """``weights @ point <= most`` for every point the fleet can carry, shape (W + 2,)."""

    weights: Floats
    most: float


class Reach:
    """Separates points of demand (W), loss and cost from what the fleet can carry.

    A point is approached on the line from one that is carried for certain: no demand, all PV power
    lost, the dearest import. Where the line leaves the set, the duals are a supporting inequality.

    Parameters
    ----------
    model : DemandModel
        Filled with the window's data.
    time_s : float
        Time limit of one separation.
    """

    def __init__(self, model: DemandModel, time_s: float) -> None:
        program, first = compiled(model.problem)
        W, size = model.relaxation.n_steps, len(program.cost)
        lost, spent = model.worst()
        self.inside = np.concatenate([np.zeros(W), [-lost, -spent]])
        self.places = np.concatenate([first["load"] + np.arange(W), [first["lost"]],
                                      [first["spent"]]])
        self.signs = np.concatenate([np.ones(W), [-1.0, -1.0]])
        rows = sp.csc_array((self.signs, (np.arange(W + 2), self.places)), shape=(W + 2, size + 1))
        whole = Program(
            np.append(program.cost, -1.0), np.append(program.x_lower, 0.0),
            np.append(program.x_upper, 1.0),
            sp.csc_array(sp.vstack([sp.hstack([program.rows, sp.csc_array((len(program.lower),
                                                                           1))]), rows])),
            np.append(program.lower, self.inside), np.append(program.upper, np.full(W + 2, np.inf)),
            program.integer)
        self.first_row, self.share = len(program.lower), size
        self.solver = whole.loaded(time_s)

    def separate(self, point: Floats) -> tuple[Status, Cut | None]:
        """A cut that a point violates; none if the fleet can carry it."""
        way = self.signs * point - self.inside
        for row, step in enumerate(way):
            self.solver.changeCoeff(self.first_row + row, self.share, -float(step))
        answer = Answer.of(self.solver)
        if answer.status != Status.OPTIMAL or answer.x[self.share] >= 1.0 - INSIDE:
            return answer.status, None
        prices = answer.row_dual[self.first_row:]
        weights = np.maximum(prices, 0.0) * self.signs
        most = float(weights @ answer.x[self.places])
        size = float(np.abs(weights).max())
        cut = Cut(weights / size, (most + ROUNDING * abs(most)) / size)
        return answer.status, cut if cut.weights @ point > cut.most + VIOLATED_KW else None
