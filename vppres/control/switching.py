"""A controller that also decides which switches to move, with a controller for each configuration.

Each configuration is held over the window. Without network what it serves follows from its parts
alone, so each way of cutting the feeder is bounded once, and only what may serve more is planned.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vppres.contract.decision import Decider, Decision, Switched
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.control.candidates import Candidates, Reached
from vppres.control.guard.check import PAPER, Tolerances, violations
from vppres.control.phased_rule import supply_of
from vppres.control.remembered import memory_of, put_back
from vppres.control.step_state import StepState, network_state
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import SolveError
from vppres.core.plain import Given
from vppres.core.text import counted, named
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import (
    Formers,
    SwitchedFeeder,
    SwitchingOrder,
    safe_order,
)
from vppres.model.data import WindowData
from vppres.model.formulas import bus_injections, curtailed_kw
from vppres.model.phases import GRID, phased_model
from vppres.model.site import Site
from vppres.physics.phased_sources import farthest
from vppres.scenario.configuration import (
    Branches,
    Configured,
    blocks_of,
    in_configuration,
    out_of_branches,
)
from vppres.scenario.faults import OutOfService
from vppres.scenario.scenario import Scenario
from vppres.solve.deadline import Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import LEAST_OBJECTIVE, SolveLimits, Status

WHOLE = 1.0 - 1e-6
"""Share of its demand that counts as all of it."""

DAY_H = 24.0

MOST_KEPT = 64
"""Configurations whose controllers are kept; each may hold compiled problems."""

NO_SWITCH = "no switch would serve more"
NOT_FOUND = "no switch that serves more was found"
ALL_SERVED = "all customers are served"


@dataclass(frozen=True, eq=False)
class ControllerIn:
    """The day in a configuration, and who decides and bounds there.

    Parameters
    ----------
    closed : array of bool, shape (E,)
        Branches that are closed.
    day : Configured
        The scenario.
    site : Site
        What is planned for.
    solver : WindowSolver or None
        What bounds its windows; None where plans have other weights.
    controller_of : callable
        Makes its controller.
    """

    closed: Flags
    day: Configured
    site: Site
    solver: WindowSolver | None
    controller_of: Callable[[Scenario], Decider]

    @cached_property
    def decider(self) -> Decider:
        """Its controller, made when it is asked."""
        return self.controller_of(self.day.scenario)


@dataclass(frozen=True, eq=False)
class Planned:
    """A configuration's decision, and what the plan is worth less its operations."""

    candidate: Reached
    decision: Decision
    score: float
    memory: dict[str, Any] = field(default_factory=dict)
    waits: bool = False
    order: tuple[str, ...] = ()

    @property
    def bound(self) -> float:
        """Most that a plan there can be worth, less its operations; infinite if it is not known."""
        known = np.isfinite(self.score)
        return self.decision.info.bound - self.candidate.price if known else np.inf


