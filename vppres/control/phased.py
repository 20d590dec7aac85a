"""Windows of a phased feeder: passes of solves and power flows by phase."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Any, ClassVar

from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.converged import (
    DEFAULT_HEADROOM,
    DEFAULT_PASSES,
    FIRST_SHARE,
    LOSS_TOLERANCE_KW,
    PassesPlanner,
    dark_steps,
    in_the_dark,
    physics_of,
    without_power,
)
from vppres.control.last_window import NO_ROW, LastWindow, kinds_of
from vppres.control.phased_window import PhasedLinearisation
from vppres.core.arrays import Flags
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData
from vppres.model.phases import PhasedPoints, phased_model
from vppres.physics.phased_sources import farthest
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

PASSES = 2 * DEFAULT_PASSES
"""Passes of a window: the former's phases settle later than its voltages."""

FIRST_DAMPED = 3
"""Pass after which a window moves only halfway to the AC points: two candidates whose reactive
power differs may follow each other for ever otherwise."""


class PhasedPlanner(PassesPlanner[PhasedPoints]):
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

    REMEMBERED: ClassVar[dict[str, Any]] = {"_last": LastWindow | None}

    def __init__(
        self, solver: WindowSolver, headroom: float = DEFAULT_HEADROOM, passes: int = PASSES
    ) -> None:
        super().__init__(solver, headroom, passes)
        self.model = phased_model(solver.site)
        self._linearisation = PhasedLinearisation(self.model)
        self._last: LastWindow | None = None

    def plan(
        self, observation: Observation, n_steps: int | None = None, within_s: float = inf
    ) -> WindowSolution:
        """Solution of the observed window, or of its first steps.

        Raises
        ------
        SolveError
            If no dispatch was found.
        """
        whole, dark, start = self.begun(observation, n_steps)
        data = self._started_where_last(observation.t0, start)
        deadline = Deadline(min(self.solver.limits.time_s, within_s))
        data, solution = self.decide(data, start, deadline.part(FIRST_SHARE))
        data, reached, solution = self.converge(data, solution, deadline)
        self._remember(observation.t0, reached, solution.dispatch)
        solution = self._with_voltages(data, solution)
        return in_the_dark(self.solver.site, whole, dark, solution, self.solver.limits)

    def begun(
        self, observation: Observation, n_steps: int | None = None
    ) -> tuple[WindowData, Flags, WindowData]:
        """The observed window, its steps without power, and the window that is solved first."""
        site = self.solver.site
        whole = WindowData.of(observation, site, "none")
        whole = whole if n_steps is None else whole.first(n_steps)
        physics = physics_of(site, whole, self.headroom, LOSS_TOLERANCE_KW)
        dark = dark_steps(site, whole)
        data = replace(without_power(whole, dark), physics=physics)
        return whole, dark, self._linearisation.at_rest(data)

    def _started_where_last(self, t0: int, start: WindowData) -> WindowData:
        """The window at the plan before, or in steps that this had not at its last step like them.

        A plan at rest has no losses, and its first set may be one too many.
        """
        if self._last is None:
            return start
        rows = self._last.rows_for(t0, start)
        known = rows != NO_ROW
        p, q = (values[rows] for values in self._last.rows)
        points = self.model.points(start, p, q, known)
        return self._linearisation.at(start, p, q, points, known & points.converged)

    def _remember(self, t0: int, data: WindowData, plan: Dispatch) -> None:
        """Keep what assets draw in a plan, and what its steps are."""
        p, q = self.model.drawn(data.for_service(plan.served), plan)
        self._last = LastWindow(t0, kinds_of(data), (p, q))

    def ac_points(self, data: WindowData, dispatch: Dispatch) -> PhasedPoints:
        """AC points of a candidate, step by step."""
        p, q = self.model.drawn(data.for_service(dispatch.served), dispatch)
        return self.model.points(data, p, q, lit_steps(data))

    def agrees(self, data: WindowData, dispatch: Dispatch, points: PhasedPoints) -> bool:
        """Whether voltages, the former and what the network draws agree with AC."""
        p, q = self.model.drawn(data.for_service(dispatch.served), dispatch)
        return self._linearisation.agree(data, p, q, points, lit_steps(data))

    def closer(
        self, data: WindowData, dispatch: Dispatch, points: PhasedPoints, passes: int
    ) -> WindowData:
        """The window linearised at a candidate's AC points, or halfway there."""
        p, q = self.model.drawn(data.for_service(dispatch.served), dispatch)
        steps = lit_steps(data) & points.converged
        share = 1.0 if passes < FIRST_DAMPED else 0.5
        return self._linearisation.at(data, p, q, points, steps, share)

    def _with_voltages(self, data: WindowData, solution: WindowSolution) -> WindowSolution:
        """The solution with its voltages by phase, and of each bus that farthest from 1 pu."""
        plan = solution.dispatch
        p, q = self.model.drawn(data.for_service(plan.served), plan)
        v_pu = self._linearisation.v_pu(data, p, q)
        at_buses = farthest(v_pu, self.model.at_bus, self.solver.site.network.n_buses)
        return replace(solution, dispatch=replace(plan, v_pu=at_buses, v_node_pu=v_pu))
