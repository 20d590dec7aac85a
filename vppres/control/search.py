"""Search for the configuration of a step that is worth most, with a bound on all others.

Each configuration is held over the window. Without network what it serves follows from its parts
alone, so each way of cutting the feeder is bounded once, and only what may serve more is planned.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vppres.contract.decision import Decision, Switched
from vppres.control.candidates import Candidates, Reached
from vppres.control.operations import Operations, Planned
from vppres.core.arrays import Wholes
from vppres.core.errors import SolveError
from vppres.core.text import counted, named
from vppres.scenario.configuration import out_of_branches
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.result import SolveLimits, Status

WHOLE = 1.0 - 1e-6
"""Share of its demand that counts as all of it."""

NO_SWITCH = "no switch would serve more"
NOT_FOUND = "no switch that serves more was found"
JOINS_LIVE = "{} joins two live parts, and has no sync_check"
NO_WAY = "no way leads to switches that may serve more: {}"
ALL_SERVED = "all customers are served"


class Search:
    """The best configuration of a step, and what is proven of all others.

    ``stay`` is the decision in the present configuration, and ``before`` the memory of its
    controller before the step.
    """

    def __init__(
        self,
        operations: Operations,
        stay: Decision,
        before: dict[str, Any],
        limits: SolveLimits,
        deadline: Deadline,
    ) -> None:
        of, observation = operations.of, operations.observation
        reach = Candidates(
            of.branches.ends,
            of.closed,
            of.movable(observation),
            of.branches.of_moves("operation_cost"),
            out_of_branches(observation.forecast.out, of.branches.ends),
            of.day.network.n_buses,
        )
        self.stay = self.best = Planned.of(Reached(reach, of.closed), stay, {})
        self.record = Switched(of.closed)
        self.bound = stay.info.bound
        self.most = np.inf
        self.deadline = deadline
        self._operations = operations
        self._of = of
        self._observation = observation
        self._before = before
        self._limits = limits
        #: Bounds without network of all that cut the feeder in a way, with its parts.
        self._known: list[tuple[Wholes, float]] = []
        self._last_plan_s = 0.0
        self._no_way = ""

    def _beaten(self, bound: float) -> bool:
        """Whether a bound allows nothing better than the best plan."""
        best = self.best.score
        return bound <= best + (self._limits.gap_at(best) if np.isfinite(best) else 0.0)

    def run(self) -> None:
        """Find the best configuration, if another than the present one may be worth more."""
        present, forecast = self.stay.candidate, self._observation.forecast
        everyone = bool((self.stay.decision.dispatch.supplied >= WHOLE).all())
        if self.stay.decision.fallback == "none" and everyone:
            self.record = replace(self.record, why=ALL_SERVED)
            return
        here = self._of.controller_in(self._of.closed)
        whole = replace(self._observation, forecast=replace(forecast, out=forecast.out.repaired()))
        self.most = bound = here.bound(whole, self.deadline.left_s)
        if self._passes_over(bound):
            self.record = replace(self.record, why=NO_SWITCH)
            return
        self._known.append((np.zeros_like(present.parts), bound))
        joins_all = present.n_parts == present.of.n_joined
        faulted = forecast.out.lines.any()
        if faulted and joins_all:
            bound = self._bound_in(present)
        if not faulted or joins_all:
            self._known.append((present.parts, bound))
        self._try(present.of)

    def _try(self, reach: Candidates) -> None:
        """Bound each way of cutting the feeder, and plan what may be worth more."""
        complete = reach.all_tried
        for group in reach.groups():
            if self.deadline.passed:
                complete = False
                break
            complete &= self._tried(group)
            joined = (most for parts, most in self._known if np.array_equal(parts, reach.joined))
            if self._passes_over(min(joined, default=np.inf)):  # no configuration joins more
                complete = True
                break
        why = NO_SWITCH if complete else NOT_FOUND
        if self._no_way:
            why = NO_WAY.format(self._no_way)
        if self.best is not self.stay:
            why = ""
        self.record = replace(self.record, configurations=len(reach.found), why=why)
        if not complete:
            self.bound = self.most

    def _passes_over(self, bound: float) -> bool:
        """Whether all configurations that a bound holds for may be left out; it holds on."""
        beaten = self._beaten(bound)
        if beaten:
            self.bound = max(self.bound, bound)
        return beaten

    def _tried(self, group: list[Reached]) -> bool:
        """Whether no configuration of a group, which cut the feeder alike, is left unknown."""
        price = min(each.price for each in group)
        bound = min((most for parts, most in self._known if group[0].within(parts)), default=np.inf)
        if not self._beaten(bound - price):
            part = group[0]
            if not any(np.array_equal(part.parts, parts) for parts, _ in self._known):
                bound = min(bound, self._bound_in(part))
                self._known.append((part.parts, bound))
            self.record = replace(self.record, bounded=self.record.bounded + 1)
        of_trees = -np.inf
        for way in group:
            if self._beaten(bound - price):
                break
            if switch := self._operations.barred(way):
                self._no_way = self._no_way or JOINS_LIVE.format(switch)
                continue
            left_s = self.deadline.left_s
            if left_s <= self._last_plan_s:  # the next would hardly end in time
                return False
            watch = Stopwatch()
            planned = self._planned_in(way, left_s)
            self._last_plan_s = watch.spent_s
            self.record = replace(self.record, planned=self.record.planned + 1)
            if planned is not None:
                of_trees = max(of_trees, planned.bound)
                self._take(planned)
        else:  # losses and voltages of the trees allow less than their parts
            self.bound = max(self.bound, min(bound - price, of_trees))
            return True
        self.bound = max(self.bound, bound - price)
        return True

    def _bound_in(self, candidate: Reached) -> float:
        """Most that a plan in a configuration can be worth."""
        part = self._of.controller_in(candidate.closed)
        return part.bound(self._of.seen_in(part, self._observation), self.deadline.left_s)

    def _planned_in(self, candidate: Reached, within_s: float) -> Planned | None:
        """The plan in a configuration within some seconds, None if it has none."""
        part = self._of.controller_in(candidate.closed)
        observation = replace(self._observation, within_s=within_s)
        self._of.remember_in(part, self._before)
        try:
            decision = part.decider.decide(self._of.seen_in(part, observation))
        except SolveError:
            return None
        return Planned.of(candidate, decision, self._of.memory_in(part))

    def _take(self, planned: Planned) -> None:
        """Take a plan for the best, if it is and its operations have an order."""
        if not self._beaten(planned.score):
            found = self._operations.carried(planned, self.stay)
            if found.barred:
                self._no_way = self._no_way or found.barred.rstrip(".")
            else:
                self.best = found

    def certified(self) -> Decision:
        """The best decision, with a bound over all configurations, and the time of the search."""
        decision, price = self.best.decision, self.best.candidate.price
        info = decision.info
        if self.record.why != ALL_SERVED:
            info = replace(info, solve_s=self.deadline.spent_s)
        bound = max(info.bound, self.bound + price)
        if bound > info.bound and np.isfinite(info.objective):
            status = info.status
            if status == Status.OPTIMAL and not self._limits.met(bound, info.objective):
                status = Status.TIME_LIMIT if self.deadline.passed else Status.GAP_OPEN
            info = replace(info, bound=bound, status=status)
        return replace(decision, info=info)

    def reasoned(self) -> Switched:
        """The operations that the best decision counts on, what they are worth, and why."""
        gain = self.best.score - self.stay.score
        why, until = self._gain_words(gain)
        return replace(
            self.record,
            gain=gain if np.isfinite(gain) else np.nan,
            ahead=self._of.branches.moves(self._of.closed, self.best.candidate.closed),
            why=why,
            until=until,
        )

    def _gain_words(self, gain: float) -> tuple[str, int]:
        """Customers that the operations serve, or their worth; and for how many steps."""
        names, now, then = self._of.branches.names, self._of.closed, self.best.candidate.closed
        closing, opening = then & ~now, now & ~then
        verb, which = ("closing", closing) if closing.any() else ("opening", opening)
        what = f"{verb} {named([names[i] for i in np.flatnonzero(which)])}"
        plans = (each.decision.dispatch.supplied for each in (self.best, self.stay))
        more = np.greater(*plans)
        if not np.isfinite(gain):
            return f"{what} has a plan, and the present configuration has none", 0
        if not more.any():
            return f"{what} is worth {gain:.3g} weighted customer hours", 0
        served = counted(int(more.any(axis=0).sum()), "customer")
        return f"{what} serves {served}", int(np.flatnonzero(more.any(axis=1))[-1]) + 1
