"""A reason for every action: customers not served, battery moves, curtailed PV power.

The order of the questions is that of the definitions in docs/explanations.md.
"""

from __future__ import annotations

import numpy as np

from vppres.explain.prices import WORTH
from vppres.explain.recorded import MOVE_KW
from vppres.explain.step import Binding, Reason, Scarce, Step
from vppres.explain.words import SCARCE, figure, money, one_more, pounds, stored_worth_gbp

OFF_PRICE = 0.02
"""Share by which the price of power at a bus must differ from the slack bus's before a voltage
limit, not the import price, is what drove a battery there."""

RULES = ("idle", "reserve")
"""Controllers that follow a rule, whatever would be worth more."""

UNEXPLAINED = Reason("unexplained", "", "Not served: neither shadow prices nor the record say why.")


def why_not_served(step: Step, customer: int) -> Reason:
    """Why a customer was not served in a step."""
    overruled = _overruled(step, "Not served")
    if overruled is not None:
        return overruled
    if step.recorded.shed[step.t][customer]:
        why = (
            step.recorded.note(step.t, "ac_failed")
            or "the batteries that hold the island could not carry it"
        )
        return Reason(
            "mismatch", "power", f"Not served: it was to be served, and was cut off ({why})."
        )
    if _own_inverter_too_small(step, customer):
        return Reason(
            "inverter",
            "inverter",
            "Not served: its own PV inverter cannot pass the "
            "power that its demand would take from it.",
        )
    if step.service is None:
        return _from_the_record(step)
    gain = float(step.service.service[customer])
    binding = step.scarce_for(customer)
    if step.recorded.rules and gain > WORTH:
        return Reason(
            "switching_rule",
            binding,
            "Not served: a switching rule keeps it off; "
            f"serving it would be worth {figure(gain)} weighted customer hours.",
        )
    if step.recorded.options["controller"] in RULES and gain > WORTH:
        return Reason(
            "rule",
            binding,
            "Not served: the rule of the controller "
            f"{step.recorded.options['controller']} leaves it out; serving it would be "
            f"worth {figure(gain)} weighted customer hours.",
        )
    if not binding:
        return _nothing_scarce(step)
    if gain < -WORTH:
        return _outranked(step, customer, binding, gain)
    return Reason(
        binding,
        binding,
        _sentence(
            f"Not served: {SCARCE[binding]} does not reach for it as a whole",
            one_more(step, binding),
        ),
    )


def _outranked(step: Step, customer: int, binding: Scarce, gain: float) -> Reason:
    """A customer whose supply is worth more to others, in this step or kept for later ones."""
    rationed = _rationed(step, customer, binding)
    if rationed is not None:
        return rationed
    weight = float(step.site.customers.weight[customer]) * step.site.dt_h
    compare = (
        f"its supply is worth {figure(weight - gain)} weighted customer hours to others, "
        f"itself it counts {figure(weight)}"
    )
    if _someone_ranks_higher(step, customer):
        return Reason(
            "priority",
            binding,
            _sentence(
                f"Not served: {SCARCE[binding]} goes to customers who count more per kW; {compare}",
                one_more(step, binding),
            ),
        )
    return Reason(
        binding,
        binding,
        _sentence(
            f"Not served: {SCARCE[binding]} is worth more elsewhere or later; {compare}",
            one_more(step, binding),
        ),
    )


def _rationed(step: Step, customer: int, binding: Scarce) -> Reason | None:
    """A customer whose energy is kept for what is believed to come; None where it is not."""
    later = step.later_worth_gbp
    now = step.worth_gbp_per_kwh(customer)
    if later is None or now is None or binding != "energy" or later <= now:
        return None
    return Reason(
        "energy",
        "energy",
        f"Not served, rationed: one more kWh in store is worth {pounds(later)} GBP later, "
        f"{pounds(now)} GBP to it now.",
    )


def _someone_ranks_higher(step: Step, customer: int) -> bool:
    """Whether a customer with more weight per kW is served in the step."""
    per_kw = step.site.customers.weight / np.maximum(step.load_kw, 1e-9)
    return bool((per_kw[step.served] > per_kw[customer]).any())


