"""Configurations that the movable switches of a feeder reach, and how each cuts it into parts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, groupby
from math import comb

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.scenario.configuration import blocks_of

MOST_TRIED = 20_000
"""Sets of operations that are looked at: all of them with up to 14 movable switches."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Configurations with no loop that are reached from the present one."""

    ends: Wholes  #: positions of the buses of each branch, (E, 2)
    present: Flags  #: branches that are closed now, (E,)
    movable: Flags  #: branches that may change, (E,)
    price: Floats  #: price of an operation of each, (E,)
    out: Flags  #: branches that are out by faults, (W, E)
    n_buses: int  #: buses

    @property
    def all_tried(self) -> bool:
        """Whether every configuration is looked at."""
        n_sets: int = 2 ** int(self.movable.sum())
        return n_sets <= MOST_TRIED

    @cached_property
    def found(self) -> list[Reached]:
        """All but the present one: fewest parts first, then fewest operations, each way once."""
        known = {Reached(self, self.present).carrying.tobytes()}
        found = []
        for closed in self._without_loop():
            one = Reached(self, closed)
            key = one.carrying.tobytes()
            if key not in known:
                known.add(key)
                found.append(one)
        return sorted(found, key=lambda each: (each.n_parts, each.operations))

    def groups(self) -> Iterator[list[Reached]]:
        """Configurations that cut the feeder alike, fewest parts first."""
        for _, level in groupby(self.found, key=lambda each: each.n_parts):
            alike: dict[bytes, list[Reached]] = {}
            for each in level:
                alike.setdefault(each.parts.tobytes(), []).append(each)
            yield from alike.values()

    @cached_property
    def joined(self) -> Wholes:
        """Parts with every movable branch closed, (W, N): no configuration joins more."""
        return self.parts(self.present | self.movable)

    @cached_property
    def n_joined(self) -> int:
        """Parts with every movable branch closed, added up over the window."""
        return int((self.joined == np.arange(self.n_buses)).sum())

    def parts(self, closed: Flags) -> Wholes:
        """First bus of the part of each bus in each step, (W, N)."""
        rows, which = np.unique(closed & ~self.out, axis=0, return_inverse=True)
        found = []
        for row in rows:
            a, b = self.ends[row].T
            graph = sp.coo_array((np.ones(len(a)), (a, b)), shape=(self.n_buses,) * 2)
            part = connected_components(graph, directed=False)[1]
            found.append(np.unique(part, return_index=True)[1][part])
        return np.array(found, dtype=int)[which.ravel()]

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


@dataclass(frozen=True, eq=False)
class Reached:
    """A configuration that is held over a window."""

    of: Candidates  #: from where it is reached
    closed: Flags  #: branches that are closed, (E,)

    @cached_property
    def carrying(self) -> Flags:
        """Branches that carry in each step, (W, E)."""
        return np.asarray(self.closed & ~self.of.out)

    @cached_property
    def _moved(self) -> Flags:
        """Branches that have to move: a line that is out now need not be opened."""
        return np.asarray((self.closed != self.of.present) & ~self.of.out[0])

    @property
    def operations(self) -> int:
        """Number of switches that have to move."""
        return int(self._moved.sum())

    @cached_property
    def price(self) -> float:
        """Price of the operations in weighted customer hours."""
        return float(self.of.price[self._moved].sum())

    @property
    def n_parts(self) -> int:
        """Parts, added up over the window: without a loop each branch joins two."""
        return len(self.carrying) * self.of.n_buses - int(self.carrying.sum())

    @cached_property
    def parts(self) -> Wholes:
        """First bus of the part of each bus in each step, (W, N), in the order of the day."""
        joins_all = self.n_parts == self.of.n_joined
        return self.of.joined if joins_all else self.of.parts(self.closed)

    def within(self, parts: Wholes) -> bool:
        """Whether each part of it lies within one of others, (W, N), so that it serves no more."""
        joined: Wholes = np.take_along_axis(parts, self.parts, axis=1)
        return bool(np.array_equal(joined, parts))
