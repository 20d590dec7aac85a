"""The rule in an island of a phased feeder: a customer is served if every phase carries it.

Customers' batteries supply what is on their own coils, PV systems what is behind their meters, and
the battery that forms the island the rest of each phase. Where capacitors give a phase more
reactive power than its third of the former takes, batteries on that phase alone take it. So no
set-point burdens a phase that it does not relieve, and a power flow by phase says of every set
whether it is carried.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.control.step_state import StepState, network_state, one_step
from vppres.core.arrays import Flags, Floats
from vppres.model.formulas import bus_injections, cell_kw, soc_after
from vppres.model.phases import ISLAND, PhasedModel, phased_model
from vppres.physics.phases import NoPhasedSolutionError, PhasedResult
from vppres.scenario.phases import PHASES

MOST_FLOWS = 4
"""Power flows in which batteries take what is beyond a phase of the former, for one schedule."""

AIM = 0.95
"""Share of its rating that is left of the power of a phase that was beyond it."""

ISLANDED: Flags = np.array(True)

TOLERANCE_KVA = 1e-3
"""By how much a phase of the former may be beyond its rating: a watt, as in the power flow."""

REST_PU = 1e-3
"""By how much a voltage that is outside its limits at rest may be further outside: what loads on
other phases and magnetising currents move it by."""


def served_by_phase(state: StepState, order: Iterable[int]) -> Dispatch:
    """Customers in an order, each if all phases carry it beside those before.

    Parameters
    ----------
    state : StepState
        A step without grid, of a site with phases.
    order : iterable of int
        Positions of customers, the most important first.
    """
    served = np.zeros(len(state.site.customers), dtype=bool)
    nothing = np.zeros((2, len(state.site.batteries)))
    best = _carried(state, served, nothing[1])
    if best is None:
        return _dispatch(state, served, nothing)
    # Customers that are carried together are carried one by one: most of them take no flow each.
    blocks = [np.array(list(order), dtype=int)]
    while blocks:
        block = blocks.pop()
        tried = served.copy()
        tried[block] = True
        found = _carried(state, tried, best.taken_kvar, best)
        if found is not None:
            served, best = tried, found
        elif len(block) > 1:
            first, second = np.array_split(block, 2)
            blocks += [second, first]
    return _dispatch(state, served, best.given)


@dataclass(frozen=True, eq=False)
class _Carried:
    """Power of batteries, (2, B): active and reactive, and what they took for the feeder, (B,).

    ``drawn_kw`` (D,) is what assets draw, ``source_kw`` (3,) what the former's phases give.
    """

    given: Floats
    taken_kvar: Floats
    drawn_kw: Floats
    source_kw: Floats


def carried_by_phase(state: StepState, dispatch: Dispatch) -> bool:
    """Whether a power flow by phase carries a dispatch of one step, its former's own part apart."""
    model = phased_model(state.site)
    load_kw = state.load_kw * dispatch.supplied[0]
    pv = (dispatch.pv_self_kw[0] + dispatch.pv_export_kw[0], dispatch.pv_q_kvar[0])
    batteries = (dispatch.discharge_kw[0] - dispatch.charge_kw[0], dispatch.batt_q_kvar[0])
    taken_kw = {kind: kw[0] for kind, kw in dispatch.taken_kw.items()}
    drawn = model.powers(ISLANDED, load_kw, pv, batteries, taken_kw)
    found = _flow(state, model, *drawn)
    return found is not None and _fits(state, model, found)


def _flow(
    state: StepState, model: PhasedModel, p_kw: Floats, q_kvar: Floats
) -> PhasedResult | None:
    """The power flow of what assets draw, None without a former, or without a solution."""
    if model.former is None or not state.online[model.former]:
        return None
    try:
        return model.solved(True, p_kw, q_kvar)
    except NoPhasedSolutionError:
        return None


def _rating_kva(state: StepState, model: PhasedModel, found: PhasedResult) -> float:
    """Rating of each phase of the former."""
    return float(state.site.batteries.s_max_kva[model.former]) / len(found.source_kva)


def _fits(state: StepState, model: PhasedModel, found: PhasedResult) -> bool:
    """Whether the former and all voltages allow a power flow."""
    former = model.former
    net = state.site.feeder
    given_kw = float(found.source_kva.sum().real)
    rating_kva = _rating_kva(state, model, found)
    v_pu = model.flows[ISLAND].v_pu(found.v)[model.limited]
    # Limits give way to the voltages at rest, as those of plans do.
    at_rest_pu = np.sqrt(model.slopes[ISLAND].u_0)[model.limited]
    return bool(
        -state.charge_max_kw[former] <= given_kw <= state.discharge_max_kw[former]
        and np.abs(found.source_kva).max() <= rating_kva + TOLERANCE_KVA
        and (v_pu >= np.minimum(net.v_min_ac_pu, at_rest_pu) - REST_PU).all()
        and (v_pu <= np.maximum(net.v_max_ac_pu, at_rest_pu) + REST_PU).all()
    )


