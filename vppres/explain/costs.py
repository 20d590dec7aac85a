"""Cost to others of serving customers, by the limits that are scarce, of shadow prices."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import get_args

import numpy as np

from vppres.core.arrays import Floats
from vppres.explain.reason import Binding, Scarce
from vppres.explain.recorded import Recorded
from vppres.solve.shadow_prices import ShadowPrices

WORTH = 1e-6
"""Smallest shadow price that counts, in weighted customer hours; solver noise is below 1e-9."""


class SupplyCost:
    """Cost to others of serving each customer of a recorded step in full; none without prices."""

    def __init__(self, recorded: Recorded, t: int, prices: ShadowPrices | None) -> None:
        self.recorded = recorded
        self.t = t
        self.prices = prices
        self.site = recorded.site
        self.load_kw = recorded.load_kw[t]

    @cached_property
    def by_limit(self) -> Mapping[Scarce, Floats]:
        """Cost to others of serving each customer in full, by what is scarce, (C,).

        In weighted customer hours. The active power at the slack bus is priced by what limits the
        fleet, each battery counting with its rated power; what the price at the customer's bus has
        on top is due to ratings of lines and to voltage; reactive power at the slack bus is due to
        inverters. Customers in other parts than that of the slack bus have no such cost.
        """
        if self.prices is None:
            return dict.fromkeys(get_args(Scarce), np.zeros(len(self.site.customers)))
        p = self.prices
        bus = self.site.customer_bus
        load_kvar = self.load_kw * self.site.customers.q_per_p
        active = bus.T @ p.active
        reactive = bus.T @ p.reactive
        system = max(p.active[0], 0.0) * self.load_kw
        share = self._fleet_shares(p)
        beyond = (active - p.active[0]) * self.load_kw + (reactive - p.reactive[0]) * load_kvar
        rating = bus.T @ p.line_active * self.load_kw + bus.T @ p.line_reactive * load_kvar
        inverter = share["inverter"] * system + np.maximum(p.reactive[0] * load_kvar, 0.0)
        rated = nodes = np.zeros(len(load_kvar))
        if p.phases is not None:
            of_ratings = self._cost_by(p.phases.rated_active, p.phases.rated_reactive)
            rated = np.maximum(of_ratings, 0.0).sum(axis=0)
            of_nodes = self._cost_by(p.phases.by_voltage, p.phases.by_voltage_kvar)
            nodes = np.maximum(of_nodes, 0.0)
        costs: dict[Scarce, Floats] = {
            "energy": share["energy"] * system,
            "power": share["power"] * system,
            "inverter": inverter,
            "grid": share["grid"] * system,
            "rating": np.maximum(rating, 0.0) + rated,
            "phase": np.maximum(self.phase_cost.sum(axis=0), 0.0),
            "voltage": np.maximum(beyond - rating, 0.0) + nodes,
        }
        # Prices of another part do not differ from the slack bus by voltage.
        inside = ~self.recorded.cut_off(self.t)
        return {name: values * inside for name, values in costs.items()}

    @cached_property
    def phase_cost(self) -> Floats:
        """Part of the formers' phases in the cost of each customer, (K, C); 0 without phases."""
        phases = None if self.prices is None else self.prices.phases
        if phases is None:
            return np.zeros((3, len(self.load_kw)))
        return self._cost_by(phases.active, phases.reactive)

    def _cost_by(self, active: Floats, reactive: Floats) -> Floats:
        """Cost of each customer at prices of powers, (..., D), as (..., C)."""
        n = len(self.load_kw)
        kvar = self.load_kw * self.site.customers.q_per_p
        return np.asarray(active[..., :n] * self.load_kw + reactive[..., :n] * kvar)

    def full_phase(self, customer: int) -> int | None:
        """The former's phase that costs most of what supplying a customer does; None if none."""
        cost = self.phase_cost[:, customer]
        return int(np.argmax(cost)) if cost.max() > WORTH else None

    def scarcest(self, customer: int) -> Binding:
        """Limit that most binds the supply of a customer, empty if none does."""
        return _most({name: float(cost[customer]) for name, cost in self.by_limit.items()})

    @cached_property
    def scarcest_of_all(self) -> Binding:
        """Limit that most binds service in the step, empty if none does."""
        return _most({name: float(cost.sum()) for name, cost in self.by_limit.items()})

    def _fleet_shares(self, p: ShadowPrices) -> dict[str, float]:
        """How the price of active power divides into what limits the fleet; the sum is 1."""
        if not self.recorded.scenario.outage[self.t]:
            limited = np.isfinite(self.recorded.scenario.grid_limit_kw[self.t])
            return {"energy": 0.0, "power": 0.0, "inverter": 0.0, "grid": float(limited)}
        b = self.site.batteries
        reach = np.abs(self.recorded.battery_kw[self.t]) / b.s_max_kva
        worth = {
            "energy": p.kept_energy / b.eta_discharge * self.site.dt_h,
            "power": p.battery_discharging,
            "inverter": p.battery_inverter * reach,
        }
        parts = {name: float(np.maximum(v, 0.0) @ b.p_max_kw) for name, v in worth.items()}
        total = sum(parts.values())
        if total <= WORTH:  # no battery can give more at any price
            return {"energy": 0.0, "power": 1.0, "inverter": 0.0, "grid": 0.0}
        return {"grid": 0.0, **{name: part / total for name, part in parts.items()}}


def _most(cost: Mapping[Scarce, float]) -> Binding:
    """The limit that costs most, empty if none costs anything."""
    name = max(cost, key=lambda key: cost[key])
    return name if cost[name] > WORTH else ""
