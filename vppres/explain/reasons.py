"""A reason for every action: customers off supply, battery moves, curtailed PV power.

The order of the questions is that of the definitions in docs/explanations.md.
"""

from __future__ import annotations

import numpy as np

from vppres.core.text import named
from vppres.day.options import RULES
from vppres.day.recorder import OFF_BY_FAULT
from vppres.explain.costs import WORTH
from vppres.explain.kept import kept_for
from vppres.explain.reason import DRIVERS, Binding, Reason, Scarce
from vppres.explain.room import limits_in_full, overloaded_line, overloaded_phase
from vppres.explain.step import Step
from vppres.explain.words import (
    SCARCE,
    figure,
    hours_of,
    line_name,
    line_words,
    money,
    one_more,
    phase_name,
    pounds,
    scarce_name,
    service_words,
    stored_worth_gbp,
    too_little,
)
from vppres.kinds.export import reasons as export
from vppres.kinds.kind import MOVE_KW
from vppres.scenario.network import BusId

OFF_PRICE = 0.02
"""Share by which the price of power at a bus must differ from the slack bus's before a voltage
limit, not the import price, is what drove a battery there."""

NAMES_SHOWN = 3
"""Customers named in one reason."""

FIRST = {True: "customers with more weight per kW", False: "others first in strict order"}
"""The customer that a scarce unit goes to, where customers are weighed and in strict order."""

UNEXPLAINED = Reason(
    "unexplained", "", "Not supplied: neither shadow prices nor the record give a reason."
)

LATE = Reason(
    "unexplained",
    "",
    "Not supplied: no shadow prices were found in time, and the record gives no reason.",
)


def why_not_served(step: Step, customer: int) -> Reason:
    """Why a customer was off supply in a step."""
    said = overruled(step, "Not supplied")
    if said is not None:
        return said
    fault = step.of_items("customers", OFF_BY_FAULT, "")[customer]
    if fault:
        return Reason("fault", "", f"Not supplied: {fault}.")
    if step.of_items("customers", "shed")[customer]:
        why = (
            step.recorded.note(step.t, "ac_failed")
            or "the grid-forming batteries could not supply it"
        )
        return Reason("mismatch", "power", f"Shed: planned as supplied, then disconnected ({why}).")
    if _own_inverter_too_small(step, customer):
        return Reason(
            "inverter",
            "inverter",
            "Not supplied: its own PV inverter is too small for the PV power that its "
            "demand would use.",
        )
    line = step.recorded.behind(step.t, _bus_of(step, customer))
    if line:
        words = f"Not supplied: the part behind {line}, has too little power or energy."
        return Reason("fault", "", words)
    if step.service is None:
        return _from_the_record(step, customer)
    gain = float(step.service.service[customer])
    demand_kwh = float(step.load_kw[customer]) * step.site.dt_h
    binding = step.supply_cost.scarcest(customer)
    if step.recorded.rules and gain > WORTH:
        return Reason(
            "switching_rule",
            binding,
            "Not supplied: a switching rule keeps it off; "
            f"supplying it would be worth {service_words(step, gain, demand_kwh)}.",
        )
    if step.recorded.options["controller"] in RULES and gain > WORTH:
        return Reason(
            "rule",
            binding,
            f"Not supplied: the fixed rule of controller {step.recorded.options['controller']} "
            f"leaves it off; supplying it would be worth {service_words(step, gain, demand_kwh)}.",
        )
    restored = np.flatnonzero(step.ended & step.served)
    if binding and gain > WORTH and len(restored):
        names = named(step.site.customers.id[restored].tolist(), NAMES_SHOWN)
        scarce = scarce_name(step, binding)
        words = f"Not supplied: {scarce} goes to {names}, whose longest time off ends."
        return Reason("longest_off", binding, words)
    if not binding:
        return _nothing_scarce(step, customer)
    if gain < -WORTH:
        return _outranked(step, customer, binding, gain)
    too_little = _too_little(step, customer, binding)
    return Reason(
        binding,
        binding,
        _sentence(f"Not supplied: {too_little}", _one_more_for(step, customer, binding)),
    )


