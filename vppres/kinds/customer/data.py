"""Rules on customers; all of them off by default, which is the paper."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.core.text import named
from vppres.scenario.option_table import check_group

MOST_SHARE = 2.0
"""Share of its demand that a customer can take at most: as much again as it lacked before."""

ROUNDING = 1e-9
"""Share of a step by which a limit may miss a whole number of steps."""

NAMES_SHOWN = 5
"""Customers named in one sentence."""


def steps_within(hours: Floats | float, dt_h: float) -> Wholes:
    """Whole steps that times have room for."""
    return np.floor(hours / dt_h + ROUNDING).astype(int)


@dataclass(frozen=True)
class SwitchingRules:
    """Limits and prices of switching customers off and on.

    One action is one customer switched off or on. Times are rounded up to whole steps.

    Raises
    ------
    InputError
        With every value that is out of range.

    Examples
    --------
    >>> SwitchingRules(min_unserved_h=2.0).steps(1.5, dt_h=0.5)
    3
    >>> SwitchingRules().active, SwitchingRules(stay_restored=True).active
    (False, True)
    """

    min_served_h: float = 0.0  #: how long a customer is served at least once it is restored, in h
    #: How long a customer stays off at least once it is switched off, in h.
    min_unserved_h: float = 0.0
    #: Price of an action in weighted customer hours. Switching off pays for the restoration too,
    #: so that no customer is off supply to save it.
    price_per_action: float = 0.0
    #: Most actions of one customer in each 24 h from the first step on; an off/on pair is two.
    max_actions_per_customer: int | None = None
    #: Whether a customer that was restored after an interruption is never switched off again.
    stay_restored: bool = False
    #: Demand after a restoration as a multiple of the usual one, at least 1.
    cold_load_factor: float = 1.0
    #: How long that lasts, in h; at least one step where the factor exceeds 1.
    cold_load_h: float = 0.0
    #: What moving a battery by its rated power away from the previous plan is worth, in kW of line
    #: losses; it decides among dispatches of equal service, curtailment and cost only.
    move_weight: float = 0.0

    def __post_init__(self) -> None:
        check_group("switching", self)

    @property
    def active(self) -> bool:
        """Whether any rule concerns who is served; the weight of moves does not."""
        return asdict(self) | {"move_weight": 0.0} != asdict(SwitchingRules())

    def restrain(self, dt_h: float) -> bool:
        """Whether any rule can keep a customer on or off: a least time of one step cannot.

        >>> [SwitchingRules(min_served_h=1.0).restrain(dt_h) for dt_h in (0.25, 1.0)]
        [True, False]
        """
        served_h, unserved_h = (
            hours if self.steps(hours, dt_h) > 1 else 0.0
            for hours in (self.min_served_h, self.min_unserved_h)
        )
        return replace(self, min_served_h=served_h, min_unserved_h=unserved_h).active

    @property
    def cold(self) -> bool:
        """Whether demand is higher after a restoration."""
        return self.cold_load_factor > 1.0

    @staticmethod
    def steps(hours: float, dt_h: float) -> int:
        """Whole steps that a time takes, rounded up."""
        return max(ceil(hours / dt_h - 1e-9), 0)


@dataclass(frozen=True)
class RuleSteps:
    """Rules that shape a compiled problem, in steps."""

    #: Minimum times, at least 1, which is no rule.
    served: int = 1
    unserved: int = 1
    cold: int = 0  #: steps of higher demand after a restoration, 0 for none
    #: Days of the window that have a limit of actions of their own; 1 without a limit.
    days: int = 1


def limits_h(scenario: Any) -> dict[str, float]:
    """How long customers may be off at a time in h, of those that have a limit."""
    c = scenario.customers
    pairs = zip(c.id, c.longest_off_h, strict=True)
    return {str(name): float(hours) for name, hours in pairs if np.isfinite(hours)}


def remark(scenario: Any) -> str:
    """Which customers may be off for less than a step, and so not at all; empty if none."""
    limit_h = scenario.customers.longest_off_h
    short = (limit_h > 0.0) & (limit_h < scenario.grid.dt_h)
    if not short.any():
        return ""
    names = named(scenario.customers.id[short], NAMES_SHOWN)
    return (
        f"The longest time off of {names} is shorter than a step of "
        f"{scenario.grid.dt_h:g} h: plans keep such a customer on in every step. Use shorter "
        "steps, or longer times."
    )
