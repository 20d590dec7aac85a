"""One step as it is explained: the record, its shadow prices, and what was scarce."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from vppres.control.converged import physics_of
from vppres.core.arrays import Flags, Floats
from vppres.day.metrics import AT_RATING
from vppres.day.phases import Phase
from vppres.explain.phased import PhasedStep
from vppres.explain.prices import WORTH, StepPrices
from vppres.explain.windows import Windows
from vppres.kinds.customer.physics import due
from vppres.scenario.formers import bus_of_former, forming_batteries, largest_forming_battery
from vppres.scenario.network import BusId
from vppres.solve.shadow_prices import ShadowPrices

Scarce = Literal["energy", "power", "voltage", "inverter", "rating", "phase", "grid"]
# docs/explanations.md defines them: "grid" limits the import, and the export of what is curtailed.
Driver = (
    Scarce
    | Literal[
        "priority",
        "switching_rule",
        "longest_off",
        "recovery",
        "departure",
        "past_day",
        "price",
        "preparation",
        "surplus",
        "supply",
        "mismatch",
        "plan",
        "rule",
        "fallback",
        "dark",
        "fault",
        "unexplained",
    ]
)
DRIVERS: dict[str, str] = {
    "energy": "stored energy",
    "power": "battery power",
    "inverter": "inverter rating",
    "rating": "line rating",
    "phase": "phase rating",
    "voltage": "voltage limit",
    "grid": "grid limit",
    "priority": "priority",
    "switching_rule": "switching rule",
    "longest_off": "longest time off",
    "recovery": "catching up",
    "departure": "departure of a vehicle",
    "past_day": "past day",
    "price": "price",
    "preparation": "preparation",
    "surplus": "PV surplus",
    "supply": "island supply",
    "mismatch": "island mismatch",
    "plan": "day plan",
    "rule": "controller rule",
    "fallback": "fallback",
    "dark": "blacked-out island",
    "fault": "fault of a line or bus",
    "unexplained": "not explained",
}
"""Drivers of actions, and their names in the report."""

Binding = Scarce | Literal[""]


@dataclass(frozen=True)
class Reason:
    """Why an action was taken: what drove it, what was at its limit, and a sentence."""

    driver: Driver
    binding: Binding
    words: str


class Step:
    """A step of a run with its shadow prices."""

    def __init__(self, windows: Windows, t: int, phase: Phase, prices: StepPrices) -> None:
        recorded = windows.recorded
        self.windows = windows
        self.recorded = recorded
        self.t = t
        self.phase = phase
        self.levels = prices
        self.site = recorded.site
        self.scenario = recorded.scenario
        self.outage = bool(recorded.scenario.outage[t])
        self.load_kw = recorded.load_kw[t]
        self.served = recorded.done.served[t]
        self.share = recorded.done.supplied[t]
        self.battery_kw = recorded.battery_kw[t]

    def of_items(self, table: str, column: str, nothing: object = 0.0) -> NDArray[Any]:
        """A column of a table in the step, a value for each item; nothing where there is none."""
        return self.recorded.of_items(self.t, table, column, nothing)

    @property
    def soc_end(self) -> Floats:
        """States of charge at its end, (B,)."""
        return np.asarray(self.recorded.done.soc[self.t + 1])

    @property
    def imported_kw(self) -> float:
        """Import at the slack bus."""
        return float(self.recorded.done.p_grid_kw[self.t])

    @cached_property
    def phased(self) -> PhasedStep:
        """The step of a phased feeder."""
        return PhasedStep(self.recorded, self.t)

    @cached_property
    def ended(self) -> Flags:
        """Customers whose longest time off had ended at the beginning of the step, (C,).

        With the grid back it is not what puts them on.
        """
        off_h = self.recorded.off_before_h[self.t]
        limit_h = self.site.customers.longest_off_h
        return np.asarray(self.outage & (off_h > 0.0) & due(limit_h, off_h, self.site.dt_h))

    @property
    def at_power(self) -> Flags:
        """Batteries at their power rating, to 0.1%, (B,)."""
        return np.asarray(np.abs(self.battery_kw) >= 0.999 * self.site.batteries.p_max_kw)

    @property
    def at_inverter(self) -> Flags:
        """Batteries at their inverter rating, to 0.1%, (B,)."""
        apparent = np.hypot(self.battery_kw, self.recorded.done.batt_q_kvar[self.t])
        return np.asarray(apparent >= 0.999 * self.site.batteries.s_max_kva)

    @cached_property
    def spare_kw(self) -> float:
        """Power that batteries, curtailed PV and grid could have given besides.

        The headroom of physical mode is left free.
        """
        if not self.outage:
            return np.inf
        return float(self._more_kw.sum() + self.recorded.done.pv_curtailed_kw[self.t].sum())

    @property
    def spare_now_kw(self) -> float:
        """Spare power now, of each battery no more than what it keeps at the end of the step."""
        if not self.dark_steps:
            return np.inf
        more_kw = np.minimum(self._more_kw, self.kept_kwh[0] / self.site.dt_h)
        return float(more_kw.sum() + self.recorded.done.pv_curtailed_kw[self.t].sum())

    @property
    def source_bus(self) -> BusId:
        """The bus from which power comes: the grid's, or that of what forms the island."""
        site, forms = self.site, self.recorded.trajectory.forms(self.t)
        former = largest_forming_battery(site) if self.outage else None
        bus = bus_of_former(site, forms)
        if bus is not None:
            return bus
        return site.network.slack_bus if former is None else site.batteries.bus[former]

    @property
    def _more_kw(self) -> Floats:
        """Power that each battery could have given besides, (B,), its headroom left free."""
        b = self.site.batteries
        share = float(self.recorded.options.get("headroom") or 0.0)
        kept = share if self.recorded.options.get("mode") == "physical" else 0.0
        most_kw = b.active_max_kw - np.where(forming_batteries(self.site), kept * b.s_max_kva, 0.0)
        return np.asarray(np.maximum(most_kw + self.battery_kw, 0.0))

    @property
    def spare_kwh(self) -> float:
        """Energy that batteries keep beyond their reserve, in the outage's step with the least."""
        return float(self.kept_kwh.sum(axis=1).min(initial=np.inf))

    @cached_property
    def kept_kwh(self) -> Floats:
        """Energy that each battery keeps beyond its reserve at the end of steps, (dark_steps, B).

        The first is this step.
        """
        window = self.levels.window
        b = self.site.batteries
        lowest = np.broadcast_to(b.soc_min, (window.n_steps, len(b)))
        if self.recorded.options.get("mode") == "physical":
            headroom = float(self.recorded.options["headroom"])
            lowest = lowest + physics_of(self.site, window, headroom).soc_reserve
        steps = np.arange(self.dark_steps)
        kept = np.maximum(self.recorded.done.soc[1 + self.t + steps] - lowest[steps], 0.0)
        return np.asarray(kept * b.energy_kwh * window.eta_discharge)

    @property
    def off_later(self) -> bool:
        """Whether a customer goes without full supply in a later step of the window."""
        later = slice(self.t + 1, self.t + self.levels.window.n_steps)
        return bool(
            (self.recorded.done.supplied[later] * self.recorded.done.served[later] < 1.0).any()
        )

    @property
    def dark_steps(self) -> int:
        """Steps of the window without grid, from this one on until it is back."""
        dark = self.levels.window.grid_limit_kw <= 0.0
        return int(np.logical_and.accumulate(dark).sum()) if self.outage else 0

    @property
    def service(self) -> ShadowPrices | None:
        """Shadow prices in weighted customer hours."""
        return None if self.levels.service is None else self.levels.service.prices

    @property
    def cost(self) -> ShadowPrices | None:
        """Shadow prices in GBP."""
        return None if self.levels.cost is None else self.levels.cost.prices

    @cached_property
    def later_worth_gbp(self) -> float | None:
        """Expected later worth of one more stored kWh; None where outages are known."""
        text = self.recorded.note(self.t, "stored_value_gbp_per_kwh")
        return float(text) if text else None

    def worth_gbp_per_kwh(self, customer: int) -> float | None:
        """Worth of a stored kWh to a customer now; None where outages are known."""
        value = self.levels.window.stored_value
        if value is None:
            return None
        weight = float(self.site.customers.weight[customer])
        efficiency = float(self.site.batteries.eta_discharge.mean())
        per_kw = weight / max(float(self.load_kw[customer]), 1e-9)
        return value.gbp_per_service * per_kw * efficiency

    @property
    def price_gbp_per_kwh(self) -> float:
        """Import price."""
        return float(self.scenario.price_gbp_per_kwh[self.t])

    @cached_property
    def dearest_gbp(self) -> float:
        """Dearest import price from the step on: energy that is worth more is for an outage."""
        return float(self.scenario.price_gbp_per_kwh[self.t :].max())

    @property
    def fallback(self) -> str:
        """Which fallback decided the step and why, empty if none did."""
        name = self.recorded.note(self.t, "fallback")
        if name in ("", "none"):
            return ""
        why = self.recorded.note(self.t, "fallback_reason")
        return f"{name}: {why}" if name and why else name

    @property
    def dark(self) -> str:
        """Why nothing held the island's voltage, empty if something did."""
        if not self.recorded.flag(self.t, "dark"):
            return ""
        return self.recorded.note(self.t, "dark_reason") or "no battery forms its grid"

    @cached_property
    def supply_cost(self) -> Mapping[Scarce, Floats]:
        """Cost to others of serving each customer in full, by what is scarce, (C,).

        In weighted customer hours. The active power at the slack bus is priced by what limits the
        fleet, each battery counting with its rated power; what the price at the customer's bus has
        on top is due to ratings of lines and to voltage; reactive power at the slack bus is due to
        inverters. Customers in other parts than that of the slack bus have no such cost.
        """
        if self.service is None:
            return dict.fromkeys(get_args(Scarce), np.zeros(len(self.site.customers)))
        p = self.service
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
        phases = None if self.service is None else self.service.phases
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

    @cached_property
    def loading(self) -> Floats:
        """AC current of each line as a share of its rating, (L,); 0 for a line without one.

        Of a phased feeder that of each phase of a line with a rating, (k,).
        """
        if self.site.phases:
            return np.abs(self.phased.currents)
        return np.asarray(np.nan_to_num(self.recorded.loading[self.t]))

    def full_line(self, bus: str) -> int | None:
        """The line on the way to a bus whose rating is worth most, else the fullest at its rating.

        None if no line on the way is at its rating.
        """
        net = self.scenario.network
        if not self.site.phases:
            on_way = net.downstream[:, [net.bus_index[bus]]].toarray().ravel() > 0.0
        else:
            on_way = self.phased.towards(bus)
        worth = 0.0 * on_way if self.service is None else self.service.line_rating * on_way
        if worth.max(initial=0.0) > WORTH:
            return int(np.argmax(worth))
        load = self.loading * on_way
        return int(np.argmax(load)) if load.max(initial=0.0) > AT_RATING else None

    def scarce_for(self, customer: int) -> Binding:
        """Limit that most binds the supply of a customer, empty if none does."""
        cost = {name: float(values[customer]) for name, values in self.supply_cost.items()}
        name = max(cost, key=lambda key: cost[key])
        return name if cost[name] > WORTH else ""

    @cached_property
    def scarce(self) -> Binding:
        """Limit that most binds service in the step, empty if none does."""
        total = {name: float(values.sum()) for name, values in self.supply_cost.items()}
        name = max(total, key=lambda key: total[key])
        return name if total[name] > WORTH else ""

    def _fleet_shares(self, p: ShadowPrices) -> dict[str, float]:
        """How the price of active power divides into what limits the fleet; the sum is 1."""
        if not self.outage:
            limited = np.isfinite(self.scenario.grid_limit_kw[self.t])
            return {"energy": 0.0, "power": 0.0, "inverter": 0.0, "grid": float(limited)}
        b = self.site.batteries
        reach = np.abs(self.battery_kw) / b.s_max_kva
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