def _too_little(step: Step, customer: int, binding: Scarce) -> str:
    """Name of what there is not enough of."""
    demand_kw = figure(float(step.load_kw[customer]))
    limits = limits_in_full(step, customer, binding)
    if len(limits) > 1:
        *names, last = (scarce_words(step, customer, limit) for limit in limits)
        return f"{', '.join(names)} and {last} do not allow its full demand of {demand_kw} kW"
    which = _which_for(step, customer, binding)
    if which is None:
        kept = kept_for(step, customer) if binding == "energy" else ""
        return f"{too_little(step, binding)}{f': it is {kept}' if kept else ''}"
    if binding == "phase":
        return f"{phase_name(step, which)} would be overloaded by its {demand_kw} kW"
    return f"{line_words(step, which)} does not carry its {demand_kw} kW in full"


def scarce_words(step: Step, customer: int, binding: Scarce) -> str:
    """Name of what is scarce for a customer."""
    which = _which_for(step, customer, binding)
    if which is None:
        return scarce_name(step, binding)
    named_in = phase_name if binding == "phase" else line_name
    return f"the rating of {named_in(step, which)}"


def _one_more_for(step: Step, customer: int, binding: Scarce) -> str:
    """The value of one more unit of what limits a customer."""
    return one_more(step, binding, _which_for(step, customer, binding))


def _which_for(step: Step, customer: int, binding: Scarce) -> int | None:
    """The line or the former's phase whose rating limits a customer; None if another limit does."""
    if binding == "phase":
        phase = overloaded_phase(step, customer)
        return step.supply_cost.full_phase(customer) if phase is None else phase
    if binding != "rating":
        return None
    line = overloaded_line(step, customer)
    return step.full_line(_bus_of(step, customer)) if line is None else line


def _bus_of(step: Step, customer: int) -> str:
    return step.scenario.customers.bus[customer]  # type: ignore[no-any-return]


def _outranked(step: Step, customer: int, binding: Scarce, gain: float) -> Reason:
    """A customer whose energy has more value for others, in this step or later."""
    rationed = _rationed(step, customer, binding)
    if rationed is not None:
        return rationed
    weight = float(step.site.customers.weight[customer]) * step.site.dt_h
    ranks = step.site.ranks
    own = figure(weight) if ranks is None else hours_of(weight, ranks, int(ranks.tier[customer]))
    demand_kwh = float(step.load_kw[customer]) * step.site.dt_h
    lost = service_words(step, weight - gain, demand_kwh)
    compare = f"if it were supplied, others would lose {lost} and it would gain {own}"
    is_outranked = someone_ranks_higher(step, customer)
    kept = kept_for(step, customer) if binding == "energy" else ""
    if kept:
        where = f"is {kept}"
    elif is_outranked:
        where = f"goes to {FIRST[ranks is None]}"
    else:
        where = "has more value elsewhere or later"
    return Reason(
        "priority" if is_outranked else binding,
        binding,
        _sentence(
            f"Not supplied: {scarce_words(step, customer, binding)} {where}; {compare}",
            _one_more_for(step, customer, binding),
        ),
    )


def _rationed(step: Step, customer: int, binding: Scarce) -> Reason | None:
    """A customer whose energy is saved for a forecast outage; None if it is not."""
    later, value = step.later_worth_gbp, step.levels.window.stored_value
    if later is None or value is None or binding != "energy":
        return None
    weight = float(step.site.customers.weight[customer])
    per_kw = weight / max(float(step.load_kw[customer]), 1e-9)
    now = value.gbp_per_service * per_kw * float(step.site.batteries.eta_discharge.mean())
    if later <= now:
        return None
    return Reason(
        "energy",
        "energy",
        f"Not supplied: energy saved for later; 1 kWh is worth {pounds(later)} later, "
        f"{pounds(now)} to this customer now.",
    )