def _own_inverter_too_small(step: Step, customer: int) -> bool:
    """Self-consumption is an equality: an owner needs an inverter that passes it."""
    owned = (step.site.owner == customer) & ~step.site.alone
    own_kw = np.minimum(step.load_kw[customer], step.scenario.pv_kw[step.t][owned])
    return bool((own_kw > step.site.pv.s_max_kva[owned] + 1e-9).any())


def _nothing_scarce(step: Step) -> Reason:
    """The window itself would have served the customer."""
    if step.recorded.note(step.t, "status") == "planned":
        return Reason(
            "plan",
            "",
            "Not served: the plan of the day, made with the forecast of its "
            "beginning, leaves it out, and no check of the plan failed.",
        )
    return _from_the_record(step) if step.outage else UNEXPLAINED


def _from_the_record(step: Step) -> Reason:
    """Without shadow prices: what the record itself shows to be at its limit."""
    limits = step.limits
    found: tuple[tuple[bool, Scarce], ...] = (
        (len(limits.empty) > 0 and bool(limits.empty.all()), "energy"),
        (bool(limits.at_power.any()), "power"),
        (bool(limits.at_inverter.any()), "inverter"),
        (bool(limits.low_voltage.any()), "voltage"),
    )
    for reached, binding in found:
        if reached:
            return Reason(
                binding,
                binding,
                f"Not served: {SCARCE[binding]} was used up, as the "
                "record shows; the shadow prices of this step do not tell.",
            )
    return UNEXPLAINED


def why_battery_moved(step: Step, battery: int) -> Reason:
    """Why a battery charged or discharged in a step."""
    power = float(step.battery_kw[battery])
    verb = "Charges" if power > 0 else "Discharges"
    overruled = _overruled(step, verb)
    if overruled is not None:
        return overruled
    mismatch = float(step.recorded.battery_note(step.t, "mismatch_kw")[battery])
    if abs(mismatch) > abs(power) / 2:
        return Reason(
            "mismatch",
            "",
            f"{verb}: it takes up losses and forecast errors of the "
            f"island, {figure(abs(mismatch))} kW, as a battery that holds the voltage.",
        )
    if step.outage:
        in_island = _charge_in_island if power > 0 else _discharge_in_island
        return in_island(step, battery)
    return _move_with_grid(step, battery, verb)


def _charge_in_island(step: Step, battery: int) -> Reason:
    return Reason(
        "surplus",
        _at_limit(step, battery),
        f"Charges: {step.site.pv.word} gives more than the served customers take.",
    )


def _discharge_in_island(step: Step, battery: int) -> Reason:
    """What limits a discharge is its driver; where nothing does, it simply carries the service."""
    if step.service is None:
        return Reason(
            "supply", _at_limit(step, battery), "Discharges: it carries served customers."
        )
    limit = _at_limit(step, battery)
    if limit in ("power", "inverter"):
        return Reason(
            limit,
            limit,
            _sentence(f"Discharges as much as {SCARCE[limit]} admits", one_more(step, limit)),
        )
    worth = float(step.service.kept_energy[battery])
    if worth > WORTH:
        return Reason(
            "energy",
            "energy",
            "Discharges what the customers served in this step are "
            f"worth; a kWh kept serves {figure(worth)} weighted customer hours later.",
        )
    return Reason("supply", "", "Discharges: it carries served customers, and nothing is scarce.")


def _move_with_grid(step: Step, battery: int, verb: str) -> Reason:
    """Preparation, a voltage limit, surplus or the price."""
    limit = _at_limit(step, battery)
    charges = verb == "Charges"
    if _voltage_decides(step, battery):
        return Reason("voltage", "voltage", f"{verb}: it holds the voltage limit.")
    if charges and step.recorded.imported_kw(step.t) < MOVE_KW:
        return Reason(
            "surplus",
            limit,
            f"Charges: {step.site.pv.word} gives more than the demand, and {_taken(step)}.",
        )
    worth = step.later_worth_gbp
    if worth is None:
        worth = stored_worth_gbp(step, battery)
    saves = "" if worth is None else f"; a kWh in store is worth {money(worth)} GBP later"
    at_price = f"at {money(step.price_gbp_per_kwh)} GBP/kWh"
    if not charges and step.export_kw > MOVE_KW:
        earned = f"{money(step.export_price_gbp_per_kwh)} GBP/kWh"
        return Reason("price", limit, f"Discharges: what the feeder exports earns {earned}{saves}.")
    if charges and step.later_worth_gbp is not None and step.later_worth_gbp > step.dearest_gbp:
        words = f"Charges for an outage that may come {at_price}{saves}."
        return Reason("preparation", limit, words)
    if charges and step.phase == "preparation" and step.later_worth_gbp is None:
        return Reason("preparation", limit, f"Charges for the outage {at_price}{saves}.")
    return Reason("price", limit, f"{verb} {at_price}{saves}.")