class Switching:
    """Decides on switches, then as the controller of the configuration.

    Parameters
    ----------
    day : Scenario
        The day, in the configuration in which it begins.
    controller_of : callable
        Makes the controller of the day in a configuration.
    site_of : callable
        Makes the site that it plans for.
    solver_of : callable or None
        Makes the solver of bounds of a site; None where plans have other weights than it.
    given : callable
        What is known of a site without a memory of its controller.
    centre : {"lossless", "literal", "none"}
        Linearisation centre of the voltages.
    limits : SolveLimits
        Gap and time of a step.
    within : Tolerances, optional
        What a decision may be off by.

    Attributes
    ----------
    closed : array of bool, shape (E,)
        The present configuration.
    last : Search
        The search of the last step.
    """

    last: Search

    def __init__(
        self,
        day: Scenario,
        controller_of: Callable[[Scenario], Decider],
        site_of: Callable[[Scenario], Site],
        solver_of: Callable[[Site], WindowSolver] | None,
        given: Callable[[Site], Given],
        centre: Centre,
        limits: SolveLimits,
        within: Tolerances = PAPER,
    ) -> None:
        self.day = day
        self.branches = Branches.of(day)
        self.closed = self.branches.closed
        self.centre = centre
        self.limits = limits
        self.within = within
        self.physical = within.losses
        self._controller_of = controller_of
        self._site_of = site_of
        self._solver_of = solver_of
        self._given = given
        self._known: dict[bytes, ControllerIn] = {}
        self._operations: list[tuple[int, Flags]] = []

    def horizon_steps(self, t0: int) -> range:
        """Steps of its controllers' windows."""
        return self._in(self.closed).decider.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision in the configuration that is best, and the operations that it takes."""
        here = self._in(self.closed)
        before = self._memory(here)
        stay = here.decider.decide(self._seen(here, observation))
        self.last = search = self._searched(observation, here, stay, before)
        found, switched = search.best, search.record
        if found is search.stay:
            return replace(search.certified(), switched=switched)
        words = self.branches.moves(self.closed, found.candidate.closed)
        gain = found.score - search.stay.score
        known = gain if np.isfinite(gain) else np.nan
        switched = replace(switched, gain=known, why=self._gain_words(observation.t0, search))
        decision = search.certified()
        if found.waits:
            self._remember(here, found.memory)
            return replace(decision, switched=replace(switched, ahead=words))
        self._operations.append((observation.t0, found.candidate.closed != self.closed))
        self.closed = found.candidate.closed
        self._remember(self._in(self.closed), found.memory)
        switched = replace(switched, closed=self.closed, moved=words, order=found.order)
        return replace(decision, switched=switched)

    # Configurations.

    def _in(self, closed: Flags) -> ControllerIn:
        """A configuration, made once."""
        key = closed.tobytes()
        if key not in self._known:
            if len(self._known) >= MOST_KEPT:
                kept = self.closed.tobytes()
                self._known = {kept: self._known[kept]}
            day = in_configuration(self.day, self.branches, closed)
            site = self._site_of(day.scenario)
            solver = None if self._solver_of is None else self._solver_of(site)
            self._known[key] = ControllerIn(closed, day, site, solver, self._controller_of)
        return self._known[key]

    def _seen(self, part: ControllerIn, observation: Observation) -> Observation:
        """Observation with the lines and voltages of a configuration."""
        t0, forecast = observation.t0, observation.forecast
        steps = range(t0, t0 + len(forecast.price_gbp_per_kwh))
        out = part.day.scenario.out_of_service(steps, known_at=t0)
        forecast = replace(forecast, out=out)
        point = observation.operating_point
        if not np.array_equal(part.closed, self.closed):
            point = None
        return replace(observation, forecast=forecast, operating_point=point)

    def _memory(self, part: ControllerIn) -> dict[str, Any]:
        return memory_of(part.decider, self._given(part.site))

    def _remember(self, part: ControllerIn, memory: dict[str, Any]) -> None:
        """Let a controller go on from another configuration, but for what is of its lines."""
        put_back(part.decider, without_lines(memory), self._given(part.site), "controller")

    # The choice.

    def _searched(
        self,
        observation: Observation,
        here: ControllerIn,
        stay: Decision,
        before: dict[str, Any],
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
        search = Search(self, observation, present, before, self.limits)
        everyone = bool((stay.dispatch.supplied >= WHOLE).all())
        if stay.fallback == "none" and everyone:
            return search.ended(ALL_SERVED)
        whole = replace(observation, forecast=replace(forecast, out=forecast.out.repaired()))
        if search.passes_over(bound := self.bound(here, whole, search.deadline.left_s)):
            return search.ended(NO_SWITCH)
        joins_all = present.candidate.n_parts == reach.n_joined
        faulted = forecast.out.lines.any()
        if faulted and joins_all:
            bound = self.bound(here, self._seen(here, observation), search.deadline.left_s)
        if not faulted or joins_all:
            search.know(present.candidate, bound)
        return search.run(reach)

    def planned_in(
        self, observation: Observation, candidate: Reached, before: dict[str, Any]
    ) -> Planned | None:
        """The plan in a configuration, None if it has none."""
        part = self._in(candidate.closed)
        self._remember(part, before)
        try:
            decision = part.decider.decide(self._seen(part, observation))
        except SolveError:
            return None
        return planned_of(candidate, decision, self._memory(part))

    def bound(self, part: ControllerIn, observation: Observation, within_s: float) -> float:
        """Most that a plan of what is observed can be worth there, infinite if it is not known."""
        if part.solver is None:
            return np.inf
        data = WindowData.of(observation, part.site, self.centre)
        return part.solver.fleet_bound(data, within_s)

    def bound_in(self, observation: Observation, candidate: Reached, within_s: float) -> float:
        """Most that a plan in a configuration can be worth."""
        part = self._in(candidate.closed)
        return self.bound(part, self._seen(part, observation), within_s)

    def _allowed(self, t0: int) -> Flags:
        """Branches that have operations of 24 hours left."""
        per_day = DAY_H / self.day.grid.dt_h
        recent = [moved for t, moved in self._operations if t > t0 - per_day]
        done = np.sum(recent, axis=0) if recent else np.zeros(len(self.branches))
        return np.asarray(done + 1 <= self.branches.of_moves("max_operations_per_day"))

    def may_be_joined(self, candidate: Reached, sources: Wholes) -> bool:
        """Whether no two live parts are joined but by a switch that can compare both sides."""
        live = sources.copy()
        kept = np.flatnonzero(candidate.closed & self.closed)
        closing = np.flatnonzero(candidate.closed & ~self.closed)
        check = self.branches.of_moves("sync_check").astype(bool)
        block = np.arange(len(live))
        for branch in [*kept, *closing[np.argsort(check[closing], kind="stable")]]:
            one, other = block[self.branches.ends[branch]]
            joined = live[one] >= 0 and live[other] >= 0 and live[one] != live[other]
            if joined and branch in closing and not check[branch]:
                return False
            live[one] = max(live[one], live[other])
            block[block == other] = one
        return True

    def sources_before(self, observation: Observation) -> Wholes:
        """Number of the live part in which each bus was in the step before, -1 in a dead one."""
        point = observation.operating_point
        n_buses = self.day.network.n_buses
        if point is None and observation.t0:
            return np.full(n_buses, -1)
        out = out_of_branches(self._out_before(observation.t0), self.branches.ends)[0]
        parts = blocks_of(self.branches.ends, self.closed & ~out, n_buses)
        assert parts is not None  # a configuration has no loop
        if point is None:
            return parts
        v_pu = self._in(self.closed).day.at_buses(point.v_pu)
        return np.where(np.isfinite(v_pu), parts, -1)

    def _out_before(self, t0: int) -> OutOfService:
        """Lines and buses that were out in the step before, in the order of the day."""
        day = self.day
        earlier = replace(day.grid, start=day.grid.start - day.grid.step)
        return OutOfService.of(day.faults, day.network, earlier, range(t0, t0 + 1))

    def _gain_words(self, t0: int, search: Search) -> str:
        """Customers that the operations serve, and until when; or their worth."""
        closed, grid = search.best.candidate.closed, self.day.grid
        closing, opening = closed & ~self.closed, self.closed & ~closed
        verb, which = ("closing", closing) if closing.any() else ("opening", opening)
        what = f"{verb} {named([self.branches.names[i] for i in np.flatnonzero(which)])}"
        plans = (each.decision.dispatch.supplied for each in (search.best, search.stay))
        more = np.greater(*plans)
        gain = search.best.score - search.stay.score
        if not np.isfinite(gain):
            return f"{what} has a plan, and the present configuration has none"
        if not more.any():
            return f"{what} is worth {gain:.3g} weighted customer hours"
        end = grid.start + (t0 + int(np.flatnonzero(more.any(axis=1))[-1]) + 1) * grid.step
        served = counted(int(more.any(axis=0).sum()), "customer")
        return f"{what} serves {served} until {grid.local(end):%H:%M}"

    # Operations now, or later.

    def carried(self, observation: Observation, found: Planned, stay: Planned) -> Planned | None:
        """The plan with the order of its operations, or with the word that they wait; None if not.

        They wait where the parts of the first step are those of the present configuration, and its
        lines and voltages carry the step.
        """
        here = self._in(self.closed)
        if np.array_equal(found.candidate.parts[0], stay.candidate.parts[0]):
            state = self._state(here, observation)
            if self._as_it_is(observation, found):
                decision = self._with_lines_of(state, found.decision)
                if not violations(decision, state, self.within):
                    return replace(found, decision=decision, waits=True)
        order = self._order(observation, found)
        if order.operations is None:
            return None
        return replace(found, order=tuple(one.sentence for one in order.operations))

    def _order(self, observation: Observation, found: Planned) -> SwitchingOrder:
        """Order of operations, from the state in which the last step has left the feeder.

        A fault that begins now comes after them.
        """
        t0 = observation.t0
        before, now = self._out_before(t0), observation.forecast.out
        out = OutOfService(before.lines & now.lines[:1], before.buses & now.buses[:1])
        dark = t0 > 0 and observation.operating_point is None
        feeder = self._feeder(observation, found, out, dark)
        return safe_order(feeder, self.closed, found.candidate.closed)

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
        part = self._in(found.candidate.closed)
        state = self._state(part, observation)
        given = self._injections(state, found.decision)
        p_kw, q_kvar = (part.day.at_buses(each) for each in given)
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
            by_phase=self._by_phase(state, found.decision, formers),
        )

    def _by_phase(
        self, state: StepState, decision: Decision, formers: Formers
    ) -> FlowInStates | None:
        """Power flow by phase of a decision's step in any configuration; None without phases."""
        if not self.day.phases:
            return None
        return FlowInStates(self.day, map(str, formers.id), *self._drawn(state, decision, GRID))

    @staticmethod
    def _drawn(state: StepState, decision: Decision, source: int) -> tuple[Floats, Floats]:
        """Power that devices of a feeder with phases draw in a decision's step, (D,) each."""
        plan, row = decision.dispatch, decision.row
        sun_kw = plan.pv_self_kw[row] + plan.pv_export_kw[row]
        given_kw = plan.discharge_kw[row] - plan.charge_kw[row]
        return phased_model(state.site).powers(
            source,
            load_kw=state.load_kw * plan.supplied[row],
            pv=(sun_kw, plan.pv_q_kvar[row]),
            batteries=(given_kw, plan.batt_q_kvar[row]),
            taken_kw={kind: kw[row] for kind, kw in plan.taken_kw.items()},
            given_kvar={kind: np.nan_to_num(kvar[row]) for kind, kvar in plan.given_kvar.items()},
        )

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

    def _state(self, part: ControllerIn, observation: Observation) -> StepState:
        """The observed step in a configuration."""
        return StepState.of(part.site, self._seen(part, observation), self.centre)

    def _injections(self, state: StepState, decision: Decision) -> tuple[Floats, Floats]:
        """Injections of the buses in a decision's step in kW and kvar, in a configuration."""
        plan, row, site = decision.dispatch, decision.row, state.site
        served_kw = state.load_kw * plan.supplied[row]
        curtailed = curtailed_kw(site, plan.pv_curtailed_kw[row], state.pv_kw, served_kw)
        p_kw = {
            "pv": state.pv_kw - curtailed,
            "batteries": plan.discharge_kw[row] - plan.charge_kw[row],
            "customers": -served_kw,
            **{kind: -plan.taken_by(kind, units)[row] for kind, units in site.kinds.items()},
        }
        q_kvar = {
            "pv": plan.pv_q_kvar[row],
            "batteries": plan.batt_q_kvar[row],
            "customers": -served_kw * site.customers.q_per_p,
            **{kind: kvar[row] for kind, kvar in plan.given_kvar.items()},
        }
        return bus_injections(site, p_kw), bus_injections(site, q_kvar)

    def _with_lines_of(self, state: StepState, decision: Decision) -> Decision:
        """A decision with the flows and voltages that its step has in another configuration."""
        given = self._injections(state, decision)
        p_flow_kw, q_flow_kvar, v_pu = network_state(state, *given)
        plan, row = decision.dispatch, decision.row
        v_node_pu = plan.v_node_pu
        if v_node_pu is not None:
            model, source = phased_model(state.site), supply_of(state)
            found = model.solved(source, *self._drawn(state, decision, source))
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

    Parameters
    ----------
    of : Switching
        Plans and bounds.
    observation : Observation
        What is known.
    stay : Planned
        The plan in the present configuration.
    before : dict
        Memory of its controller before the step.
    limits : SolveLimits
        Gap and time.
    """

    def __init__(
        self,
        of: Switching,
        observation: Observation,
        stay: Planned,
        before: dict[str, Any],
        limits: SolveLimits,
    ) -> None:
        self.stay = self.best = stay
        self.record = Switched(of.closed)
        self.bound = stay.decision.info.bound
        self.deadline = Deadline(limits.time_s)
        self._of = of
        self._observation = observation
        self._before = before
        self._limits = limits
        self._sources = of.sources_before(observation)
        self._known: list[tuple[Wholes, float]] = []

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

    def know(self, candidate: Reached, bound: float) -> None:
        """Remember a bound without network of all that cut the feeder as a configuration does."""
        self._known.append((candidate.parts, bound))

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
        why = "" if self.best is not self.stay else NO_SWITCH if complete else NOT_FOUND
        self.record = replace(self.record, configurations=len(reach.found), why=why)
        if not complete:
            self.bound = np.inf
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
            bound = min(bound, self._of.bound_in(self._observation, part, self.deadline.left_s))
            self.know(part, bound)
            self.record = replace(self.record, bounded=self.record.bounded + 1)
        of_trees = -np.inf
        for way in group:
            if self.beaten(bound - price):
                break
            if not self._of.may_be_joined(way, self._sources):
                continue
            if self.deadline.passed:
                return False
            planned = self._of.planned_in(self._observation, way, self._before)
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
            found = self._of.carried(self._observation, planned, self.stay)
            self.best = found or self.best

    def certified(self) -> Decision:
        """The best decision, with a bound over all configurations, and the time of the search."""
        decision, price = self.best.decision, self.best.candidate.price
        info = decision.info
        if self.record.why != ALL_SERVED:
            solve_s = self.stay.decision.info.solve_s + self.deadline.spent_s
            info = replace(info, solve_s=solve_s)
        bound = max(info.bound, self.bound + price)
        if bound > info.bound and np.isfinite(info.objective):
            gap = max(bound - info.objective, 0.0)
            share = gap / max(abs(info.objective), LEAST_OBJECTIVE) if np.isfinite(gap) else np.inf
            status = info.status
            if status == Status.OPTIMAL and not self._limits.met(bound, info.objective):
                status = str(Status.TIME_LIMIT if self.deadline.passed else Status.GAP_OPEN)
            info = replace(info, bound=bound, gap_abs=gap, gap=share, status=status)
        return replace(decision, info=info)


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


def without_lines(memory: Any, of_planner: bool = False) -> Any:
    """A controller's memory without what its planner knows of lines and voltages.

    >>> without_lines({"_last": 1, "planner": {"kept": {"_last": 2}}})
    {'_last': 1, 'planner': {'kept': {'_last': None}}}
    """
    if isinstance(memory, list):
        return [without_lines(each, of_planner) for each in memory]
    if not isinstance(memory, dict):
        return memory
    return {
        name: None
        if of_planner and name == "_last"
        else without_lines(value, of_planner or name == "planner")
        for name, value in memory.items()
    }
