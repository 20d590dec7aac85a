"""What a step was about, in a sentence."""

from __future__ import annotations

from vppres.explain.prices import WORTH
from vppres.explain.step import Driver, Reason, Step
from vppres.explain.words import SCARCE, figure, money, one_more


def why_step(step: Step) -> Reason:
    """What drove a step as a whole."""
    if step.dark:
        return Reason("dark", "", f"{_headline(step)} The island is dark: {step.dark}.")
    if step.fallback:
        return Reason("fallback", "", f"{_headline(step)} Decided by a fallback ({step.fallback}).")
    scarce = step.scarce
    if scarce and not step.served.all():
        offer = one_more(step, scarce)
        return Reason(
            scarce,
            scarce,
            f"{_headline(step)} {_capital(SCARCE[scarce])} is what is "
            f"scarce{f'; {offer}' if offer else ''}.",
        )
    return Reason(_calm_driver(step), scarce, f"{_headline(step)} {_worth(step)}".rstrip())


def _calm_driver(step: Step) -> Driver:
    """What a step without shortage is about."""
    if step.phase == "island":
        return "supply"
    return "preparation" if step.phase == "preparation" else "price"


def _headline(step: Step) -> str:
    """Who is served and what the fleet does."""
    count = int(step.served.sum())
    total = len(step.served)
    who = "Everyone is served." if count == total else f"{count} of {total} customers are served."
    power = float(step.battery_kw.sum())
    if abs(power) < 1.0:
        return f"{who} The batteries rest."
    verb = "charge at" if power > 0 else "give"
    return f"{who} The batteries {verb} {figure(abs(power))} kW."


def _worth(step: Step) -> str:
    """What a kWh in store serves or saves, where that is known."""
    if step.cost is None or not len(step.cost.kept_energy):
        offer = one_more(step, "energy")
        return f"{_capital(offer)}." if offer else ""
    # Under a belief the plan has said what it is worth, and each battery's sentence tells that.
    believed = step.later_worth_gbp
    stored = (
        f"{money(float(step.cost.kept_energy.max()))} GBP"
        if believed is None
        else f"{money(believed)} GBP later"
    )
    worth = (
        f"A kWh in store is worth {stored}, imported it costs {money(step.price_gbp_per_kwh)} GBP."
    )
    room = 0.0 if step.service is None else float(step.service.energy_ceiling.max(initial=0.0))
    if room <= WORTH:
        return worth
    return (
        f"{worth} One more kWh of battery capacity would serve {figure(room)} weighted "
        "customer hours more in the outage."
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
