"""Customers that cannot be supplied, or dimmed, and batteries that are not connected.

It was reported: a device that did not switch one on, or did not dim it, or telemetry that it is not
``online``. That stands, however old it is, until it is reported back: ``online`` again, or its
device did what it was reported after all. That a customer is still ``online`` as before says
nothing of whether it can be dimmed.
"""

from __future__ import annotations

from collections.abc import Mapping

from vppres.core.arrays import Names
from vppres.scenario.scenario import Scenario
from vppres.service.storage.records import Lost, Reading
from vppres.service.storage.store import Store

ONLINE = "online"
DISCONNECTED = "reported as not connected"


def lost_batteries(scenario: Scenario, online: Mapping[str, Reading]) -> dict[str, str]:
    """Batteries that were reported as not connected, with reasons."""
    return _disconnected(scenario.batteries.id, online)


def lost_customers(
    scenario: Scenario, online: Mapping[str, Reading], store: Store
) -> dict[str, str]:
    """Customers that cannot be supplied, with reasons.

    ``online`` are the last readings of who is connected, those of batteries among them.
    """
    off = _disconnected(scenario.customers.id, online)
    return _standing(store.lost(), scenario, online) | off


def undimmed_customers(
    scenario: Scenario, online: Mapping[str, Reading], store: Store
) -> dict[str, str]:
    """Customers that cannot be dimmed, with reasons."""
    refused = store.undimmed()
    back = {
        name: one
        for name, one in online.items()
        if name in refused and store.has_turned(name, ONLINE, refused[name].at)
    }
    return _standing(refused, scenario, back)


def _disconnected(ids: Names, online: Mapping[str, Reading]) -> dict[str, str]:
    """Devices of these names that were reported as not connected, with the reason."""
    names = {str(name) for name in ids}
    off = (name for name, one in online.items() if name in names and one.value == 0.0)
    return dict.fromkeys(off, DISCONNECTED)


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
