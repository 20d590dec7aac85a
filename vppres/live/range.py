"""The numbers that a quantity can have, and what is said of others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.io.schema import MAX_KW, MAX_PRICE

RATED_SHARE = 1.5
"""A reading above this share of an inverter's rating is in another unit, or a spike."""

RATING_SHARE = 2e-3
POWER_KW = 0.02
"""Tolerance of powers for solvers and rounding."""


@dataclass(frozen=True)
class Range:
    """The numbers that a quantity can have."""

    #: Ends, included.
    lowest: float
    highest: float
    #: What to say of a number outside.
    message: str
    cure: str
    beyond: str = ""  #: what to say of a number above, if it is not the same
    infinite: bool = False  #: whether it may be infinite
    whole: bool = False  #: whether it lies at one of the ends, and not between

    def holds(self, value: float) -> bool:
        """Whether a number is in the range."""
        if self.whole:
            return value in (self.lowest, self.highest)
        return self.lowest <= value <= self.highest or (self.infinite and value == np.inf)

    def text(self, value: float) -> str:
        """Message for a number outside the range."""
        above = np.isfinite(value) and value > self.highest and self.beyond != ""
        return self.beyond if above else self.message


FINITE = "must be a finite number"
NUMBER = "must be a number not below 0"
CORRECT = "Correct the measurement."
UNIT = "is more than any feeder has: check the unit"
POWER = Range(0.0, MAX_KW, NUMBER, CORRECT, UNIT)
LIMIT = Range(0.0, 1e9, NUMBER, CORRECT, UNIT, infinite=True)
PRICE = Range(-MAX_PRICE, MAX_PRICE, FINITE, CORRECT, "is more than any price")
# No cell loses nine tenths one way; smaller shares would only spoil the numbers.
EFFICIENCY = Range(0.1, 1.0, "must lie between 0.1 and 1", "Give a share, for example 0.95.")


def flag(yes: str) -> Range:
    """The range of a yes or no, whose 1 says so much."""
    return Range(0.0, 1.0, "must be 0 or 1", f"Give 1 if {yes}, else 0.", whole=True)


def rated(lowest_share: float, what: str, rating: float, no_number: str) -> Range:
    """The range up to a share of a rating, and at most what any feeder has."""
    unit = "kVA" if what == "inverter" else "kW"
    beyond = f"is beyond the {what}'s rating of {rating:g} {unit}"
    below = beyond if lowest_share else no_number
    return Range(
        lowest_share * rating, RATED_SHARE * rating, below, "Give the power in kW.", beyond
    )


def slack_kw(rating: Floats) -> Floats:
    """Tolerance of powers of a rating."""
    return POWER_KW + RATING_SHARE * rating


def above_rating(value: Floats, rating: Floats) -> Floats:
    """Excess of values above their ratings and tolerances."""
    return value - rating - slack_kw(rating)