def someone_ranks_higher(step: Step, customer: int) -> bool:
    """Whether a customer with more weight per kW is supplied in the step."""
    per_kw = step.site.customers.weight / np.maximum(step.load_kw, 1e-9)
    return bool((per_kw[step.served] > per_kw[customer]).any())


def _own_inverter_too_small(step: Step, customer: int) -> bool:
    """Self-consumption is an equality: the owner needs an inverter of that size."""
    owned = (step.site.owner == customer) & ~step.site.alone
    own_kw = np.minimum(step.load_kw[customer], step.scenario.pv_kw[step.t][owned])
    return bool((own_kw > step.site.pv.s_max_kva[owned] + 1e-9).any())


def _nothing_scarce(step: Step, customer: int) -> Reason:
    """The window itself would have supplied the customer."""
    if step.recorded.note(step.t, "status") == "planned":
        return Reason(
            "plan",
            "",
            "Not supplied: the day plan, made with the forecast at the start of the day, leaves it "
            "off; no check of the plan failed.",
        )
    return _from_the_record(step, customer)


def _from_the_record(step: Step, customer: int) -> Reason:
    """Without shadow prices: what the record itself shows to be at its limit.

    With grid, batteries are not what keeps a customer off.
    """
    line = step.full_line(_bus_of(step, customer))
    if line is not None:
        words = f"Not supplied: {line_words(step, line)} is at its limit in the record."
        return Reason("rating", "rating", words)
    phase = overloaded_phase(step, customer)
    if phase is not None:
        words = f"Not supplied: {phase_name(step, phase)} would be overloaded."
        return Reason("phase", "phase", words)
    empty = step.soc_end <= step.site.batteries.soc_min + 1e-3
    low = step.recorded.done.v_pu[step.t] <= step.scenario.network.v_min_pu + 2e-3
    found: tuple[tuple[bool, Scarce], ...] = (
        (step.outage and len(empty) > 0 and bool(empty.all()), "energy"),
        (step.outage and bool(step.spare.at_power.any()), "power"),
        (step.outage and bool(step.spare.at_inverter.any()), "inverter"),
        (bool(low.any()), "voltage"),
    )
    late = step.levels.late
    lacking = (
        "no shadow prices were found in time" if late else "this step has no shadow price for it"
    )
    for reached, binding in found:
        if reached:
            words = f"Not supplied: limit reached in the record: {DRIVERS[binding]}; {lacking}."
            return Reason(binding, binding, words)
    return LATE if late else UNEXPLAINED


def why_battery_moved(step: Step, battery: int) -> Reason:
    """Why a battery charged or discharged in a step."""
    power = float(step.battery_kw[battery])
    verb = "Charges" if power > 0 else "Discharges"
    said = overruled(step, verb)
    if said is not None:
        return said
    mismatch = float(np.nan_to_num(step.of_items("batteries", "mismatch_kw"))[battery])
    if abs(mismatch) > abs(power) / 2:
        return Reason(
            "mismatch",
            "",
            f"{verb}: balances {figure(abs(mismatch))} kW of losses and forecast error as a "
            "grid-forming battery.",
        )
    if step.outage or step.recorded.behind(step.t, step.scenario.batteries.bus[battery]):
        in_island = _charge_in_island if power > 0 else _discharge_in_island
        return in_island(step, battery)
    return _move_with_grid(step, battery, verb)


def _charge_in_island(step: Step, battery: int) -> Reason:
    return Reason(
        "surplus",
        _at_limit(step, battery),
        f"Charges: {step.site.pv.word} exceeds the supplied demand.",
    )


