"""Whether a decision can be carried out in its step: plain numpy, apart from model and plant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.control.by_part import parts_of_step
from vppres.control.phased_rule import supply_of
from vppres.control.step_state import StepState
from vppres.core.arrays import Floats, Names
from vppres.kinds.batteries.physics import power_beyond_kw
from vppres.kinds.kind import UnitPlan
from vppres.kinds.table import KINDS
from vppres.model.formulas import lossless_flows
from vppres.model.parts import at_items
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.physics.phases import NoPhasedSolutionError
from vppres.scenario.source import EXACT_PU


@dataclass(frozen=True)
class Tolerances:
    """Excess that a decision may have before it is refused."""

    #: On ratings, absolute and as a share of the rating.
    power_kw: float = 0.01
    power_share: float = 1e-3
    soc: float = 1e-4  #: on the state of charge at the end of the step, as a share of capacity
    balance_kw: float = 1.0  #: on the active balance of the step
    losses: bool = False  #: whether plans set something aside for losses; the paper's have none
    #: What passes that agree may still be off by. Where the losses themselves are more, a plan may
    #: be off by as much as they are, for passes that were used up before they agreed.
    loss_kw: float = 1.0
    v_pu: float = 1e-4  #: on the voltages of the plan


PAPER = Tolerances()

LOSS_SWEEPS = 3
"""Times that losses are computed, each with the flows that the losses before make: each sweep adds
the losses' share of the power once more, far below a percent."""


def violations(
    decision: Decision,
    state: StepState,
    within: Tolerances = PAPER,
    v_limits_pu: tuple[float, float] | None = None,
) -> list[str]:
    """Limits that a decision violates, each in words; empty if it can be carried out.

    Voltages keep within ``v_limits_pu``, or within those of the network if not given.
    """
    odd = misshapen(decision, state.site)
    if odd:
        return odd
    net = state.site.network
    limits_pu = state.v_limits_pu(*(v_limits_pu or (net.v_min_pu, net.v_max_pu)))
    step = decision.step
    found = (
        _service(step, state),
        _battery_power(step, state, within),
        _kinds(step, state, within),
        _switched_early(step, state),
        _unformed_supply(step, state),
        _dead_parts(step, state),
        _energy(step, state, within),
        _pv(step, state, within),
        _balance(step, state, within),
        _voltage(step, state, limits_pu, within),
    )
    return [text for text in found if text]


def misshapen(decision: Decision, site: Site) -> list[str]:
    """Arrays of the wrong size or with values that are not numbers."""
    sizes = {
        **dict.fromkeys(("served", "share"), len(site.customers)),
        "v_pu": site.network.n_buses,
        **{kind: len(units) for kind, units in site.kinds.items()},
        "v_node_pu": len(site.phases.measured),
        **dict.fromkeys(("p_flow_kw", "q_flow_kvar"), site.network.n_lines),
        **dict.fromkeys(("charge_kw", "discharge_kw", "batt_q_kvar", "soc"), len(site.batteries)),
        **dict.fromkeys(
            ("pv_self_kw", "pv_export_kw", "pv_curtailed_kw", "pv_q_kvar"), len(site.pv)
        ),
    }
    found = []
    plan = decision.dispatch
    by_kind = [*plan.taken_kw.items(), *plan.running.items()]
    for name, given in [*plan.arrays().items(), *by_kind]:
        values = np.asarray(given)
        shape = values.shape[1:]
        wanted = (sizes[name],) if name in sizes else ()
        if not 0 <= decision.row < len(values) or shape != wanted:
            found.append(f"{name} has shape {values.shape}")
        elif not np.isfinite(values[decision.row].astype(float)).all():
            found.append(f"{name} is not finite")
    return found


def _service(step: Dispatch, state: StepState) -> str:
    c = state.site.customers
    share = np.asarray(step.supplied[0], dtype=float)
    partly = np.maximum(c.least_share_but(state.now.whole) - share, share - c.most_share)
    partly = np.minimum(np.abs(share), np.maximum(partly, 0.0))
    return "a customer is supplied in part" if partly.max(initial=0.0) > 1e-6 else ""


