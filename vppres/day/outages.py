"""Outages ahead in an observation: the option ``outages``.

Unless outages are known, nothing but the present step of the true grid limits passes from here.
The same observation goes to the controller, to the guard around it and to its fallbacks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.forecast import Forecast
from vppres.contract.observation import Observation
from vppres.contract.stored_value import StoredValue
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Flags, Floats
from vppres.day.forecasting import DayForecasts
from vppres.day.priority import site_of
from vppres.kinds.export.physics import Export
from vppres.kinds.kind import EnergyHeld
from vppres.model.site import Site
from vppres.outlook.belief import OutageBelief
from vppres.outlook.outlook import OutageOutlook, SeenOutage
from vppres.outlook.presets import Statistics
from vppres.outlook.value import Ahead, EquivalentBattery, stored_value
from vppres.scenario.formers import forming_batteries
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import Scenario

KNOWN = "known"
LIKELY = "likely"
BELIEF = "belief"
PHYSICAL = "physical"

Stores = Mapping[str, EnergyHeld]  # of each kind

LOOKAHEAD_H = 48.0
"""How far a belief looks ahead: energy that is kept for longer is bought again."""

DAY_H = 24.0
"""Prices of so many hours up to the end of what is known say what energy costs behind it."""


@dataclass(frozen=True)
class GridSeen:
    """History of the grid up to the present step."""

    #: Outages so far; the last one lasts if the present step is one of it.
    outages: tuple[SeenOutage, ...] = ()
    #: Largest import when there was grid last; it is taken to stay as it is.
    import_kw: float = np.inf

    @property
    def out(self) -> bool:
        """Whether the present step is one of an outage."""
        return bool(self.outages) and self.outages[-1].lasts

    def after(self, time: pd.Timestamp, limit_kw: float) -> GridSeen:
        """History after another step: its beginning, and its largest import.

        >>> noon = pd.Timestamp("2022-07-19T12:00Z")
        >>> GridSeen().after(noon, 0.0).out
        True
        """
        dark = limit_kw <= 0.0
        if dark and not self.out:
            return replace(self, outages=(*self.outages, SeenOutage(time)))
        if self.out and not dark:
            over = replace(self.outages[-1], end=time)
            return GridSeen((*self.outages[:-1], over), limit_kw)
        return self if dark else replace(self, import_kw=limit_kw)


def grid_history(scenario: Scenario) -> list[GridSeen]:
    """History of the grid up to each step of a day."""
    steps = zip(scenario.grid.times, scenario.grid_limit_kw.tolist(), strict=True)
    found = accumulate(steps, lambda seen, now: seen.after(*now), initial=GridSeen())
    return list(found)[1:]


@dataclass(frozen=True, eq=False)
class Beside:
    """Import prices before the window, and announced import limits in it."""

    prices_gbp_per_kwh: Floats  #: import prices of the steps before, (n,)
    #: Largest import of the steps while there is grid, as it was announced, (T,) or (0,); NaN where
    #: no message announced any, and the one of now is taken to stay.
    limits_kw: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, scenario: Scenario, row: int) -> Beside:
        """A scenario's prices before a step."""
        return cls(scenario.price_gbp_per_kwh[:row])

    def import_kw(self, steps: int, now_kw: float) -> Floats:
        """Largest import of the first steps while there is grid, (steps,)."""
        found = np.full(steps, now_kw)
        said = self.limits_kw[:steps]
        found[: len(said)] = np.where(np.isnan(said), now_kw, said)
        return found


