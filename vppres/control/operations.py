"""Operations of switches that lead to a plan's configuration, at its first step.

They have an order, or none that is safe, or they wait for the step that needs them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.contract.observation import Observation
from vppres.control.candidates import Reached
from vppres.control.configurations import InConfiguration
from vppres.control.guard.check import Tolerances, violations
from vppres.control.phased_rule import supply_of
from vppres.control.step_state import StepState, network_state
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.feeders.reconfiguration.by_phase import FlowInStates
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import safe_order
from vppres.feeders.reconfiguration.states import Formers, SwitchedFeeder
from vppres.model.phases import GRID, phased_model
from vppres.physics.phased_sources import farthest
from vppres.scenario.configuration import blocks_of, out_of_branches
from vppres.scenario.faults import OutOfService


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

    @classmethod
    def of(cls, candidate: Reached, decision: Decision, memory: dict[str, Any]) -> Planned:
        """A decision with its worth; a fallback proves none."""
        objective = decision.info.objective
        sound = decision.fallback == "none" and np.isfinite(objective)
        return cls(candidate, decision, objective - candidate.price if sound else -np.inf, memory)

    @property
    def bound(self) -> float:
        """Most that a plan there can be worth, less its operations; infinite if it is not known."""
        known = np.isfinite(self.score)
        return self.decision.info.bound - self.candidate.price if known else np.inf


@dataclass(frozen=True, eq=False)
class Operations:
    """Operations from the present configuration, in the order of the day."""

    of: InConfiguration  #: the present configuration
    observation: Observation  #: the step
    before: OutOfService  #: lines and buses that were out before them, of one step
    out: OutOfService  #: those that are out during them, of one step
    live: Flags  #: buses that have voltage when they begin, (N,)
    within: Tolerances  #: what the check of a decision lets pass

    def carried(self, found: Planned, stay: Planned) -> Planned:
        """The plan with the order of its operations, or why there is none, or that they wait.

        They wait where the parts of the first step are those of the present configuration, and its
        lines and voltages carry the step.
        """
        if np.array_equal(found.candidate.parts[0], stay.candidate.parts[0]):
            state = self.of.state_in(self.of.controller_in(self.of.closed), self.observation)
            if self._as_it_is(found):
                decision = _with_lines_of(state, found.decision)
                if not violations(decision, state, self.within):
                    return replace(found, decision=decision, waits=True)
        feeder = self._feeder(found, self.out, not self.live.any())
        order = safe_order(feeder, self.of.closed, found.candidate.closed)
        if order.operations is None:
            return replace(found, barred=order.reason)
        return replace(found, order=tuple(one.sentence for one in order.operations))

    def barred(self, candidate: Reached) -> str:
        """Name of a switch that joins two live parts and cannot compare both sides, or nothing."""
        branches, closed = self.of.branches, self.of.closed
        live = self._sources.copy()
        kept = np.flatnonzero(candidate.closed & closed)
        closing = np.flatnonzero(candidate.closed & ~closed)
        check = branches.of_moves("sync_check").astype(bool)
        block = np.arange(len(live))
        for branch in [*kept, *closing[np.argsort(check[closing], kind="stable")]]:
            one, other = block[branches.ends[branch]]
            joined = live[one] >= 0 and live[other] >= 0 and live[one] != live[other]
            if joined and branch in closing and not check[branch]:
                return str(branches.names[branch])
            live[one] = max(live[one], live[other])
            block[block == other] = one
        return ""

    @cached_property
    def _sources(self) -> Wholes:
        """Number of the live part of each bus before operations, -1 in a dead one."""
        ends = self.of.branches.ends
        out = out_of_branches(self.before, ends)[0]
        parts = blocks_of(ends, self.of.closed & ~out, len(self.live))
        assert parts is not None  # a configuration has no loop
        return np.where(self.live, parts, -1)

    def _as_it_is(self, found: Planned) -> bool:
        """Whether the phases of the present configuration carry the first step of a plan.

        Or by no less than those of the plan's own do.
        """
        if not self.of.day.phases:
            return True
        out = self.observation.forecast.out.part(slice(1))
        feeder = self._feeder(found, out, dark=False)
        planned = found.candidate.closed
        here, there = (safe_order(feeder, each, each).before for each in (self.of.closed, planned))
        return -np.inf < here.value >= min(there.value, 0.0)

    def _feeder(self, found: Planned, out: OutOfService, dark: bool) -> SwitchedFeeder:
        """The feeder at a plan's first step, with what is out, one step."""
        day, branches = self.of.day, self.of.branches
        net, forecast = day.network, self.observation.forecast
        part = self.of.controller_in(found.candidate.closed)
        state = self.of.state_in(part, self.observation)
        step = found.decision.step
        p_kw, q_kvar = (part.day.at_buses(each) for each in state.injections(step))
        formers = Formers.none() if dark else self._formers(step)
        by_phase = None
        if day.phases:
            by_phase = FlowInStates(day, map(str, formers.id), *state.powers(step, GRID))
        return SwitchedFeeder(
            net,
            day.switches,
            p_kw,
            q_kvar,
            ConfigurationLimits(net.v_min_ac_pu, net.v_max_ac_pu, part.site.rated),
            grid=not dark and (not self.within.losses or forecast.grid_limit_kw[0] > 0.0),
            formers=formers,
            faulted=out_of_branches(out, branches.ends)[0],
            bus_out=out.buses[0],
            movable=branches.movable(~self.of.closed, forecast.out),
            customers=day.customers.by_bus,
            by_phase=by_phase,
        )

    def _formers(self, step: Dispatch) -> Formers:
        """Batteries that can hold an island, with their set-points."""
        b = self.of.day.batteries
        able = np.flatnonzero(self.of.day.formers & b.holds_energy(self.observation.soc))
        return Formers(
            b.id[able],
            b.bus[able],
            b.s_max_kva[able],
            -b.active_max_kw[able],
            b.active_max_kw[able],
            (step.discharge_kw - step.charge_kw)[0, able],
            step.batt_q_kvar[0, able],
        )


def _with_lines_of(state: StepState, decision: Decision) -> Decision:
    """A decision with the flows and voltages that its step has in another configuration."""
    step = decision.step
    p_flow_kw, q_flow_kvar, v_pu = network_state(state, *state.injections(step))
    plan, row = decision.dispatch, decision.row
    v_node_pu = plan.v_node_pu
    if v_node_pu is not None:
        model, source = phased_model(state.site), supply_of(state)
        found = model.solved(source, *state.powers(step, source))
        if found is not None:
            of_nodes = model.supplies[source].flow.v_pu(found.v)
            v_node_pu = _with_row(v_node_pu, row, of_nodes)
            v_pu = farthest(of_nodes, model.at_bus, len(v_pu))
    return replace(
        decision,
        dispatch=replace(
            plan,
            v_node_pu=v_node_pu,
            p_flow_kw=_with_row(plan.p_flow_kw, row, p_flow_kw),
            q_flow_kvar=_with_row(plan.q_flow_kvar, row, q_flow_kvar),
            v_pu=_with_row(plan.v_pu, row, v_pu),
        ),
    )


def _with_row(values: Floats, row: int, changed: Floats) -> Floats:
    """Values with another row."""
    found = np.array(values)
    found[row] = changed
    return found
