"""Fixed data of a site: what stays the same from window to window."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.core.arrays import Flags, Floats, Wholes, content_key
from vppres.kinds.fields import OfKinds
from vppres.kinds.kind import Units
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.network import Network
from vppres.scenario.phases import BALANCED, Phases
from vppres.scenario.priority import Ranks
from vppres.scenario.scenario import ObjectiveWeights, Scenario

LESS_THAN_A_UNIT = 0.5
"""Most that all curtailment of a window counts in strict order: rounded to whole units, a bound
on service and curtailment is one on service."""


ANY_PU = (0.1, 2.0)
"""Limits of voltages that have none."""


@lru_cache(maxsize=16)
def as_tree(network: Network) -> Network:
    """The tree of a phased feeder's buses: lines without ratios and shunts, no voltage limited."""
    none = np.empty(0)
    least, most = ANY_PU
    return replace(
        network,
        ratio=none,
        b_us=none,
        g_us=none,
        i_max_a=none,
        drawing_bus=np.empty(0, dtype=object),
        p_shunt_kw=none,
        q_shunt_kvar=none,
        p_fixed_kw=none,
        q_fixed_kvar=none,
        island=np.empty(0, dtype=bool),
        v_slack_pu=1.0,
        v_min_pu=least,
        v_max_pu=most,
        v_min_ac_pu=least,
        v_max_ac_pu=most,
    )


@dataclass(frozen=True, eq=False)
class Site(OfKinds):
    """Fixed data of all steps: network, assets, weights and step length.

    ``ranks`` are those behind the weights of strict priority; None where tiers are weighed.
    With ``soft_voltages`` the limits of the voltages give way, with grid, to what the feeder has
    without control. With ``rated`` the currents of lines stay within their ratings.

    A site with ``phases`` has a ``network`` that is only the tree of its buses: its flows break
    ties, and no voltage of it is limited. The limits are those of ``feeder``.
    """

    network: Network
    customers: Customers
    pv: PVSystems
    batteries: Batteries
    weights: ObjectiveWeights
    dt_h: float
    ranks: Ranks | None = None
    soft_voltages: bool = False
    rated: bool = False
    phases: Phases = BALANCED
    limits_of: Network | None = None

    @classmethod
    def of(cls, scenario: Scenario) -> Site:
        """Site of a scenario."""
        if scenario.phases:
            balanced = cls.of(replace(scenario, phases=BALANCED))
            tree = as_tree(scenario.network)
            return replace(
                balanced, network=tree, phases=scenario.phases, limits_of=scenario.network
            )
        return cls(
            scenario.network,
            scenario.customers,
            scenario.pv,
            scenario.batteries,
            scenario.objective,
            scenario.grid.dt_h,
            **{kind: getattr(scenario, kind) for kind in KINDS},
        )

    def ranked(self, ranks: Ranks, n_steps: int) -> Site:
        """The site with tiers in strict order, for windows of so many steps at most.

        Whatever ranks below service is scaled down, so that all PV power of a window curtailed
        counts less than half a unit of the last tier.
        """
        w = self.weights
        curtailed = w.lambda_curt * float(self.pv.p_max_kw.sum()) * n_steps
        scale = min(1.0, LESS_THAN_A_UNIT / max(curtailed, LESS_THAN_A_UNIT))
        return replace(
            self,
            customers=replace(self.customers, weight=ranks.weight),
            weights=ObjectiveWeights(*(scale * getattr(w, f.name) for f in fields(w))),
            ranks=ranks,
        )

    @property
    def hour_beyond(self) -> Floats:
        """Price of an hour beyond the longest time off in weighted customer hours, (C,).

        Of customers without one it has no meaning.
        """
        return self.customers.hour_beyond if self.ranks is None else self.ranks.hour_beyond

    @property
    def hour_off(self) -> Floats:
        """Most that an hour off takes from each in weighted customer hours, (C,).

        Its service, and what is paid beyond the longest time off of those that have one.
        """
        limited = np.isfinite(self.customers.longest_off_h)
        return self.customers.weight + np.where(limited, self.hour_beyond, 0.0)

    @property
    def feeder(self) -> Network:
        """The network whose voltage limits hold."""
        return self.network if self.limits_of is None else self.limits_of

    @cached_property
    def kinds(self) -> dict[str, Units]:
        """Units of each kind of flexible power that the site has."""
        return units_of(self)

    @cached_property
    def key(self) -> str:
        """Digest of the content: sites of equal content have equal problems.

        What batteries hold at first is in no problem: each window says what they hold.
        """
        anyhow = replace(self.batteries, soc_initial=self.batteries.soc_min)
        more: list[Any] = [] if self.ranks is None else [self.ranks]
        more += self.kinds.values()
        rules = " soft" * self.soft_voltages + " rated" * self.rated
        if self.phases:
            rules += f" {self.phases.key} {content_key(self.feeder)}"
        return f"{self.dt_h}{rules} " + content_key(
            self.weights, self.network, self.customers, self.pv, anyhow, *more
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
    def unit_bus(self) -> dict[str, sp.csr_array]:
        """Shape (N, n) by kind of flexible power: places its units on their buses."""
        places = {kind: getattr(self, kind).buses(self.customers) for kind in KINDS}
        return {kind: self.network.place(buses) for kind, buses in places.items()}

    @cached_property
    def taking_bus(self) -> dict[str, sp.csr_array]:
        """Shape (N, n) by what takes power besides: places customers, and the units of kinds."""
        return {"customers": self.customer_bus, **self.unit_bus}

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
