"""A window with switching rules always has an answer: duties that cannot be met are let go."""

from __future__ import annotations

from dataclasses import replace

from vppres.controllers.base import Observation, Planner
from vppres.errors import InfeasibleError
from vppres.solve.result import WindowSolution


def plan_with_rules(planner: Planner, observation: Observation,
                    n_steps: int | None = None) -> tuple[WindowSolution, bool]:
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
