"""Kinds of assets that plans do not state everywhere: what is refused, by name and with a cure."""

from __future__ import annotations

from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.scenario.gensets import Gensets
from vppres.scenario.kinds import KINDS, units_of
from vppres.scenario.scenario import Scenario
from vppres.scenario.vehicles import Chargers

CONTROLLER = "mpc"


def check_kinds(scenario: Scenario, options: RunOptions) -> None:
    """Refuse controllers that plan none of them, and cold load twice.

    Raises
    ------
    InputError
        For the first kind that the site has.
    """
    for kind in map(KINDS.__getitem__, units_of(scenario)):
        if options.controller != CONTROLLER:
            raise InputError.of(
                "options",
                f"plans no {kind.what}",
                f"Use {CONTROLLER}, or remove {kind.file}.",
                field="controller",
                value=options.controller,
            )

    if options.switching.cold and len(scenario.thermal_loads):
        raise InputError.of(
            "options",
            "counts what thermal loads draw after an outage twice",
            "Use 1: what restored customers draw follows from their temperatures.",
            field="cold_load_factor",
            value=options.switching.cold_load_factor,
        )


def check_parts(scenario: Scenario) -> None:
    """Refuse items of a customer that is switched in parts: it is not said with which.

    Raises
    ------
    InputError
        If there is one.
    """
    parts = dict(zip(scenario.customers.id, scenario.customers.shed_steps, strict=True))
    for kind, units in units_of(scenario).items():
        if isinstance(units, Gensets):
            continue  # they are of no customer
        for name, customer in zip(units.id, units.customer, strict=True):
            if parts.get(customer, 1) > 1:
                cure = "Give the customer a shed_steps of 1."
                if isinstance(units, Chargers):
                    cure = f"Give charger {name} a bus instead, or the customer a shed_steps of 1."
                raise InputError.of(
                    KINDS[kind].file,
                    "is switched in parts (shed_steps)",
                    cure,
                    field="customer",
                    value=customer,
                )
