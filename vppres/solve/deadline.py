"""The only clock of the solve package: how long something took, and how long it still may take."""

from __future__ import annotations

import math
import time

LEAST_S = 0.01
"""Least time limit that is handed to a solver: some take zero for none."""


class Stopwatch:
    """Counts seconds from when it is made.

    Examples
    --------
    >>> Stopwatch().spent_s < 60.0
    True
    """

    def __init__(self) -> None:
        self._begin = time.perf_counter()

    @property
    def spent_s(self) -> float:
        """Seconds since it was made."""
        return time.perf_counter() - self._begin


class Deadline(Stopwatch):
    """A moment by which something is to be done.

    A deadline never moves. Whoever may take only a part of the time gets a deadline of its own.

    Parameters
    ----------
    time_s : float
        Seconds from now.

    Examples
    --------
    >>> window = Deadline(60.0)
    >>> search = window.part(0.5)
    >>> search.left_s < 30.1 < window.left_s
    True
    >>> Deadline(0.0).passed
    True
    """

    def __init__(self, time_s: float) -> None:
        super().__init__()
        self._end = self._begin + time_s

    @property
    def left_s(self) -> float:
        """Seconds that are left, negative when it has passed."""
        return self._end - time.perf_counter()

    @property
    def passed(self) -> bool:
        """Whether no time is left."""
        return self.left_s <= 0.0

    def part(self, share: float) -> Deadline:
        """The deadline of whoever may take a share of what is left."""
        return Deadline(share * max(self.left_s, 0.0))

    def later(self, time_s: float) -> Deadline:
        """The deadline of whoever may take some seconds beyond this one."""
        return Deadline(self.left_s + time_s)

    def within(self, time_s: float) -> Deadline:
        """The deadline of whoever may take at most so many seconds of what is left."""
        return Deadline(min(self.left_s, time_s))


class Patience:
    """The end of a search whose answer and bound do not improve any more, counted in its nodes.

    Waiting as long again as the last improvement took finds what comes at a steady pace; a search
    that has not moved for that long seldom moves in a multiple of it. Nodes are the same on every
    machine, so that the answer is too; only the deadline is a matter of time.

    Parameters
    ----------
    end : Deadline
        The end in any case.
    least : int
        Nodes without improvement that are always waited for.

    Examples
    --------
    >>> patience = Patience(Deadline(60.0), least=500)
    >>> patience.saw(best=1.0, bound=2.0, nodes=10)
    >>> patience.saw(best=1.0, bound=2.0, nodes=511)
    >>> patience.passed, patience.end.passed
    (True, False)
    """

    def __init__(self, end: Deadline, least: int) -> None:
        self.end = end
        self.nodes = 0
        self._least = least
        self._best = -math.inf
        self._bound = math.inf
        self._improved_at = 0

    def saw(self, best: float, bound: float, nodes: int) -> None:
        """Tell how far a search for the largest value is after so many nodes in all."""
        self.nodes = max(self.nodes, nodes)
        if best > self._best or bound < self._bound:
            self._improved_at = self.nodes
        self._best = max(self._best, best)
        self._bound = min(self._bound, bound)

    @property
    def passed(self) -> bool:
        """Whether nothing has improved for long enough, or time is up."""
        waited = self.nodes - self._improved_at
        return self.end.passed or waited > max(self._least, self._improved_at)
