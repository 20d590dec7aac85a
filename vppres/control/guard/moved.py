"""Set-points and measured powers of batteries, from which stored energy is calculated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.batteries.physics import cell_kw
from vppres.scenario.assets import Batteries

MOST_TIMES = 24
"""Times at which power changed that are kept: more than any reading is late by."""

LOOSE_SHARE = 0.1
"""By which share of the energy that was ordered, and not measured, a battery may be off."""

LOOSE_PER_H = 0.01
"""By which share of its capacity it may be off besides for each hour in which nothing is heard."""


SAME_H = 1e-6
"""Times that are nearer to each other are the same: some ms, which sums of hours are off by."""


@dataclass(frozen=True, eq=False)
class StoredEnergy:
    """Energy that was stored since a time; (B,) each."""

    share: Floats  #: as a share of capacity, negative where it was given
    loose: Floats  #: by how much of the capacity that may be off
    evident: Flags  #: whether all power since then was measured


@dataclass(frozen=True, eq=False)
class Moved:
    """Power of batteries, which stays as it is from one time to the next."""

    begun_h: Floats  #: times, in h since the beginning of the controller's first step, (K,)
    cell_kw: Floats  #: power into the cells, (K, B)
    measured: Flags  #: whether it was measured, (K, B); otherwise it was ordered

    @classmethod
    def nothing(cls, n_batteries: int) -> Moved:
        """Before anything was ordered."""
        none = (0, n_batteries)
        return cls(np.zeros(0), np.zeros(none), np.zeros(none, dtype=bool))

    def ordered(self, at_h: float, power_kw: Floats, eta: tuple[Floats, Floats]) -> Moved:
        """Add an order at a time, charging positive; it replaces what was said of later.

        ``eta`` are the efficiencies of charging and discharging.
        """
        before = self.begun_h < at_h - SAME_H
        return Moved(
            np.append(self.begun_h[before], at_h)[-MOST_TIMES:],
            np.vstack([self.cell_kw[before], _into_cells(power_kw, eta)])[-MOST_TIMES:],
            np.vstack([self.measured[before], np.zeros(len(power_kw), dtype=bool)])[-MOST_TIMES:],
        )

    def seen(self, since_h: float, power_kw: Floats, eta: tuple[Floats, Floats]) -> Moved:
        """Add the mean power that was measured since a time, (B,); NaN where it was not."""
        rows = (self.begun_h >= since_h - SAME_H)[:, np.newaxis] & np.isfinite(power_kw)
        return Moved(
            self.begun_h,
            np.where(rows, _into_cells(power_kw, eta), self.cell_kw),
            self.measured | rows,
        )

    def since(self, begin_h: Floats, now_h: float, b: Batteries) -> StoredEnergy:
        """Energy that was stored since a time of each battery, (B,), up to now."""
        ends = np.append(self.begun_h[1:], now_h)[: len(self.begun_h), np.newaxis]
        begins = np.maximum(self.begun_h[:, np.newaxis], begin_h)
        hours = np.clip(np.minimum(ends, now_h) - begins, 0.0, None)
        blind_h = np.maximum(now_h - begin_h, 0.0) - (hours * self.measured).sum(axis=0)
        blind_kwh = (hours * ~self.measured * np.abs(self.cell_kw)).sum(axis=0)
        return StoredEnergy(
            (hours * self.cell_kw).sum(axis=0) / b.energy_kwh,
            LOOSE_SHARE * blind_kwh / b.energy_kwh + LOOSE_PER_H * np.maximum(blind_h, 0.0),
            blind_h <= SAME_H,
        )


def _into_cells(power_kw: Floats, eta: tuple[Floats, Floats]) -> Floats:
    return cell_kw(np.maximum(power_kw, 0.0), np.maximum(-power_kw, 0.0), *eta)
