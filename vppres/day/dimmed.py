"""What plans with customers that may be dimmed cannot hold."""

from __future__ import annotations

from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.scenario.scenario import Scenario


def check_dimmed(scenario: Scenario, options: RunOptions) -> None:
    """Refuse a demand after restorations that is dimmed: which of the two comes first is not said.

    Raises
    ------
    InputError
        If there is both.
    """
    if options.switching.cold and scenario.customers.dimmable.any():
        raise InputError.of(
            "options",
            "is not stated for customers that may be dimmed",
            "Use 1, or leave the column share_min of customers.csv out.",
            field="cold_load_factor",
            value=options.switching.cold_load_factor,
        )
