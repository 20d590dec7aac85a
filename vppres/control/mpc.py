"""Model predictive control (paper, Section 4.2): solve the window, carry out its first step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.contract.moves import Moves
from vppres.contract.observation import Observation, SupplyTurns
from vppres.contract.operating_point import Centre
from vppres.contract.stored_value import StoredValue
from vppres.control.planner import OnePass, Planner, decided, plan_with_rules
from vppres.control.remembered import PART
from vppres.core.arrays import Flags
from vppres.core.errors import SolveError
from vppres.model.beyond_paper.at_end import left_kwh
from vppres.scenario.assets import SOC_ROUNDING
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

LEAST_KW = 0.1
"""Demand below which a customer needs none."""

ROUNDING_KWH = 1e-3
"""Energy that a plan may leave less than another one by the solver's tolerances."""


class MPCController:
    """Receding horizon ``t0 .. t0 + H``, cut at the end of the day.

    With a horizon of 0 h it looks at the current step only. ``move_weight`` is what moving a
    battery by its rated power away from the plan before is worth, in kW of line losses.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {"_last": tuple[int, Dispatch] | None, "planner": PART}

    def __init__(
        self,
        solver: WindowSolver,
        grid: TimeGrid,
        horizon_h: float,
        centre: Centre = "lossless",
        planner: Planner | None = None,
        move_weight: float = 0.0,
    ) -> None:
        self.solver = solver
        self.grid = grid
        self.horizon_h = horizon_h
        self.centre = centre
        self.planner = planner or OnePass(solver, centre)
        self.move_weight = move_weight
        self._last: tuple[int, Dispatch] | None = None

    def horizon_steps(self, t0: int) -> range:
        """Steps of the window at ``t0``."""
        return self.grid.window(t0, self.horizon_h)

    def decide(self, observation: Observation) -> Decision:
        """Solve the observed window and take its first step."""
        before = self._planned_moves(observation)
        if self.move_weight > 0:
            observation = replace(observation, moves=before)
        solution = self._planned(observation)
        plan = solution.dispatch
        moved_kw = np.nan
        if before is not None:
            now_kw = plan.charge_kw[0] - plan.discharge_kw[0]
            moved_kw = float(np.abs(now_kw - before.planned_kw[0]).sum())
        self._last = observation.t0, plan
        worth = np.nan
        value = observation.stored_value
        if value is not None:
            worth = value.marginal_gbp_per_kwh(self._left_kwh(value, observation, solution))
        return decided(
            self.solver, replace(solution, moved_kw=moved_kw, stored_value_gbp_per_kwh=worth)
        )

    def _planned(self, observation: Observation) -> WindowSolution:
        """The plan of a window; no forecast takes a customer off the grid in its first step.

        For an outage that is only likely no customer is switched off that the present step alone
        would serve.
        """
        found = self._planned_freely(observation)
        if observation.turns is not None:
            turned = self._plan_with_turns(observation, observation.turns, found)
            return replace(turned, switching_relaxed=found.switching_relaxed)
        served = found.dispatch.served[0]
        connected = observation.forecast.grid_limit_kw[0] > 0.0
        if served.all() or not (connected and observation.guessed):
            return found
        alone = plan_with_rules(self.planner, observation, 1)
        kept_on = np.asarray(alone.dispatch.served[:1])
        if not (kept_on & ~served).any():
            return found
        return plan_with_rules(self.planner, replace(observation, kept_on=kept_on))

    def _planned_freely(self, observation: Observation) -> WindowSolution:
        """The plan of a window, which loses no customer of the plan before to rounding.

        That one charged no more than its last customer needs. So a state of charge that is as it
        was planned may miss the need by the solver's tolerance.
        """
        found = plan_with_rules(self.planner, observation)
        foreseen = self._foreseen_on(observation)
        if foreseen is None or np.array_equal(foreseen, found.dispatch.served[0]):
            return found
        soc = np.minimum(observation.soc + SOC_ROUNDING, self.solver.site.batteries.soc_max)
        sound = plan_with_rules(self.planner, replace(observation, soc=soc))
        site = self.solver.site
        least = 0.5 * float(site.customers.weight.min()) * site.dt_h
        return sound if sound.terms.f1 - found.terms.f1 > least else found

    def _foreseen_on(self, observation: Observation) -> Flags | None:
        """Customers on now in the plan before, (C,); None if the batteries have left it."""
        before = self._plan_before(observation)
        if before is None:
            return None
        plan, ago = before
        as_planned = np.abs(observation.soc - plan.soc[ago]) <= SOC_ROUNDING
        return np.asarray(plan.served[ago]) if as_planned.all() else None

    def _plan_with_turns(
        self, observation: Observation, turns: SupplyTurns, found: WindowSolution
    ) -> WindowSolution:
        """The plan with those on whose turn it is, one after another from the first tier on.

        Customers of their own tier and of lower ones give way. What higher tiers have in the plan
        stays, and so does the energy that is worth something to them later: a turn that would take
        of it is left out.
        """
        kept = np.zeros(turns.due.shape, dtype=bool)
        waiting = np.flatnonzero(turns.due.any(axis=0))
        for c in sorted(waiting, key=lambda c: turns.rank[c]):
            own = turns.due & (np.arange(len(turns.rank)) == c)
            served = found.dispatch.served
            if not served[own].all():
                higher = served & (turns.rank < turns.rank[c])
                asked = self._observation_keeping(observation, kept | own | higher, found)
                tried = self._plan_keeping_energy(asked, found)
                if tried is None:
                    continue
                found = tried
            kept |= own
        return found

    def _plan_keeping_energy(
        self, asked: Observation, before: WindowSolution
    ) -> WindowSolution | None:
        """The plan that is asked for, if there is one that leaves as much energy for later."""
        try:
            found = self.planner.plan(asked)
        except SolveError:
            return None
        value = asked.stored_value
        if value is None:
            return found
        left_kwh, before_kwh = (self._left_kwh(value, asked, each) for each in (found, before))
        return found if before_kwh - left_kwh <= ROUNDING_KWH else None

    def _observation_keeping(
        self, observation: Observation, served: Flags, plan: WindowSolution
    ) -> Observation:
        """The observation with customers that are kept on, and the energy that a plan leaves.

        Of what has a value later, a kWh less loses more than any customer is worth.
        """
        kept = replace(observation, kept_on=served)
        value = observation.stored_value
        if value is None:
            return kept
        load_kw = np.maximum(observation.forecast.load_kw[0], LEAST_KW)
        dearest = float((self.solver.site.customers.weight / load_kw).max())
        left_kwh = self._left_kwh(value, observation, plan)
        return replace(kept, stored_value=value.holding(left_kwh, 2.0 * dearest))

    def _left_kwh(
        self, value: StoredValue, observation: Observation, plan: WindowSolution
    ) -> float:
        """Energy that a plan leaves at its end, as its value counts it."""
        return left_kwh(self.solver.site, value, observation.ahead, plan.dispatch)

    def _planned_moves(self, observation: Observation) -> Moves | None:
        """Powers that the plan before foresaw for the window, None if it does not reach it."""
        before = self._plan_before(observation)
        if before is None:
            return None
        plan, ago = before
        n_steps = len(observation.window.price_gbp_per_kwh)
        return Moves.of(plan.charge_kw - plan.discharge_kw, ago, n_steps, self.move_weight)

    def _plan_before(self, observation: Observation) -> tuple[Dispatch, int] | None:
        """The plan before and which of its steps is now; None if it does not reach it."""
        if self._last is None:
            return None
        t0, plan = self._last
        ago = observation.t0 - t0
        return (plan, ago) if 0 < ago < plan.n_steps else None
