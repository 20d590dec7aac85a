"""Dispatch of one step by rule, without a solver: the answer that is always there.

Who is served is decided by tier, then by weight per kW, which counts a longest time off that has
ended. PV power comes first, then import, then the batteries; a surplus is exported as far as the
grid takes it, then stored, then curtailed. Active balance, ratings and state of charge always hold.
The first tier is not let go for reactive power or voltages: what they lack is said instead, and no
customer is added that would make it worse. In an island of a phased feeder a customer is added only
if each phase carries it: the whole island would go dark otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vppres.control.carried import (
    POWER_TOLERANCE_KW,
    Carried,
    dispatch_of,
    in_proportion,
    with_more,
)
from vppres.control.phased_rule import capacity_by_phase_kw, served_by_phase
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.solve.fleet.relaxation import weight_grid

ROUNDING_KW = 1e-9
SEARCH_NODES = 20_000
"""Limit of the search for the best first tier; equal weights need as many nodes as customers."""


def rule_dispatch(
    state: StepState, tiers: Sequence[str], battery_kw: Floats | None = None
) -> Carried:
    """Serve by tier, then by weight per kW, what can be carried in this step.

    Batteries charge with ``battery_kw``, negative to discharge, unless service needs it.
    """
    customers = state.site.customers
    if state.island and state.site.phases:
        blocks = blocks_of_service(state, tiers, capacity_by_phase_kw(state))
        return served_by_phase(state, blocks)
    idle = np.zeros(len(state.site.batteries))
    everyone = np.ones(len(customers), dtype=bool)
    found = carry(state, everyone, idle if battery_kw is None else battery_kw)
    if found is not None and not found.shortage:
        return found
    # No customer is disconnected for a battery's sake.
    nobody = np.zeros(len(customers), dtype=bool)
    others = customers.tier != tiers[0]

    def beside(tried: Flags, before: Carried) -> Carried | None:
        found = carry(state, tried, idle)
        given = found is not None and (not tried[others].any() or found.no_worse_than(before))
        return found if given else None

    alone = carry(state, nobody, idle)
    assert alone is not None  # nothing has to be carried
    return with_more(nobody, alone, blocks_of_service(state, tiers, state.capacity_kw), beside)


def blocks_of_service(state: StepState, tiers: Sequence[str], capacity_kw: float) -> list[Wholes]:
    """Positions of the customers in the order of service: the best of the first tier, all others.

    The best are those of the largest worth that a capacity suffices for.
    """
    order = service_order(state, tiers)
    first = np.flatnonzero(state.site.customers.tier == tiers[0])
    best = first[best_subset(state.worth[first], state.load_kw[first], capacity_kw)]
    chosen = np.isin(order, best)
    return [order[chosen], order[~chosen]]


def service_order(state: StepState, tiers: Sequence[str]) -> Wholes:
    """Positions of the customers by tier, then by weight per kW, shape (C,)."""
    customers = state.site.customers
    rank = np.array([list(tiers).index(tier) for tier in customers.tier], dtype=int)
    per_kw = state.worth / np.maximum(state.load_kw, 1e-9)
    return np.lexsort((-per_kw, rank))


def best_subset(weights: Floats, loads_kw: Floats, capacity_kw: float) -> Flags:
    """The subset of largest weight that fits a capacity: branch and bound on the knapsack.

    Examples
    --------
    >>> best_subset(np.array([1.0, 1.0, 1.5]), np.array([3.0, 4.0, 5.0]), 7.0)
    array([ True,  True, False])
    """
    order = np.argsort(-weights / np.maximum(loads_kw, 1e-9), kind="stable")
    w = weights[order]
    load = loads_kw[order]
    unit = weight_grid(weights)
    best_value = -1.0
    best_set = np.zeros(len(w), dtype=bool)
    stack = [(0, capacity_kw + ROUNDING_KW, 0.0, np.zeros(len(w), dtype=bool))]
    for _ in range(SEARCH_NODES):
        if not stack:
            break
        i, left_kw, value, chosen = stack.pop()
        if value > best_value:
            best_value = value
            best_set = chosen
        if i == len(w) or _bound(w[i:], load[i:], left_kw, value, unit) <= best_value + 1e-9:
            continue
        stack.append((i + 1, left_kw, value, chosen))
        if load[i] <= left_kw:
            taken = chosen.copy()
            taken[i] = True
            stack.append((i + 1, left_kw - load[i], value + w[i], taken))
    result = np.zeros(len(w), dtype=bool)
    result[order] = best_set
    return result


def _bound(weights: Floats, loads_kw: Floats, left_kw: float, value: float, unit: float) -> float:
    """Value with the first item that does not fit taken in part, rounded down to the unit."""
    taken_kw = np.concatenate([[0.0], np.cumsum(loads_kw)])
    share = np.clip((left_kw - taken_kw[:-1]) / np.maximum(loads_kw, 1e-9), 0.0, 1.0)
    bound = value + float(weights @ share)
    return unit * np.floor(bound / unit + 1e-9) if unit else bound


def carry(state: StepState, served: Flags, battery_kw: Floats) -> Carried | None:
    """Dispatch of a supply schedule with batteries near what is wanted of them.

    ``battery_kw`` is wanted for charging, negative to discharge, and moved as far as the balance
    needs.

    Returns
    -------
    Carried or None
        None if PV, batteries and grid cannot carry the demand.
    """
    own = state.own_kw(served)
    demand_kw = float(state.load_kw @ served + state.drawn_kw.sum()) + state.flexible_kw
    need_kw = float(demand_kw - state.usable_pv_kw.sum())
    wanted = np.clip(battery_kw, -state.discharge_max_kw, state.charge_max_kw)
    battery, left_kw = _closing_power_kw(state, wanted, need_kw)
    if left_kw > POWER_TOLERANCE_KW:
        return None
    curtailed = in_proportion(max(-left_kw, 0.0), state.usable_pv_kw - own)
    export = state.usable_pv_kw - own - curtailed
    grid_kw = need_kw + float(battery.sum() + curtailed.sum())
    exported_kw = min(max(-grid_kw, 0.0), state.export_limit_kw)
    battery = _without_circle(battery, float(demand_kw - own.sum()) + exported_kw)
    grid_kw = max(need_kw + float(battery.sum() + curtailed.sum()), 0.0 - exported_kw)
    carried = _with_network(state, served, (own, export), battery, grid_kw)
    return replace(carried, surplus_kw=max(-left_kw, 0.0) - float(curtailed.sum()))


def _closing_power_kw(state: StepState, wanted_kw: Floats, need_kw: float) -> tuple[Floats, float]:
    """Battery power that closes the balance, and what it leaves: short if positive, else surplus.

    Import and export take what they can first. Then a shortage ends charging before it discharges
    more, and a surplus ends discharging before it charges more.
    """
    battery = wanted_kw
    short_kw = need_kw + float(battery.sum()) - state.grid_limit_kw
    for lowest in (np.minimum(battery, 0.0), -state.discharge_max_kw):
        step = in_proportion(max(short_kw, 0.0), battery - lowest)
        battery = battery - step
        short_kw = short_kw - float(step.sum())
    surplus_kw = -(need_kw + float(battery.sum())) - state.export_limit_kw
    for highest in (np.maximum(battery, 0.0), state.charge_max_kw):
        step = in_proportion(max(surplus_kw, 0.0), highest - battery)
        battery = battery + step
        surplus_kw = surplus_kw - float(step.sum())
    return battery, short_kw if short_kw > 0 else -max(surplus_kw, 0.0)


def _without_circle(battery_kw: Floats, demand_kw: float) -> Floats:
    """Cancel charging of one battery from another: no more is discharged than customers take."""
    charge = np.maximum(battery_kw, 0.0)
    discharge = np.maximum(-battery_kw, 0.0)
    # Beside sets that give more than customers take, the demand is negative.
    excess_kw = max(float(discharge.sum()) - max(demand_kw, 0.0), 0.0)
    return (
        charge
        - in_proportion(excess_kw, charge)
        - (discharge - in_proportion(excess_kw, discharge))
    )


def _with_network(
    state: StepState,
    served: Flags,
    pv_kw: tuple[Floats, Floats],
    battery_kw: Floats,
    grid_kw: float,
) -> Carried:
    """Add reactive power, flows and voltages to the active powers."""
    site = state.site
    (own, export) = pv_kw
    load_kvar = state.load_kw * served * site.customers.q_per_p
    pv_q, batt_q, missing_kvar = _reactive(state, load_kvar, own + export, battery_kw)
    given_kvar, short_kvar = {}, abs(missing_kvar)
    running = {
        kind: holds & state.running.get(kind, False) for kind, holds in state.holders.items()
    }
    for kind, gives in (running | state.formers).items():
        most_kvar = state.now.ahead.by_kind[kind].q_most_kvar()[0] * gives
        given_kvar[kind] = np.clip(missing_kvar, -most_kvar, most_kvar)
        short_kvar -= float(np.abs(given_kvar[kind]).sum())
    pv = own, export, pv_q
    carried = dispatch_of(state, served, pv, battery_kw, batt_q, grid_kw, given_kvar)
    net = state.site.network
    lowest, highest = state.v_limits_pu(net.v_min_ac_pu, net.v_max_ac_pu)
    v_pu = carried.v_pu[0]
    outside = np.maximum(v_pu - highest, lowest - v_pu)[1:]
    return replace(
        carried,
        reactive_short_kvar=max(short_kvar, 0.0),
        voltage_excess_pu=max(float(outside.max()), 0.0),
    )


def _reactive(
    state: StepState, load_kvar: Floats, pv_kw: Floats, battery_kw: Floats
) -> tuple[Floats, Floats, float]:
    """Reactive power of PV and batteries, and what an island lacks, negative if it has too much.

    Inverters supply the demand at their own bus. In an island the rest is shared by what is left of
    their ratings; with a grid it is imported.
    """
    site = state.site
    n_pv = len(pv_kw)
    ratings = np.concatenate([site.pv.s_max_kva, site.batteries.s_max_kva * state.online])
    room = np.sqrt(np.maximum(ratings**2 - np.concatenate([pv_kw, battery_kw]) ** 2, 0.0))
    bus = np.concatenate(
        [
            site.pv_bus.T @ np.arange(site.network.n_buses),
            site.battery_bus.T @ np.arange(site.network.n_buses),
        ]
    ).astype(int)
    demand = site.customer_bus @ load_kvar + state.drawn_kvar
    at_bus = np.bincount(bus, room, site.network.n_buses)
    share = np.divide(demand, at_bus, out=np.zeros_like(demand), where=at_bus > 0)
    q = room * np.clip(share, -1.0, 1.0)[bus]
    left_kvar = 0.0
    if state.island:
        missing = float(demand.sum() - q.sum())
        missing = 0.0 if -POWER_TOLERANCE_KW < missing < 0.0 else missing
        more = in_proportion(abs(missing), room - np.copysign(q, q * missing))
        q = q + np.copysign(more, missing)
        left_kvar = float(np.copysign(abs(missing) - float(more.sum()), missing))
    return q[:n_pv], q[n_pv:], left_kvar
