"""Changes since the present step was decided, which its plan does not contain."""

from __future__ import annotations

import threading
from collections.abc import Mapping

GRID_LOST = "grid lost"
"""How the reason begins that the grid is lost, by a reading."""


class Changes:
    """Reasons to decide the present step anew, in their order.

    Attributes
    ----------
    new : threading.Event
        Set while there are reasons that were not looked at.

    Examples
    --------
    >>> changes = Changes()
    >>> changes.note("grid lost")
    >>> changes.note("grid lost")
    >>> changes.reasons, changes.new.is_set()
    (('grid lost',), True)
    >>> changes.known(changes.noted)
    >>> changes.reasons
    ()
    """

    def __init__(self) -> None:
        self.new = threading.Event()
        self._count = 0
        self._noted: dict[str, int] = {}
        self._turn = threading.Lock()

    @property
    def reasons(self) -> tuple[str, ...]:
        """All of them."""
        return tuple(self.noted)

    @property
    def noted(self) -> dict[str, int]:
        """All of them, with the number of the note that came last."""
        with self._turn:
            return dict(self._noted)

    def note(self, reason: str) -> None:
        """One more; what is noted already is not listed twice."""
        with self._turn:
            self._count += 1
            self._noted[reason] = self._count
        self.new.set()

    def known(self, noted: Mapping[str, int]) -> None:
        """A plan was made that knows of these; what was noted again since it does not."""
        with self._turn:
            for reason, number in noted.items():
                if self._noted.get(reason) == number:
                    del self._noted[reason]
