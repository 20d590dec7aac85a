"""Linearisation of the last window's steps: the next window begins there."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData

NO_POWER, GRID, ISLAND = -1, 0, 1
"""Kinds of steps: without power, with the grid as source, and in an island."""

NO_ROW = -1
"""Instead of a row, if there is none."""


@dataclass(frozen=True, eq=False)
class LastWindow:
    """Source of the voltage in the last window's steps, and their linearisation.

    Parameters
    ----------
    t0 : int
        Its first step.
    kinds : array of int, shape (W,)
        ``GRID``, ``ISLAND`` or ``NO_POWER`` of each step.
    rows : tuple of array, shape (W, .)
        Values of each step.
    """

    t0: int
    kinds: Wholes
    rows: tuple[Floats, ...]

    def rows_for(self, t0: int, data: WindowData) -> Wholes:
        """Row for each step of a window from ``t0``, ``NO_ROW`` for a step that has none.

        It is that of the same step if the same source holds its voltage now, and else the last one
        with that source.
        """
        found = np.full(data.n_steps, NO_ROW)
        for step, kind in enumerate(kinds_of(data)):
            alike = np.flatnonzero(self.kinds == kind)
            if kind != NO_POWER and len(alike):
                same = t0 + step - self.t0
                found[step] = same if same in alike else alike[-1]
        return found


def kinds_of(data: WindowData) -> Wholes:
    """Source of the voltage in each step, (W,); by the parts where lines are out."""
    found = np.where(lit_steps(data), np.where(data.dark, ISLAND, GRID), NO_POWER)
    for t in np.flatnonzero(data.parts.cut & lit_steps(data)):
        sources = data.parts.reference[t].astype("<i8").tobytes()
        digest = hashlib.blake2b(sources, digest_size=6).digest()
        found[t] = ISLAND + 1 + int.from_bytes(digest, "little")
    return found
