"""Customers that cannot be supplied: protection opened, or a device fails.

It was reported: a device that did not switch one on, or telemetry that it is not ``online``. That
stands, however old it is, until it is reported back: ``online`` again, or its device did what it
was reported after all.
"""

from __future__ import annotations

from collections.abc import Iterable

from vppres.scenario.scenario import Scenario
from vppres.service.storage.records import Reading
from vppres.service.storage.store import Store

ONLINE = "online"
DISCONNECTED = "reported as not connected"


def lost_customers(scenario: Scenario, latest: Iterable[Reading], store: Store) -> dict[str, str]:
    """Customers that cannot be supplied, with reasons."""
    ids = {str(name) for name in scenario.customers.id}
    online = {
        one.asset: one
        for one in latest
        if one.quantity == ONLINE and one.asset in ids and one.known
    }
    found = {name: DISCONNECTED for name, one in online.items() if one.value == 0.0}
    for name, lost in store.lost().items():
        back = online.get(name)
        later = back and back.value != 0.0 and back.time > lost.at
        if name in ids and not later:
            found.setdefault(name, lost.reason)
    return found
