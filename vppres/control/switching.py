"""A controller that also decides which switches to move, with a controller for each configuration.

Each configuration is held over the window. Without network what it serves follows from its parts
alone, so each way of cutting the feeder is bounded once, and only what may serve more is planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vppres.contract.decision import Decider, Decision, Switched
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.control.candidates import Candidates, Reached
from vppres.control.configurations import DAY_H, ControllerIn, InConfiguration
from vppres.control.guard.check import PAPER, Tolerances, violations
from vppres.control.phased_rule import supply_of
from vppres.control.planned_step import PlannedStep
from vppres.control.step_state import StepState, network_state
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import SolveError
from vppres.core.plain import Given
from vppres.core.text import counted, named
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import safe_order
from vppres.feeders.reconfiguration.states import Formers, SwitchedFeeder
from vppres.model.data import WindowData
from vppres.model.phases import GRID, phased_model
from vppres.model.site import Site
from vppres.physics.phased_sources import farthest
from vppres.scenario.configuration import blocks_of, out_of_branches
from vppres.scenario.faults import OutOfService
from vppres.scenario.scenario import Scenario
from vppres.solve.deadline import HALF, Deadline, Stopwatch
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status

WHOLE = 1.0 - 1e-6
"""Share of its demand that counts as all of it."""

NO_SWITCH = "no switch would serve more"
NOT_FOUND = "no switch that serves more was found"
JOINS_LIVE = "{} joins two live parts, and has no sync_check"
NO_WAY = "no way leads to switches that may serve more: {}"
ALL_SERVED = "all customers are served"


@dataclass(frozen=True, eq=False)
class Planned:
    """A configuration's decision, and what the plan is worth less its operations."""

    candidate: Reached
    decision: Decision
    score: float
    memory: dict[str, Any] = field(default_factory=dict)
    waits: bool = False
    order: tuple[str, ...] = ()
    barred: str = ""  #: why no order of operations leads there

    @property
    def bound(self) -> float:
        """Most that a plan there can be worth, less its operations; infinite if it is not known."""
        known = np.isfinite(self.score)
        return self.decision.info.bound - self.candidate.price if known else np.inf


@dataclass(frozen=True, eq=False)
class Begin:
    """State of the feeder from which operations begin, in the order of the day."""

    before: OutOfService  #: lines and buses that were out before them, of one step
    out: OutOfService  #: those that are out during them, of one step
    live: Flags  #: buses that have voltage, (N,)


