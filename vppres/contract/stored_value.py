"""Value of the energy left in batteries and tanks behind a window: a concave function of its sum.

It is made outside the optimisation (:mod:`vppres.outlook.value`) and handed to it with a number of
pieces that never changes, so that a problem is compiled once.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from vppres.core.arrays import Floats, freeze_arrays

PIECES = 30
"""Linear pieces of every function: the same number, so that problems keep their shape."""

SHORTEST = 1e-3
"""Least length of a piece as a share of all energy."""

Ending = Literal["", "target", "value"]
"""Condition at a window's end: none, a state of charge to hold, or a value of stored energy."""


@dataclass(frozen=True, eq=False)
class StoredValue:
    """Service that stored energy can be expected to buy later, piecewise linear and concave.

    Examples
    --------
    >>> worth = StoredValue([0.0, 10.0, 20.0], [0.0, 5.0, 6.0], 1000.0, as_service=True)
    >>> worth.at(5.0), worth.at(15.0)
    (2.5, 5.5)
    >>> worth.marginal_gbp_per_kwh(15.0)
    100.0
    """

    energy_kwh: Floats  #: energy of all batteries and tanks together, rising, (K + 1,)
    #: What it is worth, in weighted customer hours, 0 where all are empty, (K + 1,).
    service: Floats
    gbp_per_service: float  #: value of lost load of a weighted customer hour
    #: Whether it counts as service: in an outage, where energy is all that there is to spend.
    #: Otherwise all customers are supplied, and it counts against the cost of energy.
    as_service: bool
    #: Energy in a battery that a unit of what each asset of a kind holds stands for, a litre of
    #: fuel for example, (n,) by kind.
    kwh_each: dict[str, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def slope(self) -> Floats:
        """Weighted customer hours that one more kWh is worth in each piece, (K,)."""
        return np.asarray(np.diff(self.service) / np.diff(self.energy_kwh))

    @property
    def offset(self) -> Floats:
        """Value of each piece at no energy, (K,): the function is the least of all pieces."""
        return np.asarray(self.service[:-1] - self.slope * self.energy_kwh[:-1])

    def at(self, energy_kwh: float) -> float:
        """Weighted customer hours that an energy is worth."""
        return float(np.min(self.slope * energy_kwh + self.offset))

    def most_kwh(self, service: float) -> float:
        """The largest energy that is worth so much: less than all where it leaves no room for sun.

        >>> StoredValue([0.0, 10.0, 20.0], [0.0, 5.0, 3.0], 1000.0, True).most_kwh(4.0)
        15.0
        """
        falls = self.slope < 0.0
        ends = (service - self.offset[falls]) / self.slope[falls]
        return float(ends.min(initial=self.energy_kwh[-1]))

    def marginal_gbp_per_kwh(self, energy_kwh: float) -> float:
        """Value of one more kWh beyond an energy."""
        piece = np.searchsorted(self.energy_kwh, energy_kwh, side="right") - 1
        return float(self.gbp_per_service * self.slope[np.clip(piece, 0, len(self.slope) - 1)])

    def between(self, least_kwh: float, most_kwh: float) -> tuple[float, float]:
        """The least and the most that any energy of a range is worth."""
        inside = (self.energy_kwh > least_kwh) & (self.energy_kwh < most_kwh)
        ends = [self.at(least_kwh), self.at(most_kwh)]
        return min(ends), max(*ends, *self.service[inside])

    def beside(self, unusable_kwh: float) -> StoredValue:
        """Value as a function of the energy held besides some that no customer can use.

        >>> StoredValue([10.0, 20.0], [0.0, 1.0], 1.0, True).beside(5.0).at(15.0)
        1.0
        """
        return replace(self, energy_kwh=self.energy_kwh - unusable_kwh)

    def counted(self, times: float) -> StoredValue:
        """Value where a weighted customer hour counts as so many.

        >>> more = StoredValue([0.0, 10.0], [0.0, 5.0], 1000.0, True).counted(4.0)
        >>> more.at(5.0), more.marginal_gbp_per_kwh(5.0)
        (10.0, 500.0)
        """
        return replace(
            self, service=self.service * times, gbp_per_service=self.gbp_per_service / times
        )

    def holding(self, energy_kwh: float, per_kwh: float) -> StoredValue:
        """Value with a loss of service for each kWh that is missing to an energy.

        >>> held = StoredValue([0.0, 10.0, 20.0], [0.0, 5.0, 6.0], 1000.0, True).holding(10.0, 3.0)
        >>> round(held.at(9.0), 9), round(held.at(20.0), 9)
        (2.0, 6.0)
        """
        least, most = self.energy_kwh[[0, -1]]
        shortest = SHORTEST * (most - least)
        held = np.clip(energy_kwh, least + shortest, most - shortest)
        energy = np.append(least, np.linspace(held, most, PIECES))
        service = np.array([self.at(each) for each in energy])
        service[0] = service[1] - per_kwh * (held - least)
        return replace(self, energy_kwh=energy, service=service)

    @classmethod
    def nothing(cls) -> StoredValue:
        """Energy that is worth nothing.

        >>> StoredValue.nothing().at(7.0)
        0.0
        """
        return cls(np.arange(PIECES + 1.0), np.zeros(PIECES + 1), 0.0, as_service=False)

    @property
    def gbp_as_cost(self) -> float:
        """Reduction of the cost for a weighted customer hour, 0 where it counts as service."""
        return 0.0 if self.as_service else self.gbp_per_service