def _battery_power(step: Dispatch, state: StepState, within: Tolerances) -> str:
    """Signs, ratings, exclusivity, discs; a battery that is out takes nothing."""
    b = state.site.batteries
    slack = within.power_kw + within.power_share * b.s_max_kva
    powers = (step.charge_kw[0], step.discharge_kw[0], step.batt_q_kvar[0])
    beyond = np.max([*power_beyond_kw(b, *powers, state.online).values()], axis=0)
    return worst_words("battery power", b.id, beyond - slack, beyond, "kVA")


def _kinds(step: Dispatch, state: StepState, within: Tolerances) -> str:
    """Violation of a kind's limits of power or storage; empty if there is none."""
    for kind, known in state.now.ahead.by_kind.items():
        units = state.site.kinds[kind]
        taken_kw, running = step.taken_by(kind, units), step.running_of(kind, units)
        on = units.connected(state.site.customers, step.supplied > 0.0)
        now = known.part(slice(1))
        plan = UnitPlan(taken_kw, running, on)
        beyond = np.maximum(now.power_beyond_kw(plan), now.stored_beyond_kw(plan))[0]
        slack = within.power_kw + within.power_share * units.largest_kw
        found = worst_words(f"{KINDS[kind].word} power", units.id, beyond - slack, beyond, "kW")
        if found:
            return found
    return ""


def _switched_early(step: Dispatch, state: StepState) -> str:
    """Units that start before they may, or run where they must not."""
    islands = state.now.parts.beyond | state.island
    for kind, known in state.now.ahead.by_kind.items():
        units = state.site.kinds[kind]
        outage = at_items(islands, state.site.unit_bus[kind])
        wrong = known.switched_early(step.running_of(kind, units), outage)[0]
        if wrong.any():
            return f"{KINDS[kind].word} switching: {units.id[np.argmax(wrong)]}"
    return ""


def _unformed_supply(step: Dispatch, state: StepState) -> str:
    """Customers on in an island that only a unit of a kind can form, without one that does."""
    if not state.formers or not step.supplied.any():
        return ""
    for kind in state.formers:
        units = state.site.kinds[kind]
        able = state.now.ahead.by_kind[kind].able_to_form()
        if (step.running_of(kind, units)[0] & able).any():
            return ""
    return "island: no set forms the grid"


def _energy(step: Dispatch, state: StepState, within: Tolerances) -> str:
    """State of charge at the end of the step."""
    known = state.batteries_ahead
    end = known.path(step.charge_kw, step.discharge_kw)[1]
    beyond = np.maximum(*known.soc_beyond(end))
    return worst_words("battery energy", known.units.id, beyond - within.soc, beyond, "of capacity")


def _pv(step: Dispatch, state: StepState, within: Tolerances) -> str:
    pv = state.site.pv
    slack = within.power_kw + within.power_share * pv.s_max_kva
    beyond = np.maximum(-step.pv_curtailed_kw[0], np.abs(step.pv_q_kvar[0]) - pv.s_max_kva)
    return worst_words("pv", pv.id, beyond - slack, beyond, "kVA")


def _dead_parts(step: Dispatch, state: StepState) -> str:
    """Customers on in parts of the feeder that nothing forms."""
    off = at_items(state.now.parts.dead, state.site.customer_bus)[0]
    wrong = off & (step.supplied[0] > 0.0)
    if not wrong.any():
        return ""
    return f"fault: nothing forms the grid at {state.site.customers.id[np.argmax(wrong)]}"


def _balance(step: Dispatch, state: StepState, within: Tolerances) -> str:
    """Violation of the power balance of a part of the feeder; empty if there is none."""
    found = (_balance_in(step, part, within) for part in parts_of_step(state))
    return next(filter(None, found), "")


