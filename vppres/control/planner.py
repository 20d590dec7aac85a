"""From an observation to the solution of its window, and from a solution to its record.

A window with switching rules always has an answer: duties that cannot be met are dropped.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.core.errors import InfeasibleError
from vppres.model.data import WindowData
from vppres.model.site import LESS_THAN_A_UNIT, Site
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution


def plan_with_rules(
    planner: Planner, observation: Observation, n_steps: int | None = None
) -> WindowSolution:
    """Plan a window by its rules, or without the duties of the past where these have no answer.

    Forecast errors can make it impossible to supply customers restored lately. Then no customer has
    to be supplied, every customer may be switched off, and no generating set has to stay on.
    Minimum times off stay, and so does all that the window itself begins.

    Raises
    ------
    SolveError
        If there is no answer without the duties either.
    """
    try:
        return planner.plan(observation, n_steps)
    except InfeasibleError:
        past, ahead = observation.switching, observation.ahead
        if not past.matters and not ahead.switched:
            raise
        freed = replace(
            observation,
            switching=replace(past, duties=False),
            ahead=ahead.without_duties(),
        )
        return replace(planner.plan(freed, n_steps), switching_relaxed=True)


class Planner(Protocol):
    """Turns an observation into the solution of its window."""

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""


@dataclass(frozen=True, eq=False)
class OnePass:
    """The paper's mode: one solve, linearised at the last AC point."""

    solver: WindowSolver  #: solves the windows
    centre: Centre = "lossless"  #: linearisation centre of the voltages

    def plan(self, observation: Observation, n_steps: int | None = None) -> WindowSolution:
        """Solution of the observed window, or of its first steps."""
        data = WindowData.of(observation, self.solver.site, self.centre)
        window = data if n_steps is None else data.first(n_steps)
        return self.solver.solve(window, observation.within_s)


def decided(solver: WindowSolver, solution: WindowSolution) -> Decision:
    """The first step of a window's solution."""
    info = replace(info_of(solver.site, solution), compilations=solver.compilations)
    return Decision(solution.dispatch, 0, info)


def info_of(site: Site, solution: WindowSolution) -> SolveInfo:
    """Figures of a window's solution, and the levels of its tiers."""
    return replace(solution.figures, levels=levels_of(site, solution))


def levels_of(site: Site, solution: WindowSolution) -> str:
    """Units of each tier that a window supplies, and how many it could at most: ``critical 29/30``.

    A unit is a customer in a step. Empty where tiers are weighed against each other, or later
    service against that of the window.
    """
    terms = solution.terms
    if site.ranks is None or terms.f7 or not np.isfinite(solution.service_gap):
        return ""
    service = terms.f1 - site.weights.lambda_curt * terms.f3 - terms.f6 + solution.service_gap
    # Of schedules that exceed the longest times off no more than this one. Its actions are in the
    # same term, and only loosen the bound.
    if np.isfinite(site.customers.longest_off_h).any():
        service += terms.f6
    # What curtailment and actions take from the service of other schedules is not known.
    bound = service / site.dt_h + LESS_THAN_A_UNIT + site.ranks.actions
    served = solution.dispatch.served
    supplied = site.ranks.supplied(served)
    most = site.ranks.most(served, bound)
    rows = zip(site.ranks.tiers, supplied, most, strict=True)
    return ", ".join(f"{tier} {units}/{possible}" for tier, units, possible in rows)
