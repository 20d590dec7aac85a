"""Which limits leave no room for the whole demand of a customer, beside all else in its step.

Shadow prices are those of a share of a customer. As a whole it may exceed more limits than the one
that is scarce.
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Complexes, Floats
from vppres.explain.costs import WORTH
from vppres.explain.reason import Binding, Scarce
from vppres.explain.step import Step
from vppres.model.data import PhasedWindow
from vppres.model.formulas import lossless_flows, voltage_drop_pu2
from vppres.scenario.formers import bus_of_former, largest_forming_battery
from vppres.scenario.network import BusId


def limits_in_full(step: Step, customer: int, binding: Binding) -> list[Scarce]:
    """Limits that the whole demand of a customer exceeds or has a price in; the scarce one first.

    ``binding`` is what is scarce for a share of the customer, who is off in the step.
    """
    priced = {name for name, cost in step.supply_cost.by_limit.items() if cost[customer] > WORTH}
    needed_kw = _needed_kw(step, customer)
    if step.spare.power_kw < needed_kw:
        priced.add("power")
    if len(step.site.batteries) and step.spare.energy_kwh < needed_kw * step.site.dt_h:
        priced.add("energy")
    if overloaded_line(step, customer) is not None:
        priced.add("rating")
    if overloaded_phase(step, customer) is not None:
        priced.add("phase")
    if _under_voltage(step, customer):
        priced.add("voltage")
    return sorted(priced, key=lambda name: (name != binding, name))


def _needed_kw(step: Step, customer: int) -> float:
    """Demand of a customer with what it adds to the losses, which grow with the square of power.

    Plans of the paper's mode have no losses.
    """
    demand_kw = float(step.load_kw[customer])
    if step.recorded.options.get("mode") != "physical":
        return demand_kw
    now_kw = float(step.load_kw @ (step.share * step.served))
    lost_kw = float(step.recorded.trajectory.steps["losses_kw"].iloc[step.t])
    if now_kw <= demand_kw * WORTH:
        return demand_kw
    return demand_kw + lost_kw * ((1.0 + demand_kw / now_kw) ** 2 - 1.0)


def overloaded_line(step: Step, customer: int) -> int | None:
    """The line that the whole demand of a customer would take furthest beyond its rating.

    Of a phased feeder a phase of it.
    """
    if step.site.phases:
        return _overloaded_current(step, customer)
    most_kva = step.levels.window.flow_max_kva
    if not len(most_kva):
        return None
    now = step.recorded.done.p_flow_kw[step.t] + 1j * step.recorded.done.q_flow_kvar[step.t]
    kw, kvar = _flows_for(step, customer)
    return _furthest(now, now + (kw + 1j * kvar), most_kva[0])


def _overloaded_current(step: Step, customer: int) -> int | None:
    """Current of a phased feeder that a customer's demand would overload most, None if none."""
    phased = step.phased
    if step.dark or not phased.model.rated:
        return None
    now = phased.currents
    more = now + phased.slopes.currents(*phased.alone(customer))[0]
    return _furthest(now, more, np.ones(len(now)))


def overloaded_phase(step: Step, customer: int) -> int | None:
    """The former's phase that all demand of a customer would take furthest beyond its room."""
    window = step.levels.window.phased
    if not window or step.dark:
        return None
    supply = step.phased.supply
    if supply is None or not supply.forms.any():
        return None
    slopes = supply.slopes
    kw, kvar = _demand(step, customer)
    now = step.phased.former_kva
    more = now + slopes.former_p[:, customer] * kw + slopes.former_q[:, customer] * kvar
    room_kva = window.room_kva[0, : len(supply.forms)]
    return _furthest(now, more, np.where(supply.forms, room_kva, np.inf))


def _furthest(now: Complexes, more: Complexes, most: Floats) -> int | None:
    """Which of some flows grows furthest beyond its limit; None if none does."""
    share = np.where(np.abs(more) > np.abs(now), np.abs(more) / most, 0.0)
    return int(np.argmax(share)) if share.max(initial=0.0) > 1.0 else None


def _demand(step: Step, customer: int) -> tuple[float, float]:
    """Demand of a customer in kW and kvar."""
    kw = float(step.load_kw[customer])
    return kw, kw * float(step.site.customers.q_per_p[customer])


def _flows_for(step: Step, customer: int) -> tuple[Floats, Floats]:
    """Flows of the lines that the supply of a customer adds, in kW and kvar, (L,) each.

    It comes from the grid, and in an island from the set or the largest battery that forms it.
    """
    site = step.site
    source = site.network.bus_index[_source_bus(step)]
    place = site.customer_bus[:, [customer]].toarray().ravel()
    place[source] -= 1.0
    demand = _demand(step, customer)
    return tuple(lossless_flows(site.network, -place[None, :] * size)[0] for size in demand)


def _source_bus(step: Step) -> BusId:
    """The bus from which power comes: the grid's, or that of what forms the island."""
    site, forms = step.site, step.recorded.trajectory.forms(step.t)
    former = largest_forming_battery(site) if step.outage else None
    bus = bus_of_former(site, forms)
    if bus is not None:
        return bus
    return site.network.slack_bus if former is None else site.batteries.bus[former]


def _under_voltage(step: Step, customer: int) -> bool:
    """Whether a voltage would fall below what plans allow with the demand of a customer."""
    if step.levels.window.phased:
        return _node_under_voltage(step, step.levels.window.phased, customer)
    kw, kvar = _flows_for(step, customer)
    net = step.site.network
    drop = voltage_drop_pu2(net, kw[None, :], kvar[None, :]) @ net.downstream
    fall = np.asarray(drop)[0]
    held = int(np.argmin(fall)) if step.outage else 0
    before = net.u_pu2(step.recorded.done.v_pu[step.t])
    after = before - (fall - fall[held])
    lowest = step.levels.window.u_limits_pu2(net)[0][0]
    return bool(((after < lowest) & (after < before)).any())


def _node_under_voltage(step: Step, phased: PhasedWindow, customer: int) -> bool:
    """Whether a node of a phased feeder would fall below its least voltage."""
    change = step.phased.slopes.changes(*step.phased.alone(customer))[0][0]
    before = step.recorded.done.v_node_pu
    assert before is not None
    after = before[step.t] ** 2 + change
    limited = step.phased.model.limited
    return bool(((after < phased.u_min[0]) & (change < 0.0) & limited).any())