@dataclass(frozen=True, eq=False)
class OutageView:
    """View of outages that a controller gets."""

    kind: str  #: the option ``outages``
    outlook: OutageOutlook  #: turns warnings and statistics into beliefs
    gbp_per_kwh_lost: float  #: value of lost load
    soc_end: float | None = None  #: state of charge that batteries keep at the end
    #: Share of a grid-forming battery's inverter that an outage leaves free, 0 in the paper's mode.
    headroom: float = 0.0
    #: The site with its tiers in strict order; None where they are weighed.
    ranked: Site | None = None

    @classmethod
    def create(cls, scenario: Scenario, options: Mapping[str, Any]) -> OutageView:
        """View of outages by the options of a run, as they are recorded."""
        statistics = scenario.outage_statistics
        return cls(
            kind=str(options.get("outages") or KNOWN),
            outlook=OutageOutlook(scenario.warnings, statistics, scenario.grid.dt_h),
            gbp_per_kwh_lost=Statistics.of(statistics).value_of_lost_load_gbp_per_kwh,
            soc_end=options.get("soc_end"),
            headroom=float(options.get("headroom", 0.0))
            if options.get("mode") == PHYSICAL
            else 0.0,
            ranked=site_of(scenario, options) if options.get("priority") == STRICT else None,
        )

    def told(
        self,
        seen: Observation,
        grid: GridSeen,
        scenario: Scenario,
        row: int,
        forecaster: DayForecasts,
        beside: Beside | None = None,
    ) -> Observation:
        """An observation without what cannot be known.

        The forecaster's are forecasts of the scenario's steps, of which the present one is at
        ``row``. ``beside`` is what is known beside them: by default the steps before them.
        """
        if self.kind == KNOWN:
            return seen
        beside = beside or Beside.of(scenario, row)
        window = range(row, row + len(seen.forecast.price_gbp_per_kwh))
        if self.kind == "none":
            out = np.full(len(window), grid.out)
            return _with_probable_outages(seen, scenario, window, out, grid, beside)
        n_ahead = min(
            max(scenario.grid.steps_in_horizon(LOOKAHEAD_H), len(window)),
            scenario.grid.n_steps - row,
        )
        belief = self.outlook.at(scenario.grid.times[row], n_ahead, grid.outages)
        told = _with_probable_outages(
            seen, scenario, window, belief.likely[: len(window)], grid, beside
        )
        told = replace(
            told,
            outage_messages=belief.words,
            guessed=not belief.certain,
            ends=seen.ends and belief.certain,
            open_ended=not belief.certain,
        )
        if self.kind == LIKELY or belief.certain or not len(scenario.batteries):
            return told
        ahead = forecaster.at(row, range(row, row + n_ahead))
        import_kw = beside.import_kw(n_ahead, grid.import_kw)
        power_kw = scenario.batteries.active_max_kw
        eta_discharge = float(power_kw @ seen.eta_discharge / power_kw.sum())
        stores = {
            kind: known.store(scenario, range(row, row + n_ahead), eta_discharge)
            for kind, known in seen.ahead.by_kind.items()
        }
        expected = self._ahead(
            scenario, slice(row, row + n_ahead), ahead, import_kw, belief.out, stores
        )
        value = self._value(told, belief, scenario, expected, ahead, beside, stores)
        # A value that is no number says nothing: the likely future is left.
        return replace(told, stored_value=value) if np.isfinite(value.service).all() else told

    def _ahead(
        self,
        scenario: Scenario,
        rows: slice,
        ahead: Forecast,
        import_kw: Floats,
        out: bool,
        stores: Stores,
    ) -> Ahead:
        """Expected demand, power and prices of the steps.

        With grid stored energy is weighed against money, and customers by what they lose. Without
        it is weighed against customers, and strict order holds.
        """
        steps = len(ahead.price_gbp_per_kwh)
        weight, objective = scenario.customers.weight, scenario.objective
        if out and self.ranked:
            weight, objective = self.ranked.customers.weight, self.ranked.weights
        return Ahead(
            load_kw=ahead.load_kw,
            pv_kw=ahead.pv_kw.sum(axis=1),
            price_gbp_per_kwh=ahead.price_gbp_per_kwh,
            import_kw=import_kw,
            export=Export.of(scenario, rows, np.full(steps, np.inf)),
            weight=weight,
            lambda_curt=objective.lambda_curt,
            dt_h=scenario.grid.dt_h,
            delivered_kwh=sum(
                (one.delivered_kwh for one in stores.values()), start=np.zeros(steps)
            ),
        )

    def _value(
        self,
        seen: Observation,
        belief: OutageBelief,
        scenario: Scenario,
        expected: Ahead,
        ahead: Forecast,
        beside: Beside,
        stores: Stores,
    ) -> StoredValue:
        """Value of energy behind the present step."""
        fleet = self._fleet(scenario, seen, stores)
        end = Terminal.of(self.soc_end, ahead, ends=True)
        # An evening's own prices would keep energy that the next night sells for less.
        steps_before = max(round(DAY_H / scenario.grid.dt_h) - expected.n_steps, 0)
        before = beside.prices_gbp_per_kwh[len(beside.prices_gbp_per_kwh) - steps_before :]
        lowest = max(float(np.append(before, ahead.price_gbp_per_kwh).min()), 0.0)

        def end_gbp(energy_kwh: Floats) -> Floats:
            """Worth of energy behind the last step: at the day's lowest price, or the target's."""
            if end is None:
                return lowest / fleet.eta_charge * (energy_kwh - fleet.least_kwh)
            # What batteries are to hold is held besides all fuel.
            target_kwh = float(end.target_kwh(scenario.batteries).sum()) + fleet.fuel_kwh
            return end.price_gbp_per_kwh * np.minimum(energy_kwh - target_kwh, 0.0)

        return stored_value(belief, fleet, expected, self.gbp_per_kwh_lost, end_gbp)

    def _fleet(self, scenario: Scenario, seen: Observation, stores: Stores) -> EquivalentBattery:
        """All batteries as one, with their present efficiencies; the guard tells who is there."""
        b = scenario.batteries
        power_kw = b.active_max_kw
        share = power_kw / power_kw.sum()
        rating_kw = np.minimum(self.headroom * b.s_max_kva, power_kw)
        headroom_kw = np.where(forming_batteries(scenario), rating_kw, 0.0)
        eta_discharge = float(share @ seen.eta_discharge)
        reserve_kwh = headroom_kw.sum() * scenario.grid.dt_h / eta_discharge
        least_kwh = float(b.energy_kwh @ b.soc_min)
        most_kwh = float(b.energy_kwh @ b.soc_max)
        return EquivalentBattery(
            least_kwh=min(least_kwh + reserve_kwh, 0.5 * (least_kwh + most_kwh)),
            most_kwh=most_kwh,
            p_max_kw=float(power_kw.sum()),
            p_out_kw=float((power_kw - headroom_kw).sum()),
            eta_charge=float(share @ seen.eta_charge),
            eta_discharge=eta_discharge,
            sets_kw=sum((one.power_kw for one in stores.values()), 0.0),
            fuel_kwh=sum(
                (one.held_kwh + float(one.delivered_kwh.sum()) for one in stores.values()), 0.0
            ),
            kwh_each={kind: one.kwh_each for kind, one in stores.items()},
        )


