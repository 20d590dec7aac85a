"""Configurations that the movable switches of a feeder reach, and how each cuts it into parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.scenario.configuration import blocks_of
from vppres.scenario.faults import OutOfService

MOST_TRIED = 20_000
"""Sets of operations that are looked at: all of them with up to 14 movable switches."""


@dataclass(frozen=True, eq=False)
class Reached:
    """A configuration that is held over a window.

    Parameters
    ----------
    closed : array of bool, shape (E,)
        Branches that are closed.
    operations : int
        Switches that have to move for it.
    price : float
        Price of the operations in weighted customer hours.
    parts : array of int, shape (W, N)
        First bus of the part of each bus, in the order of the day.
    """

    closed: Flags
    operations: int
    price: float
    parts: Wholes

    @property
    def n_parts(self) -> int:
        """Parts, added up over the window."""
        return int((self.parts == np.arange(self.parts.shape[1])).sum())

    def cuts(self, other: Reached) -> bool:
        """Whether each part of it lies within one of another's, so that it serves no more."""
        joined: Wholes = np.take_along_axis(other.parts, self.parts, axis=1)
        return bool(np.array_equal(joined, other.parts))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Configurations with no loop that are reached from the present one.

    Parameters
    ----------
    ends : array of int, shape (E, 2)
        Positions of the buses of each branch.
    present : array of bool, shape (E,)
        Branches that are closed now.
    movable : array of bool, shape (E,)
        Branches that may change.
    price : array, shape (E,)
        Price of an operation of each.
    out : array of bool, shape (W, E)
        Branches that are out by faults.
    n_buses : int
        Buses.
    """

    ends: Wholes
    present: Flags
    movable: Flags
    price: Floats
    out: Flags
    n_buses: int

    @property
    def all_tried(self) -> bool:
        """Whether every configuration is looked at."""
        n_sets: int = 2 ** int(self.movable.sum())
        return n_sets <= MOST_TRIED

    def found(self) -> list[Reached]:
        """All but the present one: fewest parts first, then fewest operations, each way once."""
        known = {self._carrying(self.present).tobytes()}
        found = []
        for closed in self._without_loop():
            key = self._carrying(closed).tobytes()
            if key not in known:
                known.add(key)
                found.append(self.of(closed))
        return sorted(found, key=lambda each: (each.n_parts, each.operations))

    def of(self, closed: Flags) -> Reached:
        """A configuration; a line that is out now need not be opened."""
        moved = (closed != self.present) & ~self.out[0]
        return Reached(
            closed, int(moved.sum()), float(self.price[moved].sum()), self._parts(closed)
        )

    def _carrying(self, closed: Flags) -> Flags:
        """Branches that carry in each step, (W, E)."""
        return np.asarray(closed & ~self.out)

    def _parts(self, closed: Flags) -> Wholes:
        rows, which = np.unique(self._carrying(closed), axis=0, return_inverse=True)
        of_rows = [blocks_of(self.ends, row, self.n_buses) for row in rows]
        return np.array(of_rows, dtype=int)[which.ravel()]

    def _without_loop(self) -> Iterator[Flags]:
        """Configurations of closed branches without a loop, fewest operations first."""
        free = np.flatnonzero(self.movable)
        fixed = self.present & ~self.movable
        blocks = blocks_of(self.ends, fixed, self.n_buses)
        assert blocks is not None  # the present configuration has no loop
        names, number = np.unique(blocks, return_inverse=True)
        ends = number[self.ends[free]]
        now = self.present[free]
        tried = 0
        for n_moves in range(1, len(free) + 1):
            tried += comb(len(free), n_moves)
            if tried > MOST_TRIED:
                return
            for moved in combinations(range(len(free)), n_moves):
                after = now.copy()
                after[list(moved)] ^= True
                if blocks_of(ends, after, len(names)) is not None:
                    closed = self.present.copy()
                    closed[free] = after
                    yield closed


def out_of_branches(out: OutOfService | None, ends: Wholes, steps: int) -> Flags:
    """Branches that faults take out, (W, E), of lines and buses in the order of the day."""
    found = np.zeros((steps, len(ends)), dtype=bool)
    if out is not None:
        found[:, : out.lines.shape[1]] = out.lines
        found |= out.buses[:, ends].any(axis=2)
    return found
