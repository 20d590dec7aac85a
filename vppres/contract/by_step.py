"""Arrays by step of a window that are cut and continued together."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np

from vppres.core.arrays import Flags, Floats


@dataclass(frozen=True, eq=False)
class ByStep:
    """Fields of arrays with a row for each of W steps."""

    def part(self, steps: slice) -> Self:
        """The first steps of the window, by a slice."""
        return type(self)(*(each[steps] for each in self._arrays()))

    def followed_by_none(self, n_steps: int) -> Self:
        """The same with steps behind it in which all is 0: nothing is there, or can be missed."""
        rows = ((0, n_steps), (0, 0))
        return type(self)(*(np.pad(each, rows[: each.ndim]) for each in self._arrays()))

    def _arrays(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]


class UnitsAhead(ByStep):
    """What is known of the n units of a kind of flexible power, (W, n) each.

    ``units`` are those of the scenario. Power is what they take, negative where they give;
    ``running`` says which are on, of a kind that is started and stopped.
    """

    def in_the_dark(self, lit: Flags) -> Self:
        """The same without power but in the lit steps, (W, 1)."""
        raise NotImplementedError

    def without_duties(self) -> Self:
        """The same without units that have to stay on."""
        return self

    def most_taken_kw(self, units: Any) -> Floats:
        """Most that all take together, (W,)."""
        return np.zeros(len(self._arrays()[0]))

    def most_given_kw(self, units: Any) -> Floats:
        """Most that all give together, (W,)."""
        return np.zeros(len(self._arrays()[0]))

    def power_beyond_kw(
        self, units: Any, connected: Flags, taken_kw: Floats, running: Flags, dt_h: float
    ) -> Floats:
        """By how much powers are beyond what units can do, (W, n)."""
        raise NotImplementedError

    def stored_beyond_kw(self, units: Any, taken_kw: Floats, running: Flags, dt_h: float) -> Floats:
        """By how much what they store is outside its limits, as a power over the step, (W, n)."""
        return np.zeros_like(taken_kw)