def _carried(
    state: StepState, served: Flags, taken_kvar: Floats, before: _Carried | None = None
) -> _Carried | None:
    """Power of batteries for a supply schedule, None if a phase does not carry it.

    What they took before for the feeder is where the search for what they take begins. No power
    flow is needed where half of what is drawn more than before is beyond the former already.
    """
    site = state.site
    model = phased_model(site)
    own = state.own_kw(served)
    behind = _behind_meters(state, served, own, model)
    load_kw = state.load_kw * served
    lowest_kvar = -np.sqrt(np.maximum(site.batteries.s_max_kva**2 - behind[0] ** 2, 0.0))
    found: PhasedResult | None = None
    for _ in range(MOST_FLOWS):
        given = np.array([behind[0], np.maximum(behind[1] - taken_kvar, lowest_kvar)])
        batteries = given[0], given[1]
        drawn = model.powers(ISLANDED, load_kw, (own, 0.0 * own), batteries, state.taken_kw)
        if before is not None and _far_beyond(state, model, before, drawn[0]):
            return None
        found = _flow(state, model, *drawn)
        if found is None:
            return None
        more_kvar = _taken_kvar(state, model, found, given[1] - lowest_kvar)
        if not more_kvar.any():
            break
        taken_kvar = behind[1] - given[1] + more_kvar
    if found is None or not _fits(state, model, found):
        return None
    total = found.source_kva.sum()
    given[:, model.former] = total.real, total.imag
    return _Carried(given, taken_kvar, drawn[0], found.source_kva.real)


def _far_beyond(state: StepState, model: PhasedModel, before: _Carried, drawn_kw: Floats) -> bool:
    """Whether half of what is drawn more than before is beyond the former's active power."""
    assert model.former is not None
    more_kw = model.slopes[ISLAND].former_p.real @ (drawn_kw - before.drawn_kw)
    half_kw = before.source_kw + 0.5 * more_kw
    rating_kva = float(state.site.batteries.s_max_kva[model.former]) / len(half_kw)
    most_kw = float(state.discharge_max_kw[model.former])
    return bool(half_kw.sum() > most_kw or half_kw.max() > rating_kva + TOLERANCE_KVA)


def _taken_kvar(
    state: StepState, model: PhasedModel, found: PhasedResult, room_kvar: Floats
) -> Floats:
    """Reactive power that batteries on one phase take of it, as they have room, (B,).

    It is what the feeder gives the former on that phase beyond its rating, and a little more.
    """
    phases = state.site.phases
    rating_kva = _rating_kva(state, model, found)
    beyond = np.abs(found.source_kva) > rating_kva + TOLERANCE_KVA
    least_kvar = np.sqrt(np.maximum((AIM * rating_kva) ** 2 - found.source_kva.real**2, 0.0))
    surplus_kvar = np.where(beyond, -found.source_kva.imag - least_kvar, 0.0)
    coils = np.array([phases.connection(str(name)).coils for name in state.site.batteries.id])
    taken = np.zeros(len(coils))
    for phase, kvar in zip(PHASES, surplus_kvar, strict=True):
        own = np.where((coils == phase) & state.online, room_kvar, 0.0)
        if kvar > 0.0 and own.sum() > 0.0:
            taken += own * min(kvar / own.sum(), 1.0)
    return taken


def _behind_meters(state: StepState, served: Flags, own: Floats, model: PhasedModel) -> Floats:
    """Power that batteries but the former give to what is served on their own coils, (2, B)."""
    site = state.site
    phases = site.phases
    load_kw = state.load_kw * served
    own_kw = np.bincount(site.owner, own, len(load_kw))
    kw = np.stack([load_kw - own_kw, load_kw * site.customers.q_per_p], axis=1)
    rows = [phases.connection(str(name)) for name in site.batteries.id]
    left = {(row.bus, row.coils): np.zeros(2) for row in rows}
    for c, name in enumerate(site.customers.id):
        at = phases.connection(str(name))
        if (at.bus, at.coils) in left:
            left[at.bus, at.coils] = left[at.bus, at.coils] + kw[c]
    given = np.zeros((2, len(site.batteries)))
    for b, row in enumerate(rows):
        need = left[row.bus, row.coils]
        if b == model.former or not state.online[b]:
            continue
        most_kw = float(state.discharge_max_kw[b])
        active_kw = min(max(float(need[0]), 0.0), most_kw)
        room = np.sqrt(max(float(site.batteries.s_max_kva[b]) ** 2 - active_kw**2, 0.0))
        given[:, b] = active_kw, np.clip(need[1], -room, room)
        left[row.bus, row.coils] = need - given[:, b]
    return given


def _dispatch(state: StepState, served: Flags, given: Floats) -> Dispatch:
    """A dispatch of powers that batteries give, (2, B): active and reactive."""
    site = state.site
    own = state.own_kw(served)
    load_kw = state.load_kw * served
    given_kw = {"pv": own, "batteries": given[0], "customers": -load_kw}
    p = bus_injections(site, given_kw | {kind: -kw for kind, kw in state.taken_kw.items()})
    kvar = load_kw * site.customers.q_per_p
    q = bus_injections(site, {"batteries": given[1], "customers": -kvar})
    p_flow, q_flow, v_pu = network_state(state, p, q)
    charge, discharge = np.maximum(-given[0], 0.0), np.maximum(given[0], 0.0)
    stored_kw = cell_kw(charge, discharge, state.eta_charge, state.eta_discharge)
    dispatch = one_step(
        served=served,
        pv_self_kw=own,
        pv_export_kw=0.0 * own,
        pv_curtailed_kw=state.pv_kw - own,
        pv_q_kvar=0.0 * own,
        charge_kw=charge,
        discharge_kw=discharge,
        batt_q_kvar=given[1],
        p_grid_kw=0.0,
        q_grid_kvar=0.0,
        v_pu=v_pu,
        p_flow_kw=p_flow,
        q_flow_kvar=q_flow,
        soc=np.vstack([state.soc, soc_after(state.soc, stored_kw, site.batteries, site.dt_h)]),
    )
    for kind, kw in state.taken_kw.items():
        on = state.running.get(kind)
        dispatch = dispatch.acting(kind, kw[np.newaxis], None if on is None else on[np.newaxis])
    return dispatch
