"""A reason: the driver of an action, the limit that binds, and a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Scarce = Literal["energy", "power", "voltage", "inverter", "rating", "phase", "grid"]
# docs/explanations.md defines them: "grid" limits the import, and the export of what is curtailed.
Driver = (
    Scarce
    | Literal[
        "priority",
        "switching_rule",
        "longest_off",
        "recovery",
        "departure",
        "past_day",
        "price",
        "preparation",
        "surplus",
        "supply",
        "mismatch",
        "plan",
        "rule",
        "fallback",
        "dark",
        "fault",
        "unexplained",
    ]
)
DRIVERS: dict[str, str] = {
    "energy": "stored energy",
    "power": "battery power",
    "inverter": "inverter rating",
    "rating": "line rating",
    "phase": "phase rating",
    "voltage": "voltage limit",
    "grid": "grid limit",
    "priority": "priority",
    "switching_rule": "switching rule",
    "longest_off": "longest time off",
    "recovery": "catching up",
    "departure": "departure of a vehicle",
    "past_day": "past day",
    "price": "price",
    "preparation": "preparation",
    "surplus": "PV surplus",
    "supply": "island supply",
    "mismatch": "island mismatch",
    "plan": "day plan",
    "rule": "controller rule",
    "fallback": "fallback",
    "dark": "blacked-out island",
    "fault": "fault of a line or bus",
    "unexplained": "not explained",
}
"""Drivers of actions, and their names in the report."""

Binding = Scarce | Literal[""]


@dataclass(frozen=True)
class Reason:
    """Why an action was taken: what drove it, what was at its limit, and a sentence."""

    driver: Driver
    binding: Binding
    words: str
