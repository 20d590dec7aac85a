"""Switches of a feeder: lines that can be opened or closed by themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from vppres.core.arrays import Flags, Floats, Items, Names, no_items

TIE = "tie"
SECTIONALISER = "sectionaliser"
BREAKER = "breaker"
SWITCH_KINDS = (TIE, SECTIONALISER, BREAKER)
"""Ties are normally open, sectionalisers normally closed; breakers interrupt fault currents."""


@dataclass(frozen=True, eq=False)
class Switches(Items):
    """Switches, shape (S,) each: a line between two buses that is closed or open.

    Parameters
    ----------
    id : array of str
        Names.
    from_bus, to_bus : array of bus identifiers
        Ends.
    closed : array of bool
        Whether it is a line of the feeder; an open one is none.
    kind : array of str
        One of ``SWITCH_KINDS``.
    operable : array of bool
        Whether it can be moved.
    locked_reason : array of str
        Why it must stay as it is; empty if nothing locks it.
    r_ohm, x_ohm : array
        Series impedance, with the line behind the switch.
    i_max_a : array
        Thermal rating; infinite where there is none.
    """

    id: Names
    from_bus: Names
    to_bus: Names
    closed: Flags
    kind: Names
    operable: Flags
    locked_reason: Names
    r_ohm: Floats
    x_ohm: Floats
    i_max_a: Floats

    @classmethod
    def none(cls) -> Self:
        """No switch."""
        return cls(**{name: no_items() for name in cls.__annotations__})

    @property
    def movable(self) -> Flags:
        """Whether each can be moved and nothing locks it, shape (S,)."""
        return np.asarray(self.operable & (self.locked_reason == ""), dtype=bool)

    @property
    def open(self) -> Self:
        """Switches that are open."""
        return self.rows(~self.closed)
