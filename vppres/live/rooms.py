"""What thermometers of rooms and tanks say, and what is reckoned if they say nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags, Floats, Names
from vppres.plant.rooms import Climate
from vppres.scenario.scenario import Scenario

STILL_C = 1.0
"""How far a temperature may have moved by the model while its reading stands still, in K."""


@dataclass(frozen=True, eq=False)
class Felt:
    """Rooms and tanks at the end of a step, (H,) each.

    Parameters
    ----------
    read_c : array
        Last reading; NaN if there was none.
    reckoned_c : array
        What has become of it since it moved last.
    """

    read_c: Floats
    reckoned_c: Floats

    @classmethod
    def before_the_day(cls, scenario: Scenario) -> Felt:
        """Without readings: the temperatures of the scenario."""
        start_c = scenario.thermal_loads.t_initial_c
        return cls(np.full(len(start_c), np.nan), start_c)

    def after(self, day: Scenario, steps: range, served: Flags) -> Felt:
        """After steps in which nothing was decided: thermostats hold the comfort band."""
        climate = Climate(day)
        climate.t_c = self.reckoned_c
        for t in steps:
            climate.advance(t, climate.thermostat_kw(t, day.thermal_loads.held_c, served))
        return Felt(self.read_c, climate.t_c)


@dataclass(frozen=True, eq=False)
class Indoor:
    """Temperatures at the beginning of a step, (H,) each.

    Parameters
    ----------
    now_c : array
        What is believed: the reading if there is one, else what is reckoned. A reading that stands
        still is not believed once the temperature should have moved by more than ``STILL_C``.
    read_c, reckoned_c : array
        As :class:`Felt` has them.
    estimated : tuple of str
        Readings that are missing or frozen, in words.
    """

    now_c: Floats
    read_c: Floats
    reckoned_c: Floats
    estimated: tuple[str, ...]

    @classmethod
    def of(cls, ids: Names, read_c: Floats, past: Felt) -> Indoor:
        """The temperatures of these readings, NaN where there is none, after a step."""
        read = np.isfinite(read_c)
        still = read & (read_c == past.read_c)
        reckoned_c = np.where(read & ~still, read_c, past.reckoned_c)
        frozen = still & (np.abs(reckoned_c - read_c) > STILL_C)
        missing = ~read & np.isfinite(past.read_c)
        now_c = np.where(read & ~frozen, read_c, reckoned_c)
        words = [
            f"indoor_c {ids[i]} {now_c[i]:.1f} ({kind})"
            for kind, flags in (("missing", missing), ("frozen", frozen))
            for i in np.flatnonzero(flags)
        ]
        return cls(now_c, np.where(read, read_c, past.read_c), reckoned_c, tuple(words))

    def after(self, day: Scenario, power_kw: Floats) -> Felt:
        """What they are at the end of the first step of a day, with these powers."""
        climate = Climate(day)
        climate.t_c = self.reckoned_c
        return Felt(self.read_c, climate.after_c(0, power_kw))