def believed_outages(scenario: Scenario, options: Mapping[str, Any]) -> Floats:
    """Probability that each step is one of an outage, as it was known at each, (T, T).

    By the step at which it was known, then by the step that it is about; NaN for steps that were
    over, or too far ahead.
    """
    view = OutageView.create(scenario, options)
    times = scenario.grid.times
    T = scenario.grid.n_steps
    most = scenario.grid.steps_in_horizon(LOOKAHEAD_H)
    found = np.full((T, T), np.nan)
    for t, seen in enumerate(grid_history(scenario)):
        ahead = min(most, T - t)
        found[t, t : t + ahead] = view.outlook.at(times[t], ahead, seen.outages).out_probability
    return found


def _with_probable_outages(
    seen: Observation, scenario: Scenario, window: range, out: Flags, grid: GridSeen, beside: Beside
) -> Observation:
    """An observation with probable outages instead of the true limits behind the present step."""
    limit_kw = np.where(out, 0.0, beside.import_kw(len(window), grid.import_kw))
    limit_kw[0] = seen.forecast.grid_limit_kw[0]
    export = Export.of(scenario, slice(window.start, window.stop), limit_kw)
    forecast = replace(seen.forecast, grid_limit_kw=limit_kw, export=export)
    return replace(seen, forecast=forecast, ends=False, open_ended=True)
