"""Reason for a step as a whole, in a sentence."""

from __future__ import annotations

from dataclasses import replace

from vppres.day.trajectory import SWITCHED, SWITCHING_AHEAD, SWITCHING_WHY
from vppres.explain.costs import WORTH
from vppres.explain.kept import why_kept
from vppres.explain.reason import Driver, Reason
from vppres.explain.step import Step
from vppres.explain.words import figure, money, one_more, scarce_name, service_words


def why_step(step: Step) -> Reason:
    """Reason for a step as a whole, and for the energy that it keeps."""
    reason = _main_reason(step)
    kept = "" if step.dark or step.fallback else why_kept(step)
    late = "No shadow prices were found in time." if step.levels.late else ""
    words = [reason.words, late, kept, _switching_words(step)]
    return replace(reason, words=" ".join(filter(None, words)))


def _switching_words(step: Step) -> str:
    """Why switches move now or later, or that none would serve more who is off."""
    moved, ahead, why = (
        step.recorded.note(step.t, name) for name in (SWITCHED, SWITCHING_AHEAD, SWITCHING_WHY)
    )
    if moved:
        return f"{moved[:1].upper()}{moved[1:]}: {why}."
    if ahead:
        return f"Planned ahead: {ahead}; {why}."
    return "" if step.served.all() or not why else f"{why[:1].upper()}{why[1:]}."


def _main_reason(step: Step) -> Reason:
    """Reason for a step as a whole."""
    if step.dark:
        return Reason("dark", "", f"{_headline(step)} The island is blacked out: {step.dark}.")
    if step.fallback:
        return Reason("fallback", "", f"{_headline(step)} Decided by a fallback ({step.fallback}).")
    scarce = step.supply_cost.scarcest_of_all
    if scarce and not step.served.all():
        offer = one_more(step, scarce)
        return Reason(
            scarce,
            scarce,
            f"{_headline(step)} Binding limit: {scarce_name(step, scarce).removeprefix('the ')}"
            f"{f'; {offer}' if offer else ''}.",
        )
    off = ~step.served
    if off.any() and step.recorded.cut_off(step.t)[off].all():
        words = f"{_headline(step)} Lines that are out or open cut off the others."
        return Reason("fault", "", words)
    driver: Driver = "preparation" if step.phase == "preparation" else "price"
    driver = "supply" if step.phase == "island" else driver
    return Reason(driver, scarce, f"{_headline(step)} {_worth_words(step)}".rstrip())


def _headline(step: Step) -> str:
    """How many customers are supplied, and what the batteries do."""
    count = int(step.served.sum())
    total = len(step.served)
    supply = f"{'All' if count == total else f'{count} of {total}'} customers supplied."
    power = float(step.battery_kw.sum())
    if abs(power) < 1.0:
        return f"{supply} Batteries idle."
    verb = "charge" if power > 0 else "discharge"
    return f"{supply} Batteries {verb} at {figure(abs(power))} kW."


def _worth_words(step: Step) -> str:
    """Worth of a stored kWh, if that is known."""
    if step.cost is None or not len(step.cost.kept_energy):
        offer = one_more(step, "energy")
        return f"{offer[:1].upper()}{offer[1:]}." if offer else ""
    # With outage probabilities the plan states the value, and each battery's sentence has it.
    believed = step.later_worth_gbp
    stored = (
        money(float(step.cost.kept_energy.max()))
        if believed is None
        else f"{money(believed)} later"
    )
    worth = (
        f"A stored kWh is worth {stored}; an imported kWh costs {money(step.price_gbp_per_kwh)}."
    )
    headroom = 0.0 if step.service is None else float(step.service.energy_ceiling.max(initial=0.0))
    if headroom <= WORTH:
        return worth
    return (
        f"{worth} One more kWh of battery capacity would add "
        f"{service_words(step, headroom)} in the outage."
    )
