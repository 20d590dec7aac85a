"""Places of a feeder: where the powers of its devices enter a power flow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.kinds.table import units_of


@dataclass(frozen=True, eq=False)
class Places:
    """The place of each device; place 0 is the grid's.

    Places of a balanced feeder are its buses. Those of a feeder with phases are, behind the grid's,
    its devices themselves, as each has coils and a load model of its own: customers, PV systems,
    batteries, then the units of each kind.
    """

    #: Place of each, (C,), (P,), (B,).
    customers: Wholes
    pv: Wholes
    batteries: Wholes
    units: Mapping[str, Wholes]  #: place of each unit, (n,) by kind
    bus: Wholes  #: position of the network's bus of each place, (places,)
    n_buses: int  #: buses of the network

    @classmethod
    def of(cls, site: Any) -> Places:
        """Places of a scenario or site."""
        index = site.network.bus_index
        kinds = units_of(site)
        named = (
            site.customers.bus,
            site.pv.buses(site.customers),
            site.batteries.bus,
            *(units.buses(site.customers) for units in kinds.values()),
        )
        at = [np.array([index[bus] for bus in buses], dtype=int) for buses in named]
        n_buses = site.network.n_buses
        bus = np.arange(n_buses)
        if site.phases:
            bus = np.concatenate([[0], *at])
            ends = np.cumsum([1, *map(len, at)])
            at = [np.arange(end - len(each), end) for each, end in zip(at, ends[1:], strict=True)]
        customers, pv, batteries, *units = at
        return cls(customers, pv, batteries, dict(zip(kinds, units, strict=True)), bus, n_buses)

    def __len__(self) -> int:
        return len(self.bus)

    def at_buses(self, power: Floats) -> Floats:
        """Powers of the network's buses, (N,), of those of the places."""
        return np.asarray(np.bincount(self.bus, power, self.n_buses), dtype=float)
