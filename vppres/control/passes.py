"""Passes of a window's plan: the AC points of the last candidate, and a solve of its set there.

From the third on batteries keep their turns, by phase that to rest too: two plans that are worth
the same may charge in different steps, and what they lose is never the same. The set is decided
anew only where the losses leave it no dispatch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.control.linearisation import Linearisation, Points
from vppres.core.errors import InfeasibleError, LimitError, NumericalError
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.beyond_paper.unspent import SPENT_KW, spent_kw, unspent
from vppres.model.data import Unspent, WindowData
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import Status, WindowSolution

_LITTLE_KW = 1e-6
_MAX_DECISIONS = 3


@dataclass(frozen=True, eq=False)
class Passes:
    """Moves the linearisation of a window until AC agrees with its plan."""

    solver: WindowSolver
    linearisation: Linearisation[Any]
    most: int  #: largest number of solves and power flows
    deadline: Deadline

    def converged(
        self, data: WindowData, solution: WindowSolution
    ) -> tuple[WindowData, WindowData, WindowSolution]:
        """The candidate at which model and AC meet: its window, that linearised there, and it."""
        data, solution = self._kept(data, solution)
        decided = solution
        decisions = 1
        passes = 1
        points = self.linearisation.points(data, solution.dispatch)
        while passes < self.most and not self.agree(data, solution.dispatch, points):
            plan = solution.dispatch
            closer = self.linearisation.closer(data, plan, points, passes)
            freed = replace(closer, unspent=Unspent.absent())
            if data.unspent:
                limits = unspent(self.solver.site, closer, plan, data.network_kw)
                closer = replace(closer, unspent=limits)
            found = self.solver.solve_served(
                closer, plan.served, plan, passes > 1, within_s=self.deadline.left_s
            )
            if found is not None:
                data, solution = closer, found.after(solution)
            elif decisions < _MAX_DECISIONS and (anew := self._decided_anew(freed)) is not None:
                data, solution = self._kept(freed, anew.after(solution))
                decided = solution
                decisions += 1
            else:
                break
            passes += 1
            points = self.linearisation.points(data, solution.dispatch)
        reached = self.linearisation.closer(data, solution.dispatch, points, passes)
        carried = bool(points.converged[lit_steps(data)].all())
        converged = replace(
            decided.carried_by(solution),
            status=decided.status if carried else Status.INACCURATE,
            passes=passes,
        )
        return data, reached, converged

    def agree(self, data: WindowData, dispatch: Dispatch, points: Points) -> bool:
        """Whether AC carries a candidate in every step with power, as its window says."""
        lit = lit_steps(data)
        if not points.converged[lit].all():
            return False
        return not lit.any() or self.linearisation.agrees(data, dispatch, points)

    def _decided_anew(self, data: WindowData) -> WindowSolution | None:
        """A closer window with its set, None if there is none, or no time to find it."""
        if self.deadline.passed:
            return None
        try:
            return self.solver.solve(data, self.deadline.left_s)
        except (InfeasibleError, NumericalError, LimitError):
            return None

    def _kept(
        self, data: WindowData, solution: WindowSolution
    ) -> tuple[WindowData, WindowSolution]:
        """Plan of the same supply in which nothing stored is spent while PV power is curtailed.

        Objective and bound stay those of the window in which the supply was decided. If the
        network has no such dispatch, both stay as they are.
        """
        site = self.solver.site
        plan = solution.dispatch
        if not data.parts.whole:  # what one part curtails no battery of another could keep
            return data, solution
        if self.deadline.passed or not (spent_kw(site, data, plan) > SPENT_KW).any():
            return data, solution
        limited = replace(data, unspent=unspent(site, data, plan, data.network_kw))
        found = self.solver.solve_served(
            limited, plan.served, _charging_beside_pv(limited, plan), within_s=self.deadline.left_s
        )
        if found is None or (spent_kw(site, data, found.dispatch) > SPENT_KW).any():
            return data, solution
        return limited, solution.carried_by(found.after(solution), "unspent", *found.stages)


def _charging_beside_pv(data: WindowData, plan: Dispatch) -> Dispatch:
    """A plan whose batteries' turns are to charge wherever they may give nothing."""
    nothing = data.unspent.discharge_kw <= 0.0
    return replace(
        plan,
        charge_kw=np.where(nothing, np.maximum(plan.charge_kw, _LITTLE_KW), plan.charge_kw),
        discharge_kw=np.where(nothing, 0.0, plan.discharge_kw),
    )
