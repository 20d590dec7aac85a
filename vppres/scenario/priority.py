"""Strict priority: weights by which nothing that lower tiers gain pays for a loss of a higher one.

In a window of W steps all lower tiers together gain at most the service of all their customers, and
what they would pay beyond their longest times off. A unit of a tier that is worth more than that is
never given up for them, so the optimum of the weighted objective serves as much of the first tier
as can be served, then of the second, and so on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.scenario.assets import Customers

WEIGHTS = "weights"
STRICT = "strict"

MOST_WORTH = 1e6
"""Largest weight of a unit, in units of the last tier: beyond it the solvers' tolerances reach a
unit. In windows so large a unit of three tiers counts as much as 1,000 of the next one."""

PARTS = 100
"""Weights of one tier are distinguished to a hundredth of the smallest."""


@dataclass(frozen=True, eq=False)
class Ranks:
    """Tiers in strict order, and what each customer counts in its own."""

    tiers: tuple[str, ...]  #: names, the most important first
    tier: Wholes  #: position of each customer's tier, (C,)
    #: What a customer counts in its tier, (C,): 1, or its share where weights of a tier differ.
    units: Wholes
    worth: Floats  #: weight of a unit of each tier, (K,); 1 for the last
    actions: float = 0.0  #: what all actions of a window cost at most, in units of the last tier
    #: Price of an hour beyond the longest time off of those that have one, (C,): as many hours off
    #: as the tier has customers, or as leave a unit of the tier above worth more than all of it.
    hour_beyond: Floats = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(
        cls, customers: Customers, tiers: Sequence[str], n_steps: int, action_price: float = 0.0
    ) -> Ranks:
        """Ranks of the customers for windows of so many steps.

        Weights of the customers count within a tier alone. ``action_price`` is that of
        disconnecting or restoring a customer, in customer hours of the last tier.

        Examples
        --------
        >>> def made(tier, weight):
        ...     n = len(tier)
        ...     return Customers([*range(n)], [1] * n, tier, weight, [0.95] * n)
        >>> ranks = Ranks.of(made(["a", "b", "b"], [1.0, 0.1, 0.1]), ("a", "b"), n_steps=6)
        >>> ranks.weight
        array([13.,  1.,  1.])

        A customer that may be off for four hours weighs two more, those of its tier, beyond.

        >>> least = replace(made(["a", "b", "b"], [1.0, 0.1, 0.1]), max_off_h=[np.nan, 4, np.nan])
        >>> Ranks.of(least, ("a", "b"), n_steps=6).weight
        array([25.,  1.,  1.])
        """
        rank = {name: k for k, name in enumerate(tiers)}
        tier = np.array([rank[name] for name in customers.tier], dtype=int)
        units = np.zeros(len(customers), dtype=int)
        for k in np.unique(tier):
            units[tier == k] = _whole_units(customers.weight[tier == k])
        limited = np.isfinite(customers.longest_off_h)
        beyond = np.where(limited, replace(customers, weight=units).hour_beyond, 0.0)
        worth = np.ones(len(tiers))
        most = MOST_WORTH ** (1.0 / max(len(tiers) - 1, 1))
        # An action may be needed for every customer in every step.
        actions = action_price * len(customers) * n_steps
        below = ceil(actions)
        for k in range(len(tiers) - 1, 0, -1):
            below += int(worth[k] * units[tier == k].sum()) * n_steps
            limits = units[(tier == k) & limited].sum()
            if limits:
                # Steps off that a step beyond may count as, for a unit of a tier to remain more.
                room = (np.floor(most * worth[k]) - 1.0 - below) // (worth[k] * limits * n_steps)
                own = np.minimum(beyond, units * max(room, 1.0))
                beyond = np.where(tier == k, own, beyond)
                below += int(worth[k] * beyond[tier == k].sum()) * n_steps
            worth[k - 1] = min(1.0 + below, np.floor(most * worth[k]))
        return cls(tuple(tiers), tier, units, worth, actions, worth[tier] * beyond)

    @property
    def weight(self) -> Floats:
        """Weight of each customer, (C,)."""
        return np.asarray(self.worth[self.tier] * self.units)

    def supplied(self, served: Flags) -> Wholes:
        """Units of each tier that are supplied, summed over the steps, (K,) of (W, C)."""
        units = np.asarray(served, dtype=int).sum(axis=0) * self.units
        return np.bincount(self.tier, units, len(self.tiers)).round().astype(int)

    def most(self, served: Flags, bound: float) -> Wholes:
        """Most units of each tier that any schedule supplies, (K,).

        That of a tier holds for all schedules which supply the tiers above it as this one does.

        ``bound`` is what no schedule's weights exceed, in units of the last tier.
        """
        found = self.supplied(np.ones_like(served))
        for k, supplied in enumerate(self.supplied(served)):
            found[k] = min(found[k], max(int(np.floor(bound / self.worth[k])), supplied))
            bound -= self.worth[k] * supplied
        return found


def _whole_units(weight: Floats) -> Wholes:
    """Weights as whole numbers in their proportions.

    >>> _whole_units(np.array([0.1, 0.1, 0.25]))
    array([2, 2, 5])
    """
    parts = np.round(PARTS * weight / weight.min()).astype(int)
    return np.asarray(parts // np.gcd.reduce(parts))
