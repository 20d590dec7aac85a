"""Sets that switching rules allow at once: everyone stays, or leaves when power is first limited.

Where rules join every step to the others, a search may find no set in its time. These need none.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vppres.contract.switching import SwitchingData
from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.fleet.reach import OneBattery


def steady_sets(site: Site, data: WindowData) -> Iterator[Flags]:
    """Sets (W, C) of hardly any actions, from the one of most service down.

    Customers stay in the order of their weights, then of their demand, as long as one battery
    carries them. Smaller sets follow, should the fleet or the network not carry the first: half of
    those who stay, all leave, and nobody is served at all.
    """
    rules = data.switching
    assert rules is not None
    stays, leaves, gone = _services(data, rules)
    one = OneBattery.of(site, data)
    load_kw = data.all_cold().load_kw
    order = np.lexsort((load_kw.max(axis=0), -site.customers.weight))
    served = leaves.copy()
    staying = []
    for customer in order:
        more = served.copy()
        more[:, customer] = stays[:, customer]
        if one.carries((load_kw * more).sum(axis=1)):
            served = more
            staying.append(customer)
    yield served
    half = staying[: len(staying) // 2]
    served = leaves.copy()
    served[:, half] = stays[:, half]
    yield served
    yield leaves
    yield gone


def _services(data: WindowData, rules: SwitchingData) -> tuple[Flags, Flags, Flags]:
    """Each customer who stays, leaves and is never served, (W, C) each, as far as rules allow."""
    shape = data.load_kw.shape
    limited = np.flatnonzero(np.isfinite(data.grid_limit_kw))
    always = np.ones(shape, dtype=bool)
    never = ~always
    until = always.copy()
    until[limited[0] if len(limited) else 0 :] = False
    as_before = np.tile(rules.served_before, (shape[0], 1))
    return (
        _first_allowed(rules, always, as_before, until, never),
        _first_allowed(rules, until, never, as_before, always),
        _first_allowed(rules, never, until, as_before, always),
    )


def _first_allowed(rules: SwitchingData, *services: Flags) -> Flags:
    """Each customer's first service that breaks no rule, or else the last."""
    found = services[-1].copy()
    for service in reversed(services[:-1]):
        allowed = ~rules.broken(service)
        found[:, allowed] = service[:, allowed]
    return found
