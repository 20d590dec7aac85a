"""Customers that cannot be supplied, or dimmed, and batteries that are not connected.

It was reported: a device that did not switch one on, or did not dim it, or telemetry that it is not
``online``. That stands, however old it is, until it is reported back: ``online`` again, or its
device did what it was reported after all. That a customer is still ``online`` as before says
nothing of whether it can be dimmed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from vppres.scenario.scenario import Scenario
from vppres.service.storage.records import Lost, Reading
from vppres.service.storage.store import Store

ONLINE = "online"
DISCONNECTED = "reported as not connected"


def lost_batteries(scenario: Scenario, latest: Iterable[Reading]) -> dict[str, str]:
    """Batteries that were reported as not connected, with reasons."""
    ids = {str(name) for name in scenario.batteries.id}
    online = _online(ids, latest)
    return {name: DISCONNECTED for name, one in online.items() if one.value == 0.0}


def lost_customers(scenario: Scenario, latest: Iterable[Reading], store: Store) -> dict[str, str]:
    """Customers that cannot be supplied, with reasons."""
    online = _online(_customers(scenario), latest)
    found = {name: DISCONNECTED for name, one in online.items() if one.value == 0.0}
    return _standing(store.lost(), scenario, online) | found


def undimmed_customers(
    scenario: Scenario, latest: Iterable[Reading], store: Store
) -> dict[str, str]:
    """Customers that cannot be dimmed, with reasons."""
    refused = store.undimmed()
    online = _online(_customers(scenario), latest)
    back = {
        name: one
        for name, one in online.items()
        if name in refused and store.has_turned(name, ONLINE, refused[name].at)
    }
    return _standing(refused, scenario, back)


def _customers(scenario: Scenario) -> set[str]:
    return {str(name) for name in scenario.customers.id}


def _online(ids: set[str], latest: Iterable[Reading]) -> dict[str, Reading]:
    """The last reading of each of these that says whether it is connected."""
    said = (one for one in latest if one.quantity == ONLINE and one.known)
    return {one.asset: one for one in said if one.asset in ids}


def _standing(
    refusals: Mapping[str, Lost], scenario: Scenario, online: Mapping[str, Reading]
) -> dict[str, str]:
    """Refusals of customers that were not reported back since, with reasons."""
    ids = _customers(scenario)
    back = {name: one.time for name, one in online.items() if one.value != 0.0}
    return {
        name: one.reason
        for name, one in refusals.items()
        if name in ids and not back.get(name, one.at) > one.at
    }
