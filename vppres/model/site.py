"""Fixed data of a site: what stays the same from window to window."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Wholes, content_key
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
        """Shape (P,): position of each PV system's customer."""
        return self.pv.owner(self.customers)

    @cached_property
    def pv_customer(self) -> sp.csr_array:
        """Shape (C, P): places PV systems on their customers."""
        count = len(self.pv)
        return sp.csr_array(
            (np.ones(count), (self.owner, np.arange(count))), shape=(len(self.customers), count)
        )

    @cached_property
    def pv_bus(self) -> sp.csr_array:
        """Shape (N, P): places PV systems on their owners' buses."""
        return sp.csr_array(self.customer_bus @ self.pv_customer)