def _discharge_in_island(step: Step, battery: int) -> Reason:
    """The limit of a discharge is its driver; if none binds, it supplies customers."""
    if step.service is None:
        return Reason("supply", _at_limit(step, battery), "Discharges: supplies customers.")
    limit = _at_limit(step, battery)
    if limit in ("power", "inverter"):
        words = f"Discharges as much as {SCARCE[limit]} allows"
        if limit == "inverter":  # reactive power may leave little of it
            kvar = abs(float(step.recorded.done.batt_q_kvar[step.t][battery]))
            words = f"{words} beside {figure(kvar)} kvar"
        return Reason(limit, limit, _sentence(words, one_more(step, limit, battery)))
    worth = float(step.service.kept_energy[battery])
    if limit == "energy" and not _off_later(step):
        words = "Discharges: supplies customers with all that it may give"
        return Reason(limit, limit, _sentence(words, one_more(step, limit)))
    if worth > WORTH and _off_later(step):
        return Reason(
            "energy",
            "energy",
            "Discharges: supplies customers; a kWh kept for later would be worth "
            f"{service_words(step, worth)}.",
        )
    phase = _relieved_phase(step, battery)
    if phase is not None:
        return Reason("phase", "phase", f"Discharges: relieves {phase_name(step, phase)}.")
    return Reason("supply", "", "Discharges: supplies customers; no limit binds.")


def _off_later(step: Step) -> bool:
    """Whether a customer goes without full supply in a later step of the window."""
    later, done = slice(step.t + 1, step.t + step.levels.window.n_steps), step.recorded.done
    return bool((done.supplied[later] * done.served[later] < 1.0).any())


def _relieved_phase(step: Step, battery: int) -> int | None:
    """The former's phase that a battery's discharge is worth most on; None if it is none."""
    phases = None if step.service is None else step.service.phases
    if phases is None:
        return None
    asset = _asset_index(step, battery)
    if asset in step.phased.model.devices(step.phased.source):
        return None
    cost = phases.active[:, asset]
    return int(np.argmax(cost)) if cost.max() > WORTH else None


def _asset_index(step: Step, battery: int) -> int:
    """Place of a battery among the assets of a phased feeder."""
    return len(step.site.customers) + len(step.site.pv) + battery


def _move_with_grid(step: Step, battery: int, verb: str) -> Reason:
    """Preparation, a voltage limit, surplus or the price."""
    limit = _at_limit(step, battery)
    charges = verb == "Charges"
    if _voltage_decides(step, battery):
        return Reason("voltage", "voltage", f"{verb}: keeps the voltage within its limit.")
    line = _relieved_line(step, battery)
    if line is not None:
        words = f"{verb}: keeps {line_words(step, line)} within its limit."
        return Reason("rating", "rating", words)
    if charges and step.imported_kw < MOVE_KW:
        return Reason(
            "surplus",
            limit,
            f"Charges: {step.site.pv.word} exceeds demand, and {export.surplus_words(step)}.",
        )
    worth = step.later_worth_gbp
    if worth is None:
        worth = stored_worth_gbp(step, battery)
    saves = "" if worth is None else f"; a stored kWh is worth {money(worth)} later"
    at_price = f"at {money(step.price_gbp_per_kwh)}/kWh"
    if not charges and (earned := export.earned(step)):
        return Reason("price", limit, f"Discharges: {earned}{saves}.")
    if charges and step.later_worth_gbp is not None and step.later_worth_gbp > step.dearest_gbp:
        words = f"Charges for a possible outage {at_price}{saves}."
        return Reason("preparation", limit, words)
    if charges and step.phase == "preparation" and step.later_worth_gbp is None:
        return Reason("preparation", limit, f"Charges for the outage {at_price}{saves}.")
    return Reason("price", limit, f"{verb} {at_price}{saves}.")


def _voltage_decides(step: Step, battery: int) -> bool:
    """Whether a voltage limit binds and makes the battery's move worth more at its own bus."""
    prices = step.service if step.supply_cost.scarcest_of_all == "voltage" else step.cost
    if prices is None:
        return False
    bound = max(prices.voltage_floor.max(initial=0.0), prices.voltage_ceiling.max(initial=0.0))
    base = float(prices.active[0])
    if prices.phases is None:
        by_voltage = prices.active - prices.line_active
        above = float((step.site.battery_bus.T @ by_voltage)[battery]) - base
    else:
        above = float(prices.phases.by_voltage[_asset_index(step, battery)])
    # A discharge helps where power is worth more than at the slack bus, a charge where less.
    helps = above * -np.sign(step.battery_kw[battery])
    return bound > WORTH and bool(helps > OFF_PRICE * max(abs(base), WORTH))