def _balance_in(step: Dispatch, state: StepState, within: Tolerances) -> str:
    """Violation of the import or export limit by the power balance; empty if there is none."""
    pv = state.site.pv
    step = state.own_part(step)
    share = np.asarray(step.supplied[0], dtype=float)
    taken = float(state.load_kw @ share + step.charge_kw.sum() + state.drawn_kw.sum())
    taken += sum(float(taken_kw.sum()) for taken_kw in step.taken_kw.values())
    given = float(state.sun_kw(step).sum() + step.discharge_kw.sum())
    losses_kw = given_kw = 0.0
    if within.losses:
        drawn_kw = _phased_network_kw if state.site.phases else _losses_kw
        found_kw = drawn_kw(step, state)
        losses_kw = max(found_kw, 0.0) + max(abs(found_kw), within.loss_kw)
        given_kw = 2.0 * max(-found_kw, 0.0)  # loads of a phase that draw less at low voltage
    if state.island and within.losses:  # what buses take that no asset draws, and what they give
        net = state.site.network
        at_bus_kw = net.drawn(np.ones(net.n_buses))[0]
        losses_kw += float(at_bus_kw.clip(min=0.0).sum())
        given_kw -= float(at_bus_kw.clip(max=0.0).sum())
    short = taken - given - state.grid_limit_kw
    surplus = given - taken - max(state.export_limit_kw, state.network_to_grid_kw)
    # What each inverter may be off by adds up here: a plan must not pass there and fail here.
    slack_kw = within.balance_kw + within.power_kw * len(pv)
    if short > slack_kw + given_kw:
        return f"balance: {short:.1f} kW short"
    if surplus > slack_kw + losses_kw:
        return f"balance: {surplus:.1f} kW surplus"
    return ""


def _phased_network_kw(step: Dispatch, state: StepState) -> float:
    """Power that a phased feeder draws beyond its assets, in kW; 0 without a solution."""
    model = phased_model(state.site)
    source = supply_of(state)
    p_kw, q_kvar = state.powers(step, source)
    try:
        found = model.solved(source, p_kw, q_kvar)
    except NoPhasedSolutionError:
        return 0.0
    return 0.0 if found is None else float(model.supplies[source].beyond(found, p_kw, q_kvar)[0][0])


def _losses_kw(step: Dispatch, state: StepState) -> float:
    """Losses of the flows that follow from the set-points, at the voltages of the plan."""
    net = state.site.network
    p_kw, q_kvar = state.injections(step)
    # Limited, so that the losses of a plan with nonsense for voltages are still numbers.
    v_pu = np.clip(step.v_pu[0], net.v_min_pu, net.v_max_pu) / net.bus_ratio
    per_v2 = 1.0 / v_pu[net.parent] ** 2
    loss_kw = np.zeros(net.n_lines)
    loss_kvar = np.zeros(net.n_lines)
    for _ in range(LOSS_SWEEPS):
        # A line's loss is drawn at its far end, as the plan has it.
        p_flow = lossless_flows(net, p_kw - state.drawn_kw - np.append(0.0, loss_kw))
        q_flow = lossless_flows(net, q_kvar - state.drawn_kvar - np.append(0.0, loss_kvar))
        squared = (p_flow**2 + q_flow**2) * per_v2
        loss_kw = net.r_pu2_per_kw * squared
        loss_kvar = net.x_pu2_per_kvar * squared
    return float(loss_kw.sum())


def _voltage(
    step: Dispatch, state: StepState, limits_pu: tuple[Floats, Floats], within: Tolerances
) -> str:
    """Voltages of the plan; those without control are known no better than a linear model is."""
    lowest, highest = limits_pu
    off_pu = max(within.v_pu, EXACT_PU) if len(state.own_v_pu) else within.v_pu
    v_pu = step.v_pu[0]
    outside = np.maximum(lowest - v_pu, v_pu - highest)[1:]  # the slack bus is given
    worst = int(np.argmax(outside))
    return f"voltage: {v_pu[1:][worst]:.4f} pu" if outside[worst] > off_pu else ""


def worst_words(check: str, names: Names, excess: Floats, beyond: Floats, unit: str) -> str:
    """Text on the item that is furthest beyond its tolerance, empty if none is."""
    if len(excess) == 0 or excess.max() <= 0:
        return ""
    i = int(np.argmax(excess))
    return f"{check}: {names[i]} by {beyond[i]:.3g} {unit}"
