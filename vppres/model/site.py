"""Fixed data of a site: what stays the same from window to window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes, content_key
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.scenario import ObjectiveWeights, Scenario


@dataclass(frozen=True, eq=False)
class Site:
    """What stays the same from step to step: network, assets, weights and step length."""

    network: Network
    customers: Customers
    pv: PVSystems
    batteries: Batteries
    weights: ObjectiveWeights
    dt_h: float

    @classmethod
    def of(cls, scenario: Scenario) -> Site:
        """Site of a scenario."""
        return cls(
            scenario.network,
            scenario.customers,
            scenario.pv,
            scenario.batteries,
            scenario.objective,
            scenario.grid.dt_h,
        )

    @cached_property
    def key(self) -> str:
        """Digest of the content: sites of equal content have equal problems."""
        return f"{self.dt_h} " + content_key(
            self.weights, self.network, self.customers, self.pv, self.batteries
        )

    @cached_property
    def customer_bus(self) -> sp.csr_array:
        """Shape (N, C): places customers on their buses."""
        return self.network.place(self.customers.bus)

    @cached_property
    def battery_bus(self) -> sp.csr_array:
        """Shape (N, B): places batteries on their buses."""
        return self.network.place(self.batteries.bus)

    @cached_property
    def owner(self) -> Wholes:
        """Shape (P,): position of each PV system's customer, 0 for a system that stands alone."""
        return self.pv.owner(self.customers)

    @cached_property
    def alone(self) -> Flags:
        """Shape (P,): PV systems without a customer."""
        return self.pv.alone

    @cached_property
    def pv_customer(self) -> sp.csr_array:
        """Shape (C, P): places PV systems on their customers."""
        owned = np.flatnonzero(~self.alone)
        return sp.csr_array(
            (np.ones(len(owned)), (self.owner[owned], owned)),
            shape=(len(self.customers), len(self.pv)),
        )

    @cached_property
    def pv_bus(self) -> sp.csr_array:
        """Shape (N, P): places PV systems on their owners' buses, or their own."""
        return self.network.place(self.pv.buses(self.customers))

    def behind_meter(self, load_kw: Floats) -> Floats:
        """Demand at the owner of each PV system, (..., P) of (..., C); 0 where there is none."""
        return np.where(self.alone, 0.0, load_kw[..., self.owner])
