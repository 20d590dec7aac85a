"""A controller that always answers: it checks another's decisions and falls back in a fixed order.

An infeasible window has its voltage limits widened, then is cut to the step alone. Whatever else
goes wrong (a solver that dies, is late, or answers garbage) is answered by the previous plan, then
by a rule. ``docs/operation.md`` states the order and what the record says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decider, Decision, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.by_part import by_part
from vppres.control.carried import Carried
from vppres.control.converged import dark_steps
from vppres.control.full_horizon import FullHorizonController
from vppres.control.guard.check import violations
from vppres.control.guard.critical import CriticalFirst
from vppres.control.guard.estimation import Estimator
from vppres.control.guard.options import GuardOptions, SolverOf
from vppres.control.guard.partial_fleet import reduced_observation, site_with, whole_fleet
from vppres.control.guard.relax import relaxed_answers
from vppres.control.kept import as_planned, by_rule
from vppres.control.phased_rule import carried_by_phase
from vppres.control.planner import info_of
from vppres.control.remembered import PART, PARTS
from vppres.control.rules import carry
from vppres.control.step_state import StepState
from vppres.core.errors import InfeasibleError, named_line
from vppres.model.data import WindowData
from vppres.model.site import Site

ControllerOf = Callable[[Site], Decider]


class GuardedController:
    """Wraps a controller so that every step has an answer that can be carried out.

    ``controller_of`` makes the wrapped controller: once for the whole fleet, and once for each part
    of it that is left when batteries are out. ``solver_of`` makes the solver of the fallbacks.

    Attributes
    ----------
    inner : Decider
        The wrapped controller of the whole fleet.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "inner": PART,
        "_parts": PARTS,
        "_estimator": PART,
        "_plan": tuple[Dispatch, int] | None,
    }

    def __init__(
        self, controller_of: ControllerOf, solver_of: SolverOf, site: Site, options: GuardOptions
    ) -> None:
        self.site = site
        self.options = options
        self.inner = controller_of(site)
        self._controller_of = controller_of
        self._solver_of = solver_of
        self._parts: dict[bytes, Decider] = {}
        self._critical = CriticalFirst(site, solver_of, options)
        self._estimator = Estimator(site, options.physical)
        self._plan: tuple[Dispatch, int] | None = None  # with the step of its first row

    @property
    def plan(self) -> Dispatch | None:
        """The wrapped controller's plan of the day, if it has one."""
        return self.inner.plan if isinstance(self.inner, FullHorizonController) else None

    def horizon_steps(self, t0: int) -> range:
        """Steps for which the wrapped controller wants a forecast."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The wrapped controller's decision if it can be carried out, otherwise a fallback."""
        known = self._without_unlikely_demands(self._estimator.known(observation))
        state = self._step_state(known)
        decision = self._checked_decision(known, state)
        if self.options.protect_critical and not known.forecast.in_parts_now:
            decision = self._critical.first(decision, known, state)
        self._estimator.commanded(decision)
        return replace(decision, estimated=known.estimated, seen=known)

    def _without_unlikely_demands(self, known: Observation) -> Observation:
        """Estimate, with grid without unlikely demands that would cost the first tier.

        What is really taken was carried: readings are of customers that have supply. Where lines
        are out, the first tier may be off for that.
        """
        state = self._step_state(known)
        apart = state.island or known.forecast.in_parts_now
        if apart or not self._estimator.series.unproven.any():
            return known
        return known if self._critical.possible(known, state) else self._estimator.proven(known)

    def _step_state(self, known: Observation) -> StepState:
        """The step as it is known; of an island, whether a battery or which set can form it."""
        centre = self.options.centre
        physical = self.options.physical
        state = StepState.of(self.site, known, centre, physical)
        if not (physical and state.island):
            return state
        site = site_with(self.site, known.online)
        seen = reduced_observation(known, self.site.batteries)
        now = WindowData.of(seen, site, centre).first(1)
        dark = dark_steps(site, now)
        formed, _ = now.formed(site, dark, headroom=0.0)
        return replace(state, now=replace(state.now, ahead=formed.ahead), dark=bool(dark[0]))

    def _checked_decision(self, known: Observation, state: StepState) -> Decision:
        """The wrapped controller's answer, or the first fallback that passes the check."""
        before = self.plan
        decision = self._answer_or_fallback(known, state)
        if decision.fallback != "none" and (self.plan is None or self.plan is not before):
            # What a controller remembers of a step that failed may be garbage too. A plan of the
            # day is kept, unless it was made in this very step.
            self.inner = self._controller_of(self.site)
            self._parts.clear()
        return decision

    def _answer_or_fallback(self, known: Observation, state: StepState) -> Decision:
        try:
            decision = self._inner_decision(known)
            reasons = violations(decision, state, self.options.within)
            if not reasons:
                self._remember_plan(decision, known.t0)
                return decision
            reason = "refused: " + "; ".join(reasons)
        except InfeasibleError as error:
            reason = named_line(error)
            found, reason = self._relaxed(known, state, reason)
            if found is not None:
                return found
        except self.options.answers as error:
            reason = named_line(error)
        return self._without_solver(known, state, reason)

    def _inner_decision(self, known: Observation) -> Decision:
        """Decision of the wrapped controller, for the batteries that are there.

        A plan of the day is kept as it is: what it asks of a battery that is out fails the check.
        """
        if known.online.all() or isinstance(self.inner, FullHorizonController):
            return self.inner.decide(known)
        part = self.part_for(known.online.tobytes())
        decision = part.decide(reduced_observation(known, self.site.batteries))
        return replace(decision, dispatch=whole_fleet(decision.dispatch, known.online, known.soc))

    def part_for(self, key: bytes) -> Decider:
        """The controller of the batteries online, as bytes of flags, (B,)."""
        if key not in self._parts:
            online = np.frombuffer(key, dtype=bool)
            self._parts[key] = self._controller_of(site_with(self.site, online))
        return self._parts[key]

    def _remember_plan(self, decision: Decision, t0: int) -> None:
        """Remember a plan that goes beyond its step, for steps that find no other."""
        if decision.row + 1 < decision.dispatch.n_steps:
            self._plan = decision.dispatch, t0 - decision.row

    def _relaxed(
        self, known: Observation, state: StepState, reason: str
    ) -> tuple[Decision | None, str]:
        """Fallback of an infeasible window, None if there is none, and the reasons so far."""
        site = site_with(self.site, known.online)
        seen = reduced_observation(known, self.site.batteries)
        data = WindowData.of(seen, site, self.options.centre)
        failed: dict[str, list[str]] = {}
        for name, answer in relaxed_answers(site, data, self._solver_of):
            try:
                solution, limits_pu, words = answer()
            except self.options.answers as error:
                failed.setdefault(named_line(error), []).append(name)
                continue
            dispatch = whole_fleet(solution.dispatch, known.online, known.soc)
            decision = Decision(
                dispatch,
                0,
                info_of(site, solution),
                fallback=name,
                fallback_reason=f"{_with_failures(reason, failed)}; {words}",
            )
            wrong = violations(decision, state, self.options.within, limits_pu)
            if not wrong:
                return decision, reason
            failed.setdefault(f"refused: {'; '.join(wrong)}", []).append(name)
        return None, _with_failures(reason, failed)

    def _without_solver(self, known: Observation, state: StepState, reason: str) -> Decision:
        """The previous plan where it can be carried out, otherwise the rule."""
        planned = self._planned(known, state, reason)
        return planned if planned is not None else by_rule(state, self.options.tiers, reason)

    def _planned(self, known: Observation, state: StepState, reason: str) -> Decision | None:
        """The step of the last good plan, its balance closed by what is measured now."""
        if self._plan is None:
            return None
        plan = self._plan[0]
        row = known.t0 - self._plan[1]
        if not 0 <= row < plan.n_steps:
            return None
        planned = self._carried_on(plan, row, as_planned(state, plan, row), reason)
        if planned is not None or not plan.taken_kw:
            return planned
        return self._carried_on(plan, row, state, reason)

    def _carried_on(
        self, plan: Dispatch, row: int, state: StepState, reason: str
    ) -> Decision | None:
        """A row of a plan beside flexible power; None if it cannot be carried out."""
        served = np.asarray(plan.served[row], dtype=bool)
        share = np.where(served, plan.supplied[row], 1.0)
        wanted = plan.charge_kw[row] - plan.discharge_kw[row]

        def as_planned_in(part: StepState) -> Carried | None:
            dimmed = replace(part, now=replace(part.now, load_kw=part.now.load_kw * share))
            on = served & part.items(self.site.customer_bus)
            found = carry(dimmed, on, wanted * part.items(self.site.battery_bus))
            phased = part.island and bool(self.site.phases)
            if found is None or found.shortage or not phased:
                return found
            return found if carried_by_phase(part, found) else None

        carried = by_part(state, as_planned_in)
        if carried is None or carried.shortage:
            return None
        supplied = carried.served[0] * share
        dimmed = None if plan.share is None else supplied[np.newaxis]
        decision = Decision(
            replace(carried, share=dimmed),
            0,
            SolveInfo(status="previous_plan"),
            fallback="previous_plan",
            fallback_reason=reason,
        )
        net = self.site.network
        wrong = violations(decision, state, self.options.within, (net.v_min_ac_pu, net.v_max_ac_pu))
        return None if wrong else decision


def _with_failures(reason: str, failed: Mapping[str, Sequence[str]]) -> str:
    """Why there is no answer, and what failed at the fallbacks that were tried, each told once."""
    told = [f"{', '.join(dict.fromkeys(names))}: {words}" for words, names in failed.items()]
    return "; ".join([reason, *told])
