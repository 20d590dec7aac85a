"""Arrays by step of a window that are cut and continued together."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np


@dataclass(frozen=True, eq=False)
class ByStep:
    """Fields of arrays with a row for each of W steps."""

    def part(self, steps: slice) -> Self:
        """The first steps of the window, by a slice."""
        return type(self)(*(each[steps] for each in self._arrays()))

    def followed_by_none(self, n_steps: int) -> Self:
        """Append steps in which all is 0: nothing is there, or can be missed."""
        rows = ((0, n_steps), (0, 0))
        return type(self)(*(np.pad(each, rows[: each.ndim]) for each in self._arrays()))

    def _arrays(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]
