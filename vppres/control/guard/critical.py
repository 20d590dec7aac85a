"""Customers of the first tier before all others, in the step alone: one more look at a decision.

A plan may save energy for more of them later. Where forecasts are not trusted, a customer of the
first tier is served in every step that can serve it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.observation import Observation
from vppres.control.guard.check import violations
from vppres.control.guard.options import GuardOptions, SolverOf
from vppres.control.guard.partial_fleet import reduced_observation, site_with, whole_fleet
from vppres.control.kept import as_planned, by_rule
from vppres.control.planner import info_of
from vppres.control.rules import carry
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import named_line
from vppres.model.data import WindowData
from vppres.model.numerics import ROUNDING
from vppres.model.site import Site
from vppres.solve.ladder import WindowSolver


class CriticalFirst:
    """Serves more customers of the first tier than a decision does, where the step alone can."""

    def __init__(self, site: Site, solver_of: SolverOf, options: GuardOptions) -> None:
        self.site = site
        self.options = options
        self._solver_of = solver_of
        self._solvers: dict[bytes, WindowSolver] = {}

    def first(self, decision: Decision, known: Observation, state: StepState) -> Decision:
        """The decision, or the step alone where that serves more of the first tier."""
        served = self._weight(decision.dispatch.served[decision.row])
        all_of_them = self._weight(np.ones(len(self.site.customers)))
        if decision.fallback == "rule" or served >= all_of_them - ROUNDING:
            return decision
        answers = [self._step_alone(known, state)]
        # The rule is asked too: it knows nothing of solvers, and so not of their mistakes.
        rule = by_rule(state, self.options.tiers, "the rule serves more")
        if not violations(rule, state, self.options.within):
            answers.append(rule)
        alone = max(answers, key=lambda answer: self._weight(answer.dispatch.served[0]))
        possible = self._weight(alone.dispatch.served[0])
        if possible <= served + ROUNDING:
            return decision
        words = [
            decision.fallback_reason,
            f"the plan serves {served:g} of the critical weight, the step alone {possible:g}",
            alone.fallback_reason,
        ]
        return replace(
            self._with_critical(decision, alone, state),
            fallback="critical",
            fallback_reason="; ".join(word for word in words if word),
        )

    def possible(self, known: Observation, state: StepState) -> bool:
        """Whether the step alone can serve all of the first tier."""
        served = self._step_alone(known, state).dispatch.served[0]
        return self._weight(~np.asarray(served, dtype=bool)) <= ROUNDING

    def _with_critical(self, decision: Decision, alone: Decision, state: StepState) -> Decision:
        """The plan with the first tier as the step alone serves it, lower tiers let go as need be.

        The step alone would supply all customers it can and leave no energy for the steps to come.
        """
        plan = decision.dispatch
        row = decision.row
        state = as_planned(state, plan, row)
        tier = self.site.customers.tier
        wanted_kw = plan.charge_kw[row] - plan.discharge_kw[row]
        first = alone.dispatch.served[0] & (tier == self.options.tiers[0])
        for lowest in range(len(self.options.tiers), 0, -1):
            kept = np.isin(tier, self.options.tiers[1:lowest]) & plan.served[row]
            carried = carry(state, first | kept, wanted_kw)
            if carried is None or carried.shortage:
                continue
            found = Decision(carried, 0, SolveInfo(status="critical"))
            if not violations(found, state, self.options.within):
                return found
        return alone

    def _step_alone(self, known: Observation, state: StepState) -> Decision:
        """The one-step problem with the first tier above everything else; the rule if it fails."""
        try:
            solver = self._solver(known.online)
            seen = reduced_observation(known, self.site.batteries)
            # Nothing is worth keeping beside the first tier.
            alone = replace(seen, stored_value=None)
            solution = solver.solve(WindowData.of(alone, solver.site, self.options.centre).first(1))
            whole = whole_fleet(solution.dispatch, known.online, known.soc)
            decision = Decision(whole, 0, info_of(solver.site, solution))
            wrong = violations(decision, state, self.options.within)
            return by_rule(state, self.options.tiers, "; ".join(wrong)) if wrong else decision
        except self.options.answers as error:
            return by_rule(state, self.options.tiers, named_line(error))

    def _solver(self, online: Flags) -> WindowSolver:
        """Solver of the one-step problem that puts the first tier above everything else."""
        key = online.tobytes()
        if key not in self._solvers:
            site = critical_site(site_with(self.site, online), self.options.tiers[0])
            self._solvers[key] = self._solver_of(site)
        return self._solvers[key]

    def _weight(self, served: Flags | Floats) -> float:
        """Weight of the served customers of the first tier."""
        first = self.site.customers.tier == self.options.tiers[0]
        return float(self.site.customers.weight[first] @ np.asarray(served, dtype=float)[first])


def critical_site(site: Site, tier: str) -> Site:
    """The site with one customer of a tier worth more than all that others may lose together.

    Its one-step window says who of the tier can be served at all.
    """
    first = site.customers.tier == tier
    weight = site.customers.weight
    if not first.any():
        return site
    factor = np.ceil(site.hour_off[~first].sum() / weight[first].min()) + 1.0
    return replace(
        site, customers=replace(site.customers, weight=np.where(first, weight * factor, weight))
    )
