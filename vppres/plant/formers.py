"""Devices that form an island's grid: their bus, and their share of the island's mismatch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.gensets.physics import Engines
from vppres.plant.plant import BatteryState, Plant, Powers, SetForms
from vppres.scenario.assets import Batteries


@dataclass(frozen=True, eq=False)
class FormingBatteries:
    """Batteries that form the grid together; the one with the largest inverter is the reference.

    All reactive mismatch is the reference's own.
    """

    plant: Plant
    state: BatteryState
    batteries: Flags

    @property
    def reference(self) -> int:
        """The battery that is the reference."""
        return int(np.argmax(np.where(self.batteries, self._b.s_max_kva, -1.0)))

    @property
    def name(self) -> str:
        """Its name."""
        return str(self._b.id[self.reference])

    @property
    def place(self) -> int:
        """Its place."""
        return int(self.plant.places.batteries[self.reference])

    @property
    def _b(self) -> Batteries:
        return self.plant.scenario.batteries

    def begin(self, powers: Powers) -> Powers:
        """The set-points as they are."""
        return powers

    def feeding(self, powers: Powers, kvar: float) -> Powers:
        """The powers with so much more reactive power of the reference."""
        batt_q = powers.batt_q_kvar.copy()
        batt_q[self.reference] += kvar
        return replace(powers, batt_q_kvar=batt_q)

    def share(self, powers: Powers, deficit_kw: float) -> tuple[Powers, float]:
        """A deficit shared in proportion to ratings, and what they cannot take of it."""
        most_charge, most_discharge = self.plant.batteries_ahead(self.state).most_kw()
        disc_kw = np.sqrt(np.maximum(self._b.s_max_kva**2 - powers.batt_q_kvar**2, 0.0))
        lowest = -np.minimum(most_discharge, disc_kw)
        highest = np.minimum(most_charge, disc_kw)
        base_kw = np.clip(powers.battery_kw, lowest, highest)
        room = base_kw - lowest if deficit_kw > 0 else highest - base_kw
        given = np.copysign(
            share_out(abs(deficit_kw), np.where(self.batteries, room, 0.0), self._b.s_max_kva),
            deficit_kw,
        )
        return replace(powers, battery_kw=base_kw - given), float(deficit_kw - given.sum())

    @property
    def rating_kva(self) -> float:
        """Rating of its inverter."""
        return float(self._b.s_max_kva[self.reference])

    def excess_kva(self, powers: Powers) -> float:
        """Reactive power of the reference beyond its rating."""
        return float(abs(powers.batt_q_kvar[self.reference]) - self.rating_kva)


@dataclass(frozen=True, eq=False)
class FormingSet:
    """A generating set that forms the grid; batteries and other sets follow."""

    plant: Plant
    t: int
    genset: int

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.plant.scenario.gensets.id[self.genset])

    @property
    def place(self) -> int:
        """Its place."""
        return int(self.plant.places.units["gensets"][self.genset])

    @property
    def batteries(self) -> Flags:
        """None, (B,)."""
        return np.zeros(len(self.plant.scenario.batteries), dtype=bool)

    def begin(self, powers: Powers) -> Powers:
        """The set-points with this set on, whatever its own set-point."""
        running = powers.running["gensets"].copy()
        running[self.genset] = True
        return replace(
            powers, running={**powers.running, "gensets": running}, forming=(SetForms(self.genset),)
        )

    def feeding(self, powers: Powers, kvar: float) -> Powers:
        """The powers with so much more reactive power of the set."""
        (before,) = powers.forming
        return replace(powers, forming=(replace(before, q_kvar=before.q_kvar + kvar),))

    def share(self, powers: Powers, deficit_kw: float) -> tuple[Powers, float]:
        """A deficit that the set takes up, and what it cannot take of it."""
        least_kw, most_kw = (kw[self.genset] for kw in self.plant.of(Engines).forming_kw(self.t))
        taken_kw = powers.taken_kw["gensets"].copy()
        before_kw = -float(taken_kw[self.genset])
        given_kw = float(np.clip(before_kw + deficit_kw, least_kw, most_kw))
        taken_kw[self.genset] = -given_kw
        shared = replace(powers, taken_kw={**powers.taken_kw, "gensets": taken_kw})
        return shared, deficit_kw - (given_kw - before_kw)

    @property
    def rating_kva(self) -> float:
        """Rating of its generator."""
        return float(self.plant.scenario.gensets.s_max_kva[self.genset])

    def excess_kva(self, powers: Powers) -> float:
        """Reactive power of the set beyond what its power factor allows."""
        (own,) = powers.forming
        return float(abs(own.q_kvar) - self.plant.scenario.gensets.q_max_kvar[self.genset])


Former = FormingBatteries | FormingSet
"""A device that holds the voltage of an island at its place and takes up the island's mismatch."""


def share_out(power_kw: float, room_kw: Floats, rating: Floats) -> Floats:
    """Parts of a power in proportion to the ratings; what one cannot take goes to the others.

    >>> share_out(30.0, np.array([5.0, 100.0, 100.0]), np.array([1.0, 1.0, 2.0]))
    array([ 5.        ,  8.33333333, 16.66666667])
    """
    taken = np.zeros(len(room_kw))
    left = power_kw
    free = room_kw > 0
    while left > 1e-12 and free.any():
        part = np.where(free, rating, 0.0)
        step = np.minimum(left * part / part.sum(), room_kw - taken)
        taken += step
        left -= float(step.sum())
        free &= taken < room_kw - 1e-12
    return taken
