"""Why a customer got a part of its demand, or more than it."""

from __future__ import annotations

from vppres.explain.reasons import FIRST, overruled, scarce_words, someone_ranks_higher
from vppres.explain.step import Reason, Step
from vppres.explain.words import one_more


def why_dimmed(step: Step, customer: int) -> Reason:
    """Why a customer that was on got a part of its demand."""
    share = float(step.share[customer])
    what = f"Dimmed to {share:.0%} of {step.load_kw[customer]:.1f} kW"
    said = overruled(step, what)
    if said is not None:
        return said
    hours = float(step.site.customers.recovery_h[customer])
    binding = "" if step.service is None else step.scarce_for(customer)
    if not binding and hours > 0.0:
        later = f"what it lacks is caught up within {hours:g} h, and then counts as supplied"
        return Reason("recovery", "", f"{what}: {later}.")
    if not binding:
        words = f"{what}: neither shadow prices nor the record give a reason."
        return Reason("unexplained", "", words)
    scarce = scarce_words(step, customer, binding)
    offer = one_more(step, binding)
    more = f"; {offer}" if offer else ""
    if hours > 0.0:
        words = f"{what}: {scarce} goes to others first; it catches up within {hours:g} h{more}."
        return Reason("recovery", binding, words)
    least = float(step.site.customers.least_share[customer])
    if share <= least and someone_ranks_higher(step, customer):
        first = FIRST[step.site.ranks is None]
        words = f"{what}, its least share: {scarce} goes to {first}{more}."
        return Reason("priority", binding, words)
    return Reason(binding, binding, f"{what}: {scarce} does not suffice for more{more}.")


def why_caught_up(step: Step, customer: int) -> Reason:
    """Why a customer got more than its demand."""
    more_kw = (step.share[customer] - 1.0) * step.load_kw[customer]
    return Reason("recovery", "", f"Gets {more_kw:.1f} kW besides: it catches up what it lacked.")
