"""Flexible power in a step by rule: sets stay as they are, and vehicles charge while there is grid.

Both give way: to service, to limits, and to a balance that would not close. The one set that is
started is what forms the grid of an island where nothing else can.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decision, SolveInfo
from vppres.contract.dispatch import Dispatch
from vppres.control.rules import POWER_TOLERANCE_KW, Carried, carry, rule_dispatch
from vppres.control.step_state import StepState
from vppres.core.arrays import Floats
from vppres.kinds.gensets.data import Gensets
from vppres.kinds.gensets.physics import SetsAhead
from vppres.kinds.vehicles.physics import Plugged


def rule_with_kinds(state: StepState, tiers: Sequence[str]) -> Carried:
    """The dispatch by rule with as much flexible power as costs no service.

    Parameters
    ----------
    state : StepState
        The step.
    tiers : sequence of str
        Names of the tiers, the most important first.
    """
    if state.dark:
        return _dispatch_beside_set(state, tiers)
    alone = rule_dispatch(state, tiers)
    least = float(alone.dispatch.served[0] @ state.worth)
    for tried in _states_to_try(state):
        found = rule_dispatch(tried, tiers)
        costs_service = float(found.dispatch.served[0] @ state.worth) < least
        closes = found.surplus_kw <= POWER_TOLERANCE_KW and found.no_worse_than(alone)
        if closes and not costs_service and _charges_only_supplied(found.dispatch, state):
            return found
    return alone


def by_rule(state: StepState, tiers: Sequence[str], reason: str) -> Decision:
    """Decision by rule as a fallback, with the reason for it."""
    carried = rule_with_kinds(state, tiers)
    words = f"{reason}; left open: {carried.shortage}" if carried.shortage else reason
    return Decision(
        carried.dispatch, 0, SolveInfo(status="rule"), fallback="rule", fallback_reason=words
    )


def _states_to_try(state: StepState) -> Iterator[StepState]:
    """The step with vehicles and sets as they are, without the vehicles, with other powers.

    Sets follow what is left of the demand beside PV, or give their least power.
    """
    sets = state.ahead.find(SetsAhead)
    if sets is None:
        yield _with_charging(state)
        return
    as_they_are = _with_running_sets(state, sets, sets.was_kw[0])
    yield _with_charging(as_they_are)
    yield as_they_are
    lacking_kw = float(state.load_kw.sum() + state.drawn_kw.sum() - state.usable_pv_kw.sum())
    share = state.site.gensets.p_max_kw / state.site.gensets.p_max_kw.sum()
    for wanted_kw in (lacking_kw * share, 0.0 * share):
        yield _with_running_sets(state, sets, wanted_kw)


def _dispatch_beside_set(state: StepState, tiers: Sequence[str]) -> Carried:
    """The dispatch by rule beside the set that forms the grid, no supply if none can.

    A customer that it can supply at its largest power gets what it lacks.
    """
    sets = state.ahead.find(SetsAhead)
    forms = state.forms
    if sets is None or not forms.any():
        return _no_supply(state)
    most = rule_dispatch(
        _with_running_sets(state, sets, state.site.gensets.p_max_kw * forms), tiers
    )
    served = most.dispatch.served[0]
    lacking_kw = float(state.load_kw @ served + state.drawn_kw.sum() - state.usable_pv_kw.sum())
    wanted_kw = np.where(forms, lacking_kw, 0.0)
    found = rule_dispatch(_with_running_sets(state, sets, wanted_kw), tiers)
    closes = found.surplus_kw <= POWER_TOLERANCE_KW and found.dispatch.served.any()
    return found if closes else _no_supply(state)


def _no_supply(state: StepState) -> Carried:
    """A step of an island that no source can form: no supply, and all PV power curtailed."""
    site = state.site
    without_power = replace(state, pv_kw=0.0 * state.pv_kw, drawn=None)
    served = np.zeros(len(site.customers), dtype=bool)
    found = carry(without_power, served, np.zeros(len(site.batteries)))
    assert found is not None  # with no demand and no power every balance closes
    curtailed = replace(found.dispatch, pv_curtailed_kw=state.pv_kw[np.newaxis])
    return replace(found, dispatch=curtailed)


def _charges_only_supplied(plan: Dispatch, state: StepState) -> bool:
    """Whether no vehicle charges behind a customer that is off."""
    chargers = state.site.chargers
    on = chargers.connected(state.site.customers, plan.served)
    return not (plan.taken_by("chargers", chargers)[~on] > 0.0).any()


def as_planned(state: StepState, plan: Dispatch, row: int) -> StepState:
    """The step with the flexible power of a plan; a vehicle that has not come takes none."""
    taken_kw = {kind: kw[row] for kind, kw in plan.taken_kw.items()}
    plugged = state.ahead.find(Plugged)
    if plugged is not None and "chargers" in taken_kw:
        taken_kw["chargers"] = np.where(plugged.here[0], taken_kw["chargers"], 0.0)
    return replace(
        state,
        taken_kw=taken_kw,
        running={kind: on[row] for kind, on in plan.running.items()},
    )


def _with_running_sets(state: StepState, known: SetsAhead, wanted_kw: Floats) -> StepState:
    """Step state with the sets that are on or form the grid, and have fuel, near what is wanted."""
    sets, dt_h = state.site.gensets, state.site.dt_h
    most_kw = np.minimum(sets.p_max_kw, _by_fuel_kw(sets, known.added_litres[0], dt_h))
    fallen_kw = np.where(state.forms, 0.0, known.was_kw[0] - sets.fall_kw(dt_h))
    least_kw = np.maximum(sets.p_min_kw, fallen_kw)
    wanted = (known.was_on[0] > 0.5) | state.forms
    in_use = state.island | ~sets.only_in_outage | known.must_run[0]
    on = wanted & in_use & known.can_run[0] & (most_kw >= least_kw)
    given_kw = np.where(on, np.clip(wanted_kw, least_kw, most_kw), 0.0)
    return replace(
        state,
        taken_kw={**state.taken_kw, "gensets": -given_kw},
        running={**state.running, "gensets": on},
    )


def _by_fuel_kw(sets: Gensets, litres: Floats, dt_h: float) -> Floats:
    """Power over a step that so much fuel is enough for."""
    per_h = np.minimum(litres, sets.tank_litres) / dt_h - sets.litres_per_h_idle
    return np.asarray(per_h / sets.litres_per_kwh)


def _with_charging(state: StepState) -> StepState:
    """Step state with vehicles that charge as fast as they can, if there is grid."""
    plugged, chargers = state.ahead.find(Plugged), state.site.chargers
    if plugged is None or state.island:
        return state
    room_kw = (plugged.full_kwh[0] - plugged.held_kwh[0]) / state.site.dt_h / chargers.eta_charge
    most_kw = np.where(plugged.here[0], np.clip(room_kw, 0.0, chargers.p_charge_kw), 0.0)
    return replace(state, taken_kw={**state.taken_kw, "chargers": most_kw})
