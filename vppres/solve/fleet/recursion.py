"""The most service that one battery can carry, step by step over the units that are lost.

Of all ways to lose so many units up to a step, the one that leaves most energy is as good as any
other for all that follows: dynamic programming, where a search by binaries has many steps that are
nearly alike. ``docs/method.md``, *Service step by step*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.fleet.reach import OneBattery
from vppres.solve.programs import SOLVED

SPARE_CUSTOMERS = 3
"""Customers of the largest weight that a schedule may lose beyond what shares of customers lose
before twice as many are asked for."""

MOST_WORK = 4e8
"""Energies that are looked at: a third of a second."""


@dataclass(frozen=True, eq=False)
class Losses:
    """Ways to lose service in a step, each with less demand than all that lose no more."""

    units: Wholes  #: units lost, increasing, (n,)
    saved_kw: Floats  #: demand that is left out, increasing, (n,)
    #: How many customers of each weight are left out, (n, K): those with the largest demand.
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
        """Table with the customers of one more weight."""
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


def most_units(
    site: Site, data: WindowData, able: Flags, units: Wholes, by_shares: float
) -> tuple[float, Flags | None]:
    """Most service of one battery in units, which no set exceeds, and a set that has it, (W, C).

    In steps without a limit of import all who can be are supplied. No set is returned where it
    takes too long to find.

    The window has no rules. ``able`` can be supplied, (W, C); ``by_shares`` is the most service of
    shares of customers.
    """
    one = OneBattery.of(site, data)
    everyone = int((able * units).sum())
    loses = able & np.isfinite(data.grid_limit_kw)[:, None]
    most_of_step = int((loses * units).sum(axis=1).max())
    weights = np.unique(units[units > 0])
    alike = [[np.flatnonzero(each & (units == w)) for w in weights] for each in loses]
    load_kw = [[data.load_kw[t, of] for of in step] for t, step in enumerate(alike)]
    fewest = max(int(np.ceil(everyone - by_shares - SOLVED)), 0)
    spare = SPARE_CUSTOMERS * int(units.max())
    ways = None
    while ways is None:
        most_lost = fewest + spare
        if len(able) * min(most_of_step, most_lost) * most_lost > MOST_WORK:
            return float(everyone - fewest), None
        losses = [Losses.of(weights.tolist(), loads, most_lost) for loads in load_kw]
        ways = fewest_lost(one, (data.load_kw * able).sum(axis=1), losses, most_lost)
        if ways is None:
            fewest, spare = most_lost + 1, 2 * spare
    served = able.copy()
    for t, (step, way) in enumerate(zip(losses, ways, strict=True)):
        for of, loads, count in zip(alike[t], load_kw[t], step.left_out[way], strict=True):
            served[t, of[np.argsort(-loads, kind="stable")[:count]]] = False
    return float((served * units).sum()), served


def fewest_lost(
    one: OneBattery, demand_kw: Floats, losses: Sequence[Losses], most_lost: int
) -> list[int] | None:
    """The way of each step with which one battery loses the fewest units, and no more than so many.

    ``demand_kw`` is that of each step with all customers supplied, (W,); ``losses`` has the ways to
    lose units in each.

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
    if not len(carried):
        return None
    lost, taken = int(carried[0]), []
    for ways, way in zip(reversed(losses), reversed(chosen), strict=True):
        taken.append(int(way[lost]))
        lost -= int(ways.units[taken[-1]])
    return taken[::-1]
