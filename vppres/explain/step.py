"""One step as it is explained: the record, its shadow prices, and what was scarce."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vppres.core.arrays import Flags, Floats
from vppres.day.metrics import AT_RATING
from vppres.day.phases import Phase
from vppres.explain.costs import WORTH, SupplyCost
from vppres.explain.phased import PhasedStep
from vppres.explain.prices import StepPrices
from vppres.explain.spare import Spare
from vppres.explain.windows import Windows
from vppres.kinds.customer.physics import due
from vppres.solve.shadow_prices import ShadowPrices


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
    def spare(self) -> Spare:
        """Power and energy that its batteries had left."""
        return Spare(self.recorded, self.t, self.levels.window)

    @cached_property
    def supply_cost(self) -> SupplyCost:
        """Cost to others of serving each customer in full."""
        return SupplyCost(self.recorded, self.t, self.service)

    @cached_property
    def ended(self) -> Flags:
        """Customers whose longest time off had ended at the beginning of the step, (C,).

        With the grid back it is not what puts them on.
        """
        off_h = self.recorded.off_before_h[self.t]
        limit_h = self.site.customers.longest_off_h
        return np.asarray(self.outage & (off_h > 0.0) & due(limit_h, off_h, self.site.dt_h))

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
