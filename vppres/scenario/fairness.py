"""Fairness within a tier: weights by what customers lost before, which keep the tiers apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.scenario.assets import Customers
from vppres.scenario.option_table import default_of

ROTA_H = 24.0
"""Hours of outage in which each customer's turn of a minimum comes once: a day, as in rotas."""

ROUNDING = 1e-9
"""Share of a sum of weights that numbers of a computer may miss it by."""

PARTS = 20
"""Weights change in twentieths: with whole multiples of a unit, windows are proven by counting."""


@dataclass(frozen=True)
class Fairness:
    """How supply is shared within a tier; nothing is by default."""

    #: Growth of a customer's weight with each hour off supply in outages, in 1/h.
    rotation: float = default_of("rotation")
    turn_h: float = default_of("turn_h")  #: hours of an outage for which weights stay
    #: Hours that each customer is on in 24 h of outage, unless a higher tier loses supply by it.
    minimum_on_h: float = default_of("minimum_on_h")


@dataclass(frozen=True)
class Interruption:
    """A time off supply that was, ``end`` not included.

    ``customer`` is empty for an outage of the feeder, of which no customer's time off is known.
    """

    start: pd.Timestamp
    end: pd.Timestamp
    customer: str = ""


def hours_off(
    past: Sequence[Interruption], names: Names, until: pd.Timestamp | None = None
) -> Floats:
    """Hours that each customer was off supply, (C,), before a time if one is given.

    >>> noon = pd.Timestamp("2025-07-01T12:00Z")
    >>> hours_off([Interruption(noon, noon + pd.Timedelta(hours=2), "b")], np.array(["a", "b"]))
    array([0., 2.])
    """
    hour = pd.Timedelta(hours=1)
    found = dict.fromkeys(map(str, names), 0.0)
    for one in past:
        if one.customer in found:
            end = one.end if until is None else min(one.end, until)
            found[one.customer] += max((end - one.start) / hour, 0.0)
    return np.array(list(found.values()), dtype=float)


def rotated(
    customers: Customers, tiers: Sequence[str], off_h: Floats, growth_per_h: float
) -> Floats:
    """Weights that grow with the time off supply, (C,).

    The sum of each tier stays. No weight passes the middle between its tier and those above and
    below, so that a customer never overtakes one of another tier.

    ``growth_per_h`` is the growth of a weight with each hour off supply, ``off_h``, (C,).

    Examples
    --------
    >>> two = Customers(["a", "b"], [1, 1], ["low", "low"], [1.0, 1.0], [0.9, 0.9])
    >>> rotated(two, ["low"], np.array([0.0, 5.0]), 0.2).round(3)
    array([0.65, 1.35])
    """
    weight = customers.weight.copy()
    none = np.zeros(len(customers), dtype=bool)
    members = [found for tier in tiers if (found := np.asarray(customers.tier == tier)).any()]
    for k, own in enumerate(members):
        before = customers.weight[own]
        higher, lower = (np.any([none, *each], axis=0) for each in (members[:k], members[k + 1 :]))
        above = customers.weight[higher].min(initial=np.inf)
        below = customers.weight[lower].max(initial=0.0)
        least = min(np.sqrt(below / before.min()), 1.0)
        most = max(np.sqrt(above / before.max()), 1.0)
        grown = 1.0 + growth_per_h * off_h[own]
        if np.ptp(grown) == 0.0:  # all alike: the weights stay, to the last bit
            continue
        weight[own] = before * _scaled(before, grown, least, most)
    return weight


def _scaled(weight: Floats, grown: Floats, least: float, most: float) -> Floats:
    """Factors in the proportions of ``grown``, within bounds, that leave the sum of weights.

    They are twentieths where these leave it, as they do of equal weights: those that lose most by
    rounding down are rounded up.
    """
    lowest, highest = max(np.ceil(PARTS * least), 1.0), np.floor(PARTS * most)
    # Between the scales at which a factor meets a bound, the sum is linear.
    meets = np.concatenate([lowest / grown, highest / grown]) / PARTS
    scales = np.unique(np.append(np.minimum(meets, 1.0), 0.0))
    sums = np.clip(np.outer(scales, PARTS * grown), lowest, highest) @ weight
    scale = np.interp(PARTS * weight.sum(), sums, scales)
    exact = np.clip(scale * PARTS * grown, lowest, highest)
    parts = np.floor(exact)
    short = PARTS * weight.sum() - weight @ parts
    for c in np.argsort(parts - exact, kind="stable"):
        if short > 0.5 * weight[c] and parts[c] < highest:
            parts[c] += 1.0
            short -= weight[c]
    met = np.isclose(weight @ parts, PARTS * weight.sum(), rtol=ROUNDING, atol=0.0)
    return np.asarray((parts if met else exact) / PARTS)


def turns(n_customers: int, out_h: float, length_h: float) -> Flags:
    """Customers whose turn it is after so many hours of outage, (C,).

    Turns begin one after another in the customers' order, spread evenly over 24 h of outage.

    >>> turns(4, 6.5, 1.0)
    array([False,  True, False, False])
    """
    begins_h = np.arange(n_customers) * ROTA_H / max(n_customers, 1)
    return np.asarray((out_h - begins_h) % ROTA_H < length_h)
