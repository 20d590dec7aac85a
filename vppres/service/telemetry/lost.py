"""Customers that cannot be supplied, or dimmed: protection opened, or a device fails.

It was reported: a device that did not switch one on, or did not dim it, or telemetry that it is not
``online``. That stands, however old it is, until it is reported back: ``online`` again, or its
device did what it was reported after all.
"""

from __future__ import annotations

from collections.abc import Mapping

from vppres.scenario.scenario import Scenario
from vppres.service.storage.records import Lost, Reading
from vppres.service.storage.store import Store

DISCONNECTED = "reported as not connected"


def lost_customers(
    scenario: Scenario, online: Mapping[str, Reading], store: Store
) -> dict[str, str]:
    """Customers that cannot be supplied, with reasons.

    ``online`` are the last readings of who is connected, those of batteries among them.
    """
    ids = {str(name) for name in scenario.customers.id}
    off = (name for name, one in online.items() if name in ids and one.value == 0.0)
    return _standing(store.lost(), scenario, online) | dict.fromkeys(off, DISCONNECTED)


def undimmed_customers(
    scenario: Scenario, online: Mapping[str, Reading], store: Store
) -> dict[str, str]:
    """Customers that cannot be dimmed, with reasons."""
    return _standing(store.undimmed(), scenario, online)


def _standing(
    refusals: Mapping[str, Lost], scenario: Scenario, online: Mapping[str, Reading]
) -> dict[str, str]:
    """Refusals of customers that were not reported back since, with reasons."""
    ids = {str(name) for name in scenario.customers.id}
    back = {name: one.time for name, one in online.items() if one.value != 0.0}
    return {
        name: one.reason
        for name, one in refusals.items()
        if name in ids and not back.get(name, one.at) > one.at
    }
