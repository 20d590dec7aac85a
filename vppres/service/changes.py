"""What has changed since the present step was decided, and so is not in its plan."""

from __future__ import annotations

import threading

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
    >>> changes.known(("grid lost",))
    >>> changes.reasons
    ()
    """

    def __init__(self) -> None:
        self.new = threading.Event()
        self._reasons: dict[str, None] = {}
        self._turn = threading.Lock()

    @property
    def reasons(self) -> tuple[str, ...]:
        """All of them."""
        with self._turn:
            return tuple(self._reasons)

    def note(self, reason: str) -> None:
        """One more; what is noted already is not noted twice."""
        with self._turn:
            self._reasons[reason] = None
        self.new.set()

    def known(self, reasons: tuple[str, ...]) -> None:
        """A plan was made that knows of them."""
        with self._turn:
            for reason in reasons:
                self._reasons.pop(reason, None)
