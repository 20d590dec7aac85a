"""Why a customer was off, is on again in time, or got a part of its demand, or more than it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vppres.day.trajectory import WHOLE_SHARE
from vppres.explain.reason import Reason
from vppres.explain.reasons import (
    FIRST,
    overruled,
    scarce_words,
    someone_ranks_higher,
    why_not_served,
)
from vppres.explain.step import Step
from vppres.explain.words import figure, one_more

ACTIONS = {
    "not_served": "customer not served",
    "dimmed": "customer dimmed",
    "caught_up": "customer caught up",
    "restored": "customer restored in time",
}
"""Actions that reasons are given for, in words."""


def reasons(step: Step) -> Iterator[tuple[str, str, Reason]]:
    """Name of each customer of note, what became of it, and why."""
    rules = (
        ("not_served", _why_off, ~step.served),
        ("dimmed", _why_dimmed, step.served & (step.share < WHOLE_SHARE)),
        ("caught_up", _why_caught_up, step.share > 2.0 - WHOLE_SHARE),
        ("restored", _why_restored, step.ended & step.served),
    )
    for action, why, customers in rules:
        for c in np.flatnonzero(customers).tolist():
            yield step.site.customers.id[c], action, why(step, c)


def _why_off(step: Step, customer: int) -> Reason:
    """Why a customer was off supply in a step, and how far beyond its longest time off."""
    reason = why_not_served(step, customer)
    if not step.ended[customer]:
        return reason
    off_h = step.recorded.off_before_h[step.t][customer] + step.site.dt_h
    beyond_h = off_h - step.site.customers.longest_off_h[customer]
    limit = _longest_off_words(step, customer)
    return replace(reason, words=f"{reason.words} It is {figure(beyond_h)} h beyond {limit}.")


def _why_restored(step: Step, customer: int) -> Reason:
    """Why a customer is on supply again whose longest time off has ended."""
    local = step.scenario.grid.local(step.scenario.grid.times[step.t])
    ends = f"{_longest_off_words(step, customer)} ends"
    return Reason("longest_off", "", f"On at {local:%H:%M}: {ends}.")


def _longest_off_words(step: Step, customer: int) -> str:
    """How long a customer may be off at a time, in words."""
    c = step.site.customers
    limit_h = c.longest_off_h[customer]
    only_backup = len(c.own_backup_h) and c.own_backup_h[customer] == limit_h
    return f"its {'backup' if only_backup else 'longest time off'} of {limit_h:g} h"


def _why_dimmed(step: Step, customer: int) -> Reason:
    """Why a customer that was on got a part of its demand."""
    share = float(step.share[customer])
    what = f"Dimmed to {share:.0%} of {step.load_kw[customer]:.1f} kW"
    said = overruled(step, what)
    if said is not None:
        return said
    hours = float(step.site.customers.recovery_h[customer])
    binding = "" if step.service is None else step.supply_cost.scarcest(customer)
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


def _why_caught_up(step: Step, customer: int) -> Reason:
    """Why a customer got more than its demand."""
    more_kw = (step.share[customer] - 1.0) * step.load_kw[customer]
    return Reason("recovery", "", f"Gets {more_kw:.1f} kW besides: it catches up what it lacked.")
