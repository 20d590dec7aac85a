"""Normally open lines of a feeder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from vppres.core.arrays import Floats, Items, Names, no_items


@dataclass(frozen=True, eq=False)
class Ties(Items):
    """Lines between two buses that are open, and no lines of the network, shape (K,) each.

    Parameters
    ----------
    id : array of str
        Names.
    from_bus, to_bus : array of bus identifiers
        Ends.
    r_ohm, x_ohm : array
        Series impedance.
    i_max_a : array
        Thermal rating; infinite where there is none.
    """

    id: Names
    from_bus: Names
    to_bus: Names
    r_ohm: Floats
    x_ohm: Floats
    i_max_a: Floats

    @classmethod
    def none(cls) -> Self:
        """No tie."""
        return cls(**{name: no_items() for name in cls.__annotations__})
