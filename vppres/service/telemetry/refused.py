"""Readings that were refused: the log names each once, and the page as long as it stands."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import pandas as pd

from vppres.core.errors import Problem
from vppres.core.text import brief, visible
from vppres.service.storage.records import Reading

MOST_SHOWN = 500
"""Readings that are shown, of many; those that were refused last."""

LASTING = pd.Timedelta(hours=1)
"""For how long a reading that was refused is shown, or three steps if that is longer."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Refusal:
    """A reading that was refused: who sent it, what of, and what is wrong.

    ``asset`` and ``quantity`` are as they were sent, empty where they are no names.
    """

    source: str
    asset: str
    quantity: str
    problem: Problem

    @property
    def words(self) -> str:
        """Error in a line."""
        one = self.problem
        value = "" if one.value is None else f" = {one.value}"
        return visible(brief(f"{one.field}{value}: {one.message}"))


@dataclass(frozen=True)
class _Standing:
    refusal: Refusal
    at: pd.Timestamp


class RefusedReadings:
    """Last refusals by source, asset and quantity; a good reading clears one."""

    def __init__(self, step: pd.Timedelta) -> None:
        self.changes = 0
        self._lasting = max(LASTING, 3 * step)
        self._standing: OrderedDict[tuple[str, str, str], _Standing] = OrderedDict()
        self._turn = threading.Lock()

    def note(self, refused: Iterable[Refusal], good: Iterable[Reading], now: pd.Timestamp) -> None:
        """Note refused and accepted readings of a batch."""
        with self._turn:
            if self._standing:
                for one in good:
                    self._standing.pop(
                        (one.source, one.asset, one.quantity.partition("/")[0]), None
                    )
            for refusal in refused:
                key = refusal.source, refusal.asset, refusal.quantity
                before = self._standing.pop(key, None)
                if not before or before.refusal.problem.message != refusal.problem.message:
                    log.warning("reading of %s refused: %s", refusal.source, refusal.problem)
                self._standing[key] = _Standing(refusal, now)
            while len(self._standing) > MOST_SHOWN:
                self._standing.popitem(last=False)
            self.changes += 1

    def standing(self, now: pd.Timestamp) -> Iterator[tuple[Refusal, pd.Timestamp]]:
        """Refusals that are still shown, with times."""
        with self._turn:
            found = [*self._standing.values()]
        return ((one.refusal, one.at) for one in found if now - one.at <= self._lasting)
