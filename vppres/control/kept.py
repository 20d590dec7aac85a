"""Flexible power in a step by rule: units go on by the rules of their kinds.

They give way: to service, to limits, and to a balance that would not close. The one unit that is
started is what forms the grid of an island where nothing else can.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.control.by_part import by_part, no_supply
from vppres.control.carried import POWER_TOLERANCE_KW, Carried
from vppres.control.rules import rule_dispatch
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags


def rule_with_kinds(state: StepState, tiers: Sequence[str]) -> Carried:
    """The dispatch by rule with as much flexible power as costs no service."""
    if state.dark:
        return _dispatch_beside(state, state.formers, tiers)
    alone = rule_dispatch(state, tiers)
    least = float(alone.served[0] @ state.worth)
    if state.holders:
        beside = _dispatch_beside(state, state.holders, tiers)
        if float(beside.served[0] @ state.worth) > least:
            return beside
    for tried in _states_to_try(state):
        found = rule_dispatch(tried, tiers)
        costs_service = float(found.served[0] @ state.worth) < least
        closes = found.surplus_kw <= POWER_TOLERANCE_KW and found.no_worse_than(alone)
        if closes and not costs_service and _only_supplied_take(found, state):
            return found
    return alone


def by_rule(state: StepState, tiers: Sequence[str], reason: str) -> Decision:
    """Decision by rule as a fallback, with the reason for it."""
    carried = by_part(state, lambda part: rule_with_kinds(part, tiers))
    assert carried is not None  # a rule always has an answer
    words = f"{reason}; left open: {carried.shortage}" if carried.shortage else reason
    return Decision(carried, 0, SolveInfo(status="rule"), fallback="rule", fallback_reason=words)


def _states_to_try(state: StepState) -> Iterator[StepState]:
    """The step with each kind by its rule; one kind after another gives way."""
    lacking_kw = float(state.load_kw.sum() + state.drawn_kw.sum() - state.usable_pv_kw.sum())
    ways = {
        kind: known.by_rule(lacking_kw, state.island)
        for kind, known in state.now.ahead.by_kind.items()
    }
    tried = state.acting({kind: of_kind[0] for kind, of_kind in ways.items()})
    yield tried
    for kind, of_kind in ways.items():
        for way in of_kind[1:]:
            tried = tried.acting({kind: way})
            yield tried


def _dispatch_beside(
    state: StepState, formers: Mapping[str, Flags], tiers: Sequence[str]
) -> Carried:
    """The dispatch by rule beside the unit that forms the grid, no supply if none can.

    A customer that it can supply at its largest power gets what it lacks.
    """
    if not formers:
        return no_supply(state)
    most = rule_dispatch(_beside(state, formers, np.inf), tiers)
    served = most.served[0]
    lacking_kw = float(state.load_kw @ served + state.drawn_kw.sum() - state.usable_pv_kw.sum())
    found = rule_dispatch(_beside(state, formers, lacking_kw), tiers)
    closes = found.surplus_kw <= POWER_TOLERANCE_KW and found.served.any()
    return found if closes else no_supply(state)


def _beside(state: StepState, formers: Mapping[str, Flags], wanted_kw: float) -> StepState:
    """Step state with the units that form the grid near what is wanted."""
    acts = {}
    for kind, forms in formers.items():
        units = state.site.kinds[kind]
        each_kw = np.where(forms, np.minimum(wanted_kw, units.largest_kw), 0.0)
        acts[kind] = state.now.ahead.by_kind[kind].beside(each_kw, state.island)
    return state.acting(acts)


def _only_supplied_take(plan: Dispatch, state: StepState) -> bool:
    """Whether no unit takes power behind a customer that is off."""
    customers = state.site.customers
    return not any(
        (plan.taken_by(kind, units)[~units.connected(customers, plan.served)] > 0.0).any()
        for kind, units in state.site.kinds.items()
    )


def as_planned(state: StepState, plan: Dispatch, row: int) -> StepState:
    """The step with the flexible power of a plan, of the units that are there."""
    by_kind = state.now.ahead.by_kind
    return replace(
        state,
        taken_kw={kind: by_kind[kind].here_kw(kw[row]) for kind, kw in plan.taken_kw.items()},
        running={kind: on[row] for kind, on in plan.running.items()},
    )
