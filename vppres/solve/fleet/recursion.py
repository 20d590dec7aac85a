"""The most service that one battery can carry, step by step over the units that are lost.

Of all ways to lose so many units up to a step, the one that leaves most energy is as good as any
other for all that follows: dynamic programming, where a search by binaries has many steps that are
nearly alike. ``docs/method.md``, *Service by counts*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.solve.fleet.reach import OneBattery

MOST_WORK = 4e8
"""Energies that are looked at: a third of a second."""


@dataclass(frozen=True, eq=False)
class Losses:
    """Ways to lose service in a step, each with less demand than all that lose no more.

    Attributes
    ----------
    units : array of int, shape (n,)
        Units lost, increasing.
    saved_kw : array, shape (n,)
        Demand that is left out, increasing.
    left_out : array of int, shape (n, K)
        How many customers of each weight are left out: those with the largest demand.
    """

    units: Wholes
    saved_kw: Floats
    left_out: Wholes

    @classmethod
    def of(cls, weights: Sequence[int], load_kw: Sequence[Floats], most_lost: int) -> Losses:
        """All such ways to lose so many units, of customers of each weight, in units, and demand.

        Examples
        --------
        A customer of three units saves more than two of one, and is not worth it beside both:

        >>> ways = Losses.of([1, 3], [np.array([4.0, 5.0]), np.array([9.5])], 5)
        >>> ways.units.tolist(), ways.saved_kw.tolist()
        ([0, 1, 2, 3, 4, 5], [0.0, 5.0, 9.0, 9.5, 14.5, 18.5])
        >>> ways.left_out.tolist()
        [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]]
        """
        found = cls(np.zeros(1, dtype=np.int64), np.zeros(1), np.zeros((1, 0), dtype=np.int64))
        for weight, loads in zip(weights, load_kw, strict=True):
            found = found._with(weight, loads, most_lost)
        return found

    def _with(self, weight: int, loads: Floats, most_lost: int) -> Losses:
        """The same with the customers of one more weight."""
        count = np.arange(len(loads) + 1)
        saved = np.append(0.0, np.cumsum(np.sort(loads)[::-1]))
        units = np.add.outer(self.units, weight * count).ravel()
        saved_kw = np.add.outer(self.saved_kw, saved).ravel()
        before = np.repeat(self.left_out, len(count), axis=0)
        left_out = np.column_stack([before, np.tile(count, len(self.units))])
        order = np.lexsort((-saved_kw, units))
        most = np.maximum.accumulate(saved_kw[order])
        kept = order[np.append(True, most[1:] > most[:-1]) & (units[order] <= most_lost)]
        return Losses(units[kept], saved_kw[kept], left_out[kept])


def is_too_much(n_steps: int, units_of_step: int, most_lost: int) -> bool:
    """Whether a recursion over so many lost units takes longer than it is worth."""
    return n_steps * min(units_of_step, most_lost) * most_lost > MOST_WORK


def fewest_lost(
    one: OneBattery, demand_kw: Floats, losses: Sequence[Losses], most_lost: int
) -> list[int] | None:
    """The way of each step with which one battery loses the fewest units, and no more than so many.

    Parameters
    ----------
    one : OneBattery
        What carries the demand.
    demand_kw : array, shape (W,)
        Demand of each step with all customers supplied.
    losses : sequence of Losses
        Ways to lose units in each of the steps.
    most_lost : int
        Units that may be lost in all.

    Returns
    -------
    list of int or None
        Position of each step's way; None if all lose more.
    """
    energy_kwh = np.full(most_lost + 1, -np.inf)
    energy_kwh[0] = one.stored_kwh
    chosen = []
    for t, ways in enumerate(losses):
        best_kwh = np.full(most_lost + 1, -np.inf)
        way = np.zeros(most_lost + 1, dtype=np.int64)
        for number, units in enumerate(ways.units[ways.units <= most_lost].tolist()):
            left_kw = float(demand_kw[t] - ways.saved_kw[number])
            after_kwh = one.after(t, energy_kwh[: most_lost + 1 - units], left_kw)
            better = after_kwh > best_kwh[units:]
            best_kwh[units:][better] = after_kwh[better]
            way[units:][better] = number
        energy_kwh = best_kwh
        chosen.append(way)
    carried = np.flatnonzero(np.isfinite(energy_kwh))
    return _traced(losses, chosen, int(carried[0])) if len(carried) else None


def _traced(losses: Sequence[Losses], chosen: Sequence[Wholes], lost: int) -> list[int]:
    """The way of each step that led to so many lost units."""
    ways = []
    for step, way in zip(reversed(losses), reversed(chosen), strict=True):
        number = int(way[lost])
        ways.append(number)
        lost -= int(step.units[number])
    return ways[::-1]