class Switching(InConfiguration):
    """Decides on switches, then as the controller of the configuration.

    Parameters are those of :class:`InConfiguration`, but that ``solver_of`` is None where plans
    have other weights than the site.
    """

    last: Search  #: the search of the last step

    def __init__(
        self,
        day: Scenario,
        controller_of: Callable[[Scenario], Decider],
        site_of: Callable[[Scenario], Site],
        given: Callable[[Site], Given],
        solver_of: Callable[[Site], WindowSolver] | None,
        centre: Centre,
        limits: SolveLimits,
        within: Tolerances = PAPER,
    ) -> None:
        super().__init__(day, controller_of, site_of, given, solver_of)
        self.centre = centre
        self.limits = limits
        self.within = within
        self.physical = within.losses
        self._out: OutOfService | None = None

    def decide(self, observation: Observation) -> Decision:
        """The decision in the configuration that is best, and the operations that it takes."""
        observation = self.observed(observation)
        here = self.controller_in(self.closed)
        before = self.memory_in(here)
        deadline = Deadline(self.limits.time_s)
        half = replace(observation, within_s=HALF * self.limits.time_s)
        stay = here.decider.decide(self.seen_in(here, half))
        observation = _known(observation, stay)
        self.last = search = self._searched(observation, here, stay, before, deadline)
        self._out = observation.forecast.out.part(slice(1))
        return self.taken(search, observation.t0)

    def taken(self, search: Search, t0: int) -> Decision:
        """The best decision of a step, with its operations carried out."""
        found, switched = search.best, search.record
        if found is search.stay:
            return replace(search.certified(), switched=switched)
        decision, switched = search.certified(), self.reasoned(search)
        if found.waits:
            self.remember_in(self.controller_in(self.closed), found.memory)
            return replace(decision, switched=switched)
        self.go_on_in(found.candidate.closed, found.memory, t0)
        words = switched.ahead
        switched = replace(switched, closed=self.closed, moved=words, ahead="", order=found.order)
        return replace(decision, switched=switched)

    def reasoned(self, search: Search) -> Switched:
        """The operations that the best decision counts on, what they are worth, and why."""
        found = search.best
        gain = found.score - search.stay.score
        why, until = self._gain_words(search)
        return replace(
            search.record,
            gain=gain if np.isfinite(gain) else np.nan,
            ahead=self.branches.moves(self.closed, found.candidate.closed),
            why=why,
            until=until,
        )

    def begin(self, observation: Observation, stay: Decision) -> Begin:
        """State from which operations begin: as the last step has left the feeder.

        A fault that begins now comes after them.
        """
        t0, point, now = observation.t0, observation.operating_point, observation.forecast.out
        before = self._out or self._out_at_start()
        out = OutOfService(before.lines & now.lines[:1], before.buses & now.buses[:1])
        live = np.full(self.day.network.n_buses, point is not None or not t0)
        if point is not None:
            live = np.isfinite(self.controller_in(self.closed).day.at_buses(point.v_pu))
        return Begin(before, out, live)

    def _out_at_start(self) -> OutOfService:
        """Lines and buses that are out just before the day, in its order."""
        day = self.day
        earlier = replace(day.grid, start=day.grid.start - day.grid.step, n_steps=1)
        return OutOfService.of(day.faults, day.network, earlier, range(1))

    # The choice.

    def _searched(
        self,
        observation: Observation,
        here: ControllerIn,
        stay: Decision,
        before: dict[str, Any],
        deadline: Deadline,
    ) -> Search:
        """The search for a configuration that is worth more than the present one."""
        forecast = observation.forecast
        out = out_of_branches(forecast.out, self.branches.ends)
        reach = Candidates(
            self.branches.ends,
            self.closed,
            self.branches.movable(~self.closed, forecast.out) & self._allowed(observation.t0),
            self.branches.of_moves("operation_cost"),
            out,
            self.day.network.n_buses,
        )
        present = planned_of(Reached(reach, self.closed), stay, {})
        begin = self.begin(observation, stay)
        search = Search(self, observation, present, before, begin, self.limits, deadline)
        everyone = bool((stay.dispatch.supplied >= WHOLE).all())
        if stay.fallback == "none" and everyone:
            return search.ended(ALL_SERVED)
        whole = replace(observation, forecast=replace(forecast, out=forecast.out.repaired()))
        search.most = bound = self.bound(here, whole, deadline.left_s)
        if search.passes_over(bound):
            return search.ended(NO_SWITCH)
        search.know(np.zeros_like(present.candidate.parts), bound)
        joins_all = present.candidate.n_parts == reach.n_joined
        faulted = forecast.out.lines.any()
        if faulted and joins_all:
            bound = self.bound(here, self.seen_in(here, observation), deadline.left_s)
        if not faulted or joins_all:
            search.know(present.candidate.parts, bound)
        return search.run(reach)

    def planned_in(
        self, observation: Observation, candidate: Reached, before: dict[str, Any], within_s: float
    ) -> Planned | None:
        """The plan in a configuration within some seconds, None if it has none."""
        part = self.controller_in(candidate.closed)
        observation = replace(observation, within_s=within_s)
        self.remember_in(part, before)
        try:
            decision = part.decider.decide(self.seen_in(part, observation))
        except SolveError:
            return None
        return planned_of(candidate, decision, self.memory_in(part))

    def bound(self, part: ControllerIn, observation: Observation, within_s: float) -> float:
        """Most that a plan of what is observed can be worth there, infinite if it is not known."""
        if part.solver is None:
            return np.inf
        data = WindowData.of(observation, part.site, self.centre)
        return part.solver.fleet_bound(data, within_s)

    def bound_in(self, observation: Observation, candidate: Reached, within_s: float) -> float:
        """Most that a plan in a configuration can be worth."""
        part = self.controller_in(candidate.closed)
        return self.bound(part, self.seen_in(part, observation), within_s)

    def _allowed(self, t0: int) -> Flags:
        """Branches that have operations of 24 hours left."""
        since = t0 - DAY_H / self.day.grid.dt_h
        recent = [moved for t, moved in self.moved if t > since]
        done = np.sum(recent, axis=0) if recent else np.zeros(len(self.branches))
        return np.asarray(done + 1 <= self.branches.of_moves("max_operations_per_day"))

    def barred(self, candidate: Reached, sources: Wholes) -> str:
        """Name of a switch that joins two live parts and cannot compare both sides, or nothing."""
        live = sources.copy()
        kept = np.flatnonzero(candidate.closed & self.closed)
        closing = np.flatnonzero(candidate.closed & ~self.closed)
        check = self.branches.of_moves("sync_check").astype(bool)
        block = np.arange(len(live))
        for branch in [*kept, *closing[np.argsort(check[closing], kind="stable")]]:
            one, other = block[self.branches.ends[branch]]
            joined = live[one] >= 0 and live[other] >= 0 and live[one] != live[other]
            if joined and branch in closing and not check[branch]:
                return str(self.branches.names[branch])
            live[one] = max(live[one], live[other])
            block[block == other] = one
        return ""

    def sources(self, begin: Begin) -> Wholes:
        """Number of the live part of each bus before operations, -1 in a dead one."""
        out = out_of_branches(begin.before, self.branches.ends)[0]
        parts = blocks_of(self.branches.ends, self.closed & ~out, len(begin.live))
        assert parts is not None  # a configuration has no loop
        return np.where(begin.live, parts, -1)

    def _gain_words(self, search: Search) -> tuple[str, int]:
        """Customers that the operations serve, or their worth; and for how many steps."""
        closed = search.best.candidate.closed
        closing, opening = closed & ~self.closed, self.closed & ~closed
        verb, which = ("closing", closing) if closing.any() else ("opening", opening)
        what = f"{verb} {named([self.branches.names[i] for i in np.flatnonzero(which)])}"
        plans = (each.decision.dispatch.supplied for each in (search.best, search.stay))
        more = np.greater(*plans)
        gain = search.best.score - search.stay.score
        if not np.isfinite(gain):
            return f"{what} has a plan, and the present configuration has none", 0
        if not more.any():
            return f"{what} is worth {gain:.3g} weighted customer hours", 0
        served = counted(int(more.any(axis=0).sum()), "customer")
        return f"{what} serves {served}", int(np.flatnonzero(more.any(axis=1))[-1]) + 1

    # Operations now, or later.

    def carried(
        self, observation: Observation, found: Planned, stay: Planned, begin: Begin
    ) -> Planned:
        """The plan with the order of its operations, or why there is none, or that they wait.

        They wait where the parts of the first step are those of the present configuration, and its
        lines and voltages carry the step.
        """
        here = self.controller_in(self.closed)
        if np.array_equal(found.candidate.parts[0], stay.candidate.parts[0]):
            state = self.step_state(here, observation)
            if self._as_it_is(observation, found):
                decision = self._with_lines_of(state, found.decision)
                if not violations(decision, state, self.within):
                    return replace(found, decision=decision, waits=True)
        feeder = self._feeder(observation, found, begin.out, not begin.live.any())
        order = safe_order(feeder, self.closed, found.candidate.closed)
        if order.operations is None:
            return replace(found, barred=order.reason)
        return replace(found, order=tuple(one.sentence for one in order.operations))

    def _as_it_is(self, observation: Observation, found: Planned) -> bool:
        """Whether the phases of the present configuration carry the first step of a plan.

        Or by no less than those of the plan's own do.
        """
        if not self.day.phases:
            return True
        out = observation.forecast.out.part(slice(1))
        feeder = self._feeder(observation, found, out, dark=False)
        planned = found.candidate.closed
        here, there = (safe_order(feeder, each, each).before for each in (self.closed, planned))
        return -np.inf < here.value >= min(there.value, 0.0)

    def _feeder(
        self, observation: Observation, found: Planned, out: OutOfService, dark: bool
    ) -> SwitchedFeeder:
        """The feeder at a plan's first step, with what is out, one step."""
        day, net = self.day, self.day.network
        part = self.controller_in(found.candidate.closed)
        state = self.step_state(part, observation)
        step = PlannedStep.of(found.decision, state.site)
        p_kw, q_kvar = (part.day.at_buses(each) for each in step.injections(state))
        formers = Formers.none() if dark else self._formers(observation, found.decision)
        now = observation.forecast.out
        return SwitchedFeeder(
            net,
            day.switches,
            p_kw,
            q_kvar,
            ConfigurationLimits(net.v_min_ac_pu, net.v_max_ac_pu, part.site.rated),
            grid=not dark and (not self.physical or observation.forecast.grid_limit_kw[0] > 0.0),
            formers=formers,
            faulted=out_of_branches(out, self.branches.ends)[0],
            bus_out=out.buses[0],
            movable=self.branches.movable(~self.closed, now),
            customers=day.customers.by_bus,
            by_phase=self._by_phase(state, step, formers),
        )

    def _by_phase(
        self, state: StepState, step: PlannedStep, formers: Formers
    ) -> FlowInStates | None:
        """Power flow by phase of a planned step in any configuration; None without phases."""
        if not self.day.phases:
            return None
        return FlowInStates(self.day, map(str, formers.id), *step.drawn(state, GRID))

    def _formers(self, observation: Observation, decision: Decision) -> Formers:
        """Batteries that can hold an island, with their set-points."""
        day, plan, row = self.day, decision.dispatch, decision.row
        b = day.batteries
        able = np.flatnonzero(day.formers & b.holds_energy(observation.soc))
        return Formers(
            b.id[able],
            b.bus[able],
            b.s_max_kva[able],
            -b.active_max_kw[able],
            b.active_max_kw[able],
            (plan.discharge_kw[row] - plan.charge_kw[row])[able],
            plan.batt_q_kvar[row][able],
        )

    def step_state(self, part: ControllerIn, observation: Observation) -> StepState:
        """The observed step in a configuration."""
        return StepState.of(part.site, self.seen_in(part, observation), self.centre)

    def _with_lines_of(self, state: StepState, decision: Decision) -> Decision:
        """A decision with the flows and voltages that its step has in another configuration."""
        step = PlannedStep.of(decision, state.site)
        p_flow_kw, q_flow_kvar, v_pu = network_state(state, *step.injections(state))
        plan, row = decision.dispatch, decision.row
        v_node_pu = plan.v_node_pu
        if v_node_pu is not None:
            model, source = phased_model(state.site), supply_of(state)
            found = model.solved(source, *step.drawn(state, source))
            if found is not None:
                of_nodes = model.supplies[source].flow.v_pu(found.v)
                v_node_pu = with_row(v_node_pu, row, of_nodes)
                v_pu = farthest(of_nodes, model.at_bus, len(v_pu))
        return replace(
            decision,
            dispatch=replace(
                plan,
                v_node_pu=v_node_pu,
                p_flow_kw=with_row(plan.p_flow_kw, row, p_flow_kw),
                q_flow_kvar=with_row(plan.q_flow_kvar, row, q_flow_kvar),
                v_pu=with_row(plan.v_pu, row, v_pu),
            ),
        )


