"""Headroom in strict order: it is kept after the first tier is supplied, never in its place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

from vppres.contract.observation import Observation
from vppres.control.converged import ConvergedPlanner
from vppres.control.remembered import PART
from vppres.core.errors import InfeasibleError, NumericalError, SolveError
from vppres.solve.deadline import Deadline
from vppres.solve.result import WindowSolution

RELEASED = "headroom_released"
"""Stands before the stages of a window that was planned without headroom."""


class HeadroomPlanner:
    """Plans with headroom, and without it where that supplies more of the first tier.

    ``planner_of`` makes the planner of a site in strict order that leaves so much of the rating of
    grid-forming batteries free in an island.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"kept": PART, "released": PART}

    def __init__(self, planner_of: Callable[[float], ConvergedPlanner], headroom: float) -> None:
        self.kept = planner_of(headroom)
        self.released = planner_of(0.0)

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps.

        Raises
        ------
        SolveError
            If no dispatch was found, not even without headroom.
        """
        deadline = Deadline(self.kept.solver.limits.time_s)
        try:
            kept = self.kept.plan(observation, n_steps)
        except (InfeasibleError, NumericalError):
            return _with_stage(self.released.plan(observation, n_steps, deadline.left_s))
        if self._first_tier(kept) == self._whole_first_tier(kept) or deadline.passed:
            return kept
        try:
            released = self.released.plan(observation, n_steps, deadline.left_s)
        except SolveError:
            return kept
        more = self._first_tier(released) > self._first_tier(kept)
        return _with_stage(released) if more else kept

    def _first_tier(self, solution: WindowSolution) -> int:
        """Units of the first tier that a plan supplies."""
        ranks = self.kept.solver.site.ranks
        assert ranks is not None
        return int(ranks.supplied(solution.dispatch.served)[0])

    def _whole_first_tier(self, solution: WindowSolution) -> int:
        """Units of the first tier with all customers supplied."""
        ranks = self.kept.solver.site.ranks
        assert ranks is not None
        return int(ranks.units[ranks.tier == 0].sum()) * solution.dispatch.n_steps


def _with_stage(solution: WindowSolution) -> WindowSolution:
    return replace(solution, stages=(RELEASED, *solution.stages))
