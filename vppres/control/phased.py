"""Windows of a phased feeder: solve, power flow by phase of the candidate, linearise, solve again.

Rows of voltages are stated only for nodes that a candidate has put outside its limits.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any, ClassVar

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.converged import (
    DEFAULT_HEADROOM,
    DEFAULT_PASSES,
    FIRST_SHARE,
    PassesPlanner,
    after,
    dark_steps,
    in_the_dark,
    physics_of,
    without_power,
)
from vppres.control.phased_window import PhasedLinearisation
from vppres.core.arrays import Floats
from vppres.core.errors import InfeasibleError, NumericalError
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.beyond_paper.phases import out_of_limits
from vppres.model.data import WindowData
from vppres.model.phases import phased_model
from vppres.physics.phased_sources import farthest
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import Status, WindowSolution

MOST_ROUNDS = 6
"""Times that nodes outside their limits are added to a window's rows."""

MOST_NEW = 12
"""Nodes that are added in a round, those farthest outside first."""

INSIDE_PU2 = 2e-5
"""By how much a squared voltage may leave its limit before its node gets rows: 1e-5 pu."""

PASSES = 2 * DEFAULT_PASSES
"""Passes of a window: the former's phases settle later than its voltages."""

MOST_DECISIONS = 4
"""Times that the served set of a window is decided."""


class PhasedPlanner(PassesPlanner):
    """Plans windows of a phased site that its three-phase power flow agrees with.

    Parameters
    ----------
    solver : WindowSolver
        Solves the windows.
    headroom : float, optional
        Share of a grid-forming battery's rating, and of each phase of it, that stays free.
    passes : int, optional
        Largest number of solves and power flows of a window.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"_watched": tuple[int, ...]}

    def __init__(
        self, solver: WindowSolver, headroom: float = DEFAULT_HEADROOM, passes: int = PASSES
    ) -> None:
        super().__init__(solver, headroom, passes)
        self.model = phased_model(solver.site)
        self._linearisation = PhasedLinearisation(self.model)
        self._watched: tuple[int, ...] = ()

    def plan(
        self, observation: Observation, n_steps: int | None = None, within_s: float = inf
    ) -> WindowSolution:
        """Solution of the observed window, or of its first steps.

        Raises
        ------
        SolveError
            If no dispatch was found.
        """
        site = self.solver.site
        whole = WindowData.of(observation, site, "none")
        whole = whole if n_steps is None else whole.first(n_steps)
        physics = physics_of(site, whole, self.headroom)
        dark = dark_steps(site, whole)
        data = replace(without_power(whole, dark), physics=physics)
        data = self._linearisation.at_rest(data, self._watched)
        deadline = Deadline(min(self.solver.limits.time_s, within_s))
        data, solution = self._decide(data, deadline.part(FIRST_SHARE))
        solution = self._converge(data, solution, deadline)
        return in_the_dark(site, whole, dark, solution, self.solver.limits)

    def _decide(self, data: WindowData, deadline: Deadline) -> tuple[WindowData, WindowSolution]:
        """The served set, with rows for all nodes that it would put outside their limits."""
        solution = self._solved(data, deadline)
        for _ in range(MOST_ROUNDS):
            wider = self._wider(data, solution.dispatch)
            if wider is None or deadline.passed:
                break
            data = wider
            solution = after(solution, self._solved(data, deadline))
        return data, solution

    def _solved(self, data: WindowData, deadline: Deadline) -> WindowSolution:
        """A window solved; states of charge that miss a need by rounding are nudged."""
        try:
            return self.solver.solve(data, deadline.left_s)
        except (InfeasibleError, NumericalError):
            return self.solver.solve(self.nudged(data), deadline.left_s)

    def _wider(self, data: WindowData, dispatch: Dispatch) -> WindowData | None:
        """The window with rows of nodes that a dispatch puts outside; None if there are none."""
        phased = data.require_phased()
        served = data.for_service(dispatch.served)
        p, q = self.model.drawn(served, dispatch)
        over = out_of_limits(self.solver.site, served, p, q)
        over = np.where(lit_steps(data)[:, None], over, -np.inf).max(axis=0)
        over[list(phased.watched)] = -np.inf
        worst = np.argsort(over)[::-1][:MOST_NEW]
        new = {int(i) for i in worst if over[i] > INSIDE_PU2}
        if not new:
            return None
        self._watched = tuple(sorted({*phased.watched, *new}))
        return replace(data, phased=replace(phased, watched=self._watched))

    def _converge(
        self, data: WindowData, solution: WindowSolution, deadline: Deadline
    ) -> WindowSolution:
        """The candidate at which model and power flow meet."""
        decided = solution
        lit = lit_steps(data)
        passes = 1
        decisions = 1
        while True:
            p, q = self._drawn(data, solution.dispatch)
            points = self.model.points(data, p, q, lit)
            agreed = self._linearisation.agree(data, p, q, points, lit)
            closer = self._linearisation.at(data, p, q, points, lit & points.converged)
            wider = self._wider(closer, solution.dispatch)
            if (agreed and wider is None) or passes >= self.passes or deadline.passed:
                break
            more = decisions < MOST_DECISIONS
            again, anew = self.again(
                wider or closer, solution, deadline, keeps_turns=passes > 1, decides=more
            )
            if again is None:
                break
            if anew:
                decided = again
                decisions += 1
            data, solution = wider or closer, again
            passes += 1
        carried = bool(points.converged[lit].all())
        v_pu = self._linearisation.v_pu(data, p, q)
        at_buses = farthest(v_pu, self.model.at_bus, self.solver.site.network.n_buses)
        return replace(
            decided,
            status=decided.status if carried else Status.INACCURATE,
            dispatch=replace(solution.dispatch, v_pu=at_buses, v_node_pu=v_pu),
            terms=solution.terms,
            loss_kw=solution.loss_kw,
            passes=passes,
            solve_s=solution.solve_s,
            solver_s=solution.solver_s,
        )

    def _drawn(self, data: WindowData, dispatch: Dispatch) -> tuple[Floats, Floats]:
        """What a dispatch has each asset draw, (W, D) each."""
        return self.model.drawn(data.for_service(dispatch.served), dispatch)