def _relieved_line(step: Step, battery: int) -> int | None:
    """A line at its rating that the battery's move relieves; None if there is none."""
    prices = step.service if step.supply_cost.scarcest_of_all == "rating" else step.cost
    if prices is None:
        return None
    if prices.phases is None:
        worth = float((step.site.battery_bus.T @ prices.line_active)[battery])
    else:
        batteries = prices.phases.rated_active[:, len(step.site.customers) + len(step.site.pv) :]
        worth = float(batteries.sum(axis=0)[battery])
    helps = worth * -np.sign(step.battery_kw[battery])
    if helps <= OFF_PRICE * max(abs(float(prices.active[0])), WORTH):
        return None
    return step.full_line(step.scenario.batteries.bus[battery])


def _at_limit(step: Step, battery: int) -> Binding:
    """The limit that a battery reached in the step, empty if none."""
    b = step.site.batteries
    soc_end = float(step.soc_end[battery])
    if step.spare.at_power[battery]:
        return "power"
    if step.spare.at_inverter[battery]:
        return "inverter"
    edge = b.soc_max[battery] if step.battery_kw[battery] > 0 else b.soc_min[battery]
    return "energy" if abs(soc_end - edge) < 1e-3 else ""


def why_curtailed(step: Step, system: int) -> Reason:
    """Why a PV system was curtailed in a step."""
    said = overruled(step, "Curtailed")
    if said is not None:
        return said
    pv = step.site.pv
    available = float(step.scenario.pv_kw[step.t][system])
    if available > pv.s_max_kva[system] + MOVE_KW:
        return Reason(
            "inverter",
            "inverter",
            f"Curtailed: its inverter is limited to {figure(float(pv.s_max_kva[system]))} kVA.",
        )
    prices = step.service or step.cost
    if prices is not None and prices.voltage_ceiling.max(initial=0.0) > WORTH:
        return Reason("voltage", "voltage", "Curtailed: the voltage is at its upper limit.")
    bus = step.scenario.pv.buses(step.scenario.customers)[system]
    line = step.full_line(bus)
    if line is not None:
        words = f"Curtailed: {line_words(step, line)} is at its limit."
        return Reason("rating", "rating", words)
    if limited := export.at_limit(step):
        return limited
    where, rest = _no_more_stored(step, bus)
    sold = f", and {export.surplus_words(step)}"
    if step.recorded.behind(step.t, bus):
        sold = ""  # the grid takes nothing of a part
    why = f"{pv.word} exceeds the supplied demand, {rest}{sold}"
    return Reason("surplus", where, f"Curtailed: {why}.")


def _no_more_stored(step: Step, bus: BusId) -> tuple[Binding, str]:
    """Why the batteries beside a bus take no more, and the limit that binds; empty for none."""
    there = step.recorded.beside(step.t, bus) & ~step.recorded.left_out(step.t)
    if not there.any():
        return "power", "there is no battery to charge"
    full = step.soc_end >= step.site.batteries.soc_max - 1e-3
    at_limit = full | step.spare.at_power | step.spare.at_inverter
    if full[there].all():
        return "energy", "the batteries are full"
    if at_limit[there].all():
        return "power", "the batteries cannot charge more in this step"
    return "", "more in the batteries has no use in the plan"


def overruled(step: Step, what: str) -> Reason | None:
    """Reason that overrides every optimisation: a blacked-out island, or a fallback."""
    if step.dark:
        return Reason("dark", "", f"{what}: the island is blacked out ({step.dark}).")
    if step.fallback:
        return Reason(
            "fallback", "", f"{what}: the step was decided by a fallback ({step.fallback})."
        )
    return None


def _sentence(*parts: str) -> str:
    """Parts joined by semicolons, with a full stop."""
    return "; ".join(part for part in parts if part) + "."
