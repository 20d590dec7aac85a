"""The only clock of the solve package: how long something took, and how long it still may take."""

from __future__ import annotations

import time

HALF = 0.5
"""Share of the time left for a search after which others have to follow."""

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

    A deadline never moves. A stage that may take only a part of the time gets a deadline of its
    own.

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
        """The deadline of a stage that may take a share of what is left."""
        return Deadline(share * max(self.left_s, 0.0))

    def later(self, time_s: float) -> Deadline:
        """The deadline of a stage that may take some seconds beyond this one."""
        return Deadline(self.left_s + time_s)