class Search:
    """The best configuration of a step, and what is proven of all others.

    ``stay`` is the plan in the present configuration, and ``before`` the memory of its controller
    before the step; operations begin from ``begin``.
    """

    def __init__(
        self,
        of: Switching,
        observation: Observation,
        stay: Planned,
        before: dict[str, Any],
        begin: Begin,
        limits: SolveLimits,
        deadline: Deadline,
    ) -> None:
        self.stay = self.best = stay
        self.record = Switched(of.closed)
        self.bound = stay.decision.info.bound
        self.most = np.inf
        self.deadline = deadline
        self._of = of
        self._observation = observation
        self._before = before
        self._limits = limits
        self._begin = begin
        self._sources = of.sources(begin)
        self._known: list[tuple[Wholes, float]] = []
        self._last_plan_s = 0.0
        self._no_way = ""

    @property
    def _gap(self) -> float:
        return self._limits.gap_at(self.best.score) if np.isfinite(self.best.score) else 0.0

    def beaten(self, bound: float) -> bool:
        """Whether a bound allows nothing better than the best plan."""
        return bound <= self.best.score + self._gap

    def ended(self, why: str) -> Search:
        """The search with the reason for which nothing moves."""
        self.record = replace(self.record, why=why)
        return self

    def know(self, parts: Wholes, bound: float) -> None:
        """Remember a bound without network of all that cut the feeder in a way."""
        self._known.append((parts, bound))

    def run(self, reach: Candidates) -> Search:
        """Bound each way of cutting the feeder, and plan what may be worth more."""
        complete = reach.all_tried
        for group in reach.groups():
            if self.deadline.passed:
                complete = False
                break
            complete &= self._tried(group)
            if self._nothing_joined_is_better(reach):
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
        return self

    def _nothing_joined_is_better(self, reach: Candidates) -> bool:
        """Whether a plan for all that switches could join is worth no more than the best."""
        joined = (most for parts, most in self._known if np.array_equal(parts, reach.joined))
        return self.passes_over(min(joined, default=np.inf))

    def passes_over(self, bound: float) -> bool:
        """Whether all configurations that a bound holds for may be left out; it holds on."""
        beaten = self.beaten(bound)
        if beaten:
            self.bound = max(self.bound, bound)
        return beaten

    def _tried(self, group: list[Reached]) -> bool:
        """Whether no configuration of a group, which cut the feeder alike, is left unknown."""
        price = min(each.price for each in group)
        bound = min((most for parts, most in self._known if group[0].within(parts)), default=np.inf)
        if not self.beaten(bound - price):
            part = group[0]
            if not any(np.array_equal(part.parts, parts) for parts, _ in self._known):
                bound = min(bound, self._of.bound_in(self._observation, part, self.deadline.left_s))
                self.know(part.parts, bound)
            self.record = replace(self.record, bounded=self.record.bounded + 1)
        of_trees = -np.inf
        for way in group:
            if self.beaten(bound - price):
                break
            if switch := self._of.barred(way, self._sources):
                self._no_way = self._no_way or JOINS_LIVE.format(switch)
                continue
            left_s = self.deadline.left_s
            if left_s <= self._last_plan_s:  # the next would hardly end in time
                return False
            watch = Stopwatch()
            planned = self._of.planned_in(self._observation, way, self._before, left_s)
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

    def _take(self, planned: Planned) -> None:
        """Take a plan for the best, if it is and its operations have an order."""
        if planned.score > self.best.score + self._gap:
            found = self._of.carried(self._observation, planned, self.stay, self._begin)
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


def _known(observation: Observation, decision: Decision) -> Observation:
    """The observation as its decision took it for true, in the order of the day."""
    seen = decision.seen or observation
    forecast = replace(seen.forecast, out=observation.forecast.out)
    point, within_s = observation.operating_point, observation.within_s
    return replace(seen, forecast=forecast, operating_point=point, within_s=within_s)


def with_row(values: Floats, row: int, changed: Floats) -> Floats:
    """Values with another row."""
    found = np.array(values)
    found[row] = changed
    return found


def planned_of(candidate: Reached, decision: Decision, memory: dict[str, Any]) -> Planned:
    """A decision with its worth; a fallback proves none."""
    objective = decision.info.objective
    sound = decision.fallback == "none" and np.isfinite(objective)
    score = objective - candidate.price if sound else -np.inf
    return Planned(candidate, decision, score, memory)
