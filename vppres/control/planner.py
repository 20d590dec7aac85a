"""From an observation to the solution of its window, and from a solution to its record.

A window with switching rules always has an answer: duties that cannot be met are let go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from vppres.contract.decision import SolveInfo
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.core.errors import InfeasibleError
from vppres.model.data import WindowData
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution


def plan_with_rules(
    planner: Planner, observation: Observation, n_steps: int | None = None
) -> tuple[WindowSolution, bool]:
    """Plan a window by its rules, or without the duties of the past where these have no answer.

    Forecast errors can make it impossible to serve whoever was restored lately. Then nobody has to
    be served, and everybody may be switched off; minimum times off stay, and so does all that the
    window itself begins.

    Parameters
    ----------
    planner : Planner
        Plans the windows.
    observation : Observation
        What is known, with rules or without.
    n_steps : int, optional
        First steps of the window alone.

    Returns
    -------
    WindowSolution
        The answer.
    bool
        Whether duties were let go.

    Raises
    ------
    SolveError
        If there is no answer without the duties either.
    """
    try:
        return planner.plan(observation, n_steps), False
    except InfeasibleError:
        if observation.switching is None:
            raise
        freed = replace(observation, switching=replace(observation.switching, duties=False))
        return planner.plan(freed, n_steps), True


class Planner(Protocol):
    """Turns an observation into the solution of its window."""

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""


@dataclass(frozen=True, eq=False)
class OnePass:
    """The paper's mode: one solve, linearised at the last AC point.

    Parameters
    ----------
    solver : WindowSolver
        Solves the windows.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    """

    solver: WindowSolver
    centre: Centre = "lossless"

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""
        data = WindowData.of(observation, self.solver.site, self.centre)
        return self.solver.solve(data if n_steps is None else data.first(n_steps))


def solve_info(
    solution: WindowSolution, compilations: int, switching_relaxed: bool = False
) -> SolveInfo:
    """How a window's solution was found, for the record of its decision."""
    return SolveInfo(
        objective=solution.objective,
        bound=solution.bound,
        gap=solution.gap,
        gap_abs=solution.gap_abs,
        gap_service=solution.service_gap,
        gap_cost_gbp=solution.cost_gap_gbp,
        status=str(solution.status),
        solve_s=solution.solve_s,
        solver_s=solution.solver_s,
        compilations=compilations,
        stages=" ".join(solution.stages),
        passes=solution.passes,
        switching_relaxed=switching_relaxed,
    )