def _voltage_decides(step: Step, battery: int) -> bool:
    """Whether a voltage limit binds and makes the battery's move worth more at its own bus."""
    prices = step.service if step.scarce == "voltage" else step.cost
    if prices is None:
        return False
    bound = max(prices.voltage_floor.max(initial=0.0), prices.voltage_ceiling.max(initial=0.0))
    base = float(prices.active[0])
    above = float((step.site.battery_bus.T @ prices.active)[battery]) - base
    # A discharge helps where power is worth more than at the slack bus, a charge where less.
    helps = above * -np.sign(step.battery_kw[battery])
    return bound > WORTH and bool(helps > OFF_PRICE * max(abs(base), WORTH))


def _at_limit(step: Step, battery: int) -> Binding:
    """The limit that a battery reached in the step, empty if none."""
    b = step.site.batteries
    soc_end = float(step.recorded.soc_end[step.t][battery])
    if step.limits.at_power[battery]:
        return "power"
    if step.limits.at_inverter[battery]:
        return "inverter"
    edge = b.soc_max[battery] if step.battery_kw[battery] > 0 else b.soc_min[battery]
    return "energy" if abs(soc_end - edge) < 1e-3 else ""


def why_curtailed(step: Step, system: int) -> Reason:
    """Why a PV system was curtailed in a step."""
    overruled = _overruled(step, "Curtailed")
    if overruled is not None:
        return overruled
    pv = step.site.pv
    available = float(step.scenario.pv_kw[step.t][system])
    if available > pv.s_max_kva[system] + MOVE_KW:
        return Reason(
            "inverter",
            "inverter",
            "Curtailed: its inverter passes no more than "
            f"{figure(float(pv.s_max_kva[system]))} kVA.",
        )
    prices = step.service or step.cost
    if prices is not None and prices.voltage_ceiling.max(initial=0.0) > WORTH:
        return Reason("voltage", "voltage", "Curtailed: the upper voltage limit is reached.")
    if step.at_export_limit:
        most = figure(float(step.scenario.export_max_kw[step.t]))
        return Reason("grid", "grid", f"Curtailed: the export limit of {most} kW is reached.")
    full = len(step.site.batteries) > 0 and bool(
        (step.recorded.soc_end[step.t] >= step.site.batteries.soc_max - 1e-3).all()
    )
    where: Binding = "energy" if full else "power"
    rest = "the batteries are full" if full else "the batteries can take no more in this step"
    return Reason(
        "surplus",
        where,
        f"Curtailed: {pv.word} gives more than the served customers take, {rest}, "
        f"and {_taken(step)}.",
    )


def _taken(step: Step) -> str:
    """What the grid takes of a surplus, in words."""
    if step.export_kw > MOVE_KW:
        return f"the grid takes {figure(step.export_kw)} kW"
    return "nothing is exported" if _could_export(step) else "nothing can be exported"


def _could_export(step: Step) -> bool:
    return float(step.scenario.export_max_kw[step.t]) > 0.0


def _overruled(step: Step, what: str) -> Reason | None:
    """What stands above every optimisation: a dark island, or a fallback."""
    if step.dark:
        return Reason("dark", "", f"{what}: the island is dark, {step.dark}.")
    if step.fallback:
        return Reason(
            "fallback", "", f"{what}: the step was decided by a fallback ({step.fallback})."
        )
    return None


def _sentence(*parts: str) -> str:
    """Parts joined by semicolons, with a full stop."""
    return "; ".join(part for part in parts if part) + "."
