"""The step that is decided now: what may be known of it, and what its set-points lead to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import batteries_out
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.switching import SwitchingState
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Floats
from vppres.day.forecasting import Forecasts, forecasts_of
from vppres.day.options import RunOptions
from vppres.day.outages import Beside, GridSeen, OutageView
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.kinds.cooling.live import Felt, Indoor
from vppres.kinds.gensets.live import Ran, SetsNow, after
from vppres.kinds.gensets.physics import SetsAhead
from vppres.kinds.vehicles.live import Held
from vppres.kinds.vehicles.past_days import PastDays
from vppres.kinds.vehicles.physics import Garage
from vppres.live.foretold import GivenFirst
from vppres.live.measurement import Seen
from vppres.live.past import Past
from vppres.physics.cold_load import ColdLoad
from vppres.plant.plant import BatteryState
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Present:
    """One step between what was measured and what its set-points should lead to.

    ``t`` counts from the controller's first step. The steps of the window are in ``seen``, itself
    the first; the decision may rest on all that are ``ahead``. ``ends``: what is known ends with
    the window. Duties, cold load, rooms and sets are those of its beginning.
    """

    t: int
    seen: Seen
    ahead: Scenario
    beside: Beside
    ends: bool
    past: Past
    switching: SwitchingState | None
    cold_load: ColdLoad
    indoor: Indoor
    sets: SetsNow
    grid_seen: GridSeen
    options: RunOptions
    past_days: PastDays | None

    @classmethod
    def of(
        cls,
        t: int,
        everything: Seen,
        known: Scenario,
        window: range,
        ahead: range,
        past: Past,
        options: RunOptions,
        past_days: PastDays | None,
    ) -> Present:
        """The step of a measurement, which is laid over everything that is ``known``.

        Rows of the ``window`` are forecast, the decision may rest on those ``ahead`` in any way.
        """
        beyond, seen = (_with_later_refuels(everything.window(part)) for part in (ahead, window))
        switching, cold_load = past.held_until(t)
        now = seen.scenario
        now_h = t * now.grid.dt_h + seen.elapsed_h
        felt = past.felt_at(t, known, everything.t)
        return cls(
            t=t,
            seen=seen,
            ahead=replace(beyond.scenario, history=past.history),
            beside=Beside(known.price_gbp_per_kwh[: everything.t], beyond.announced_kw),
            ends=window.stop == known.grid.n_steps,
            past=past,
            switching=switching,
            cold_load=cold_load,
            indoor=Indoor.of(now.thermal_loads.id, seen.indoor_c, felt),
            sets=past.sets_at(seen.sets, now_h, known, everything.t),
            grid_seen=past.grid_seen.after(now.grid.start, float(now.grid_limit_kw[0])),
            options=options,
            past_days=past_days,
        )

    def observation(self, view: OutageView) -> Observation:
        """What the controller knows, of outages by way of ``view``."""
        forecasts = GivenFirst.of(
            forecasts_of(self.ahead, self.options, ForecastErrors()), self.ahead, self.seen
        )
        measured = self._measured(forecasts)
        return view.told(measured, self.grid_seen, self.ahead, 0, forecasts, self.beside)

    def _measured(self, forecasts: Forecasts) -> Observation:
        """What was measured, and the forecast of the window."""
        seen = self.seen
        forecast = forecasts.at(0, range(seen.scenario.grid.n_steps))
        b = seen.scenario.batteries
        return Observation(
            self.t,
            _beginning_with(seen, forecast),
            seen.soc if self.options.guard else np.clip(seen.soc, b.soc_min, b.soc_max),
            seen.eta_charge,
            seen.eta_discharge,
            self.past.operating_point,
            self.switching,
            battery_kw=seen.battery_kw,
            online=seen.online,
            import_kw=seen.import_kw,
            served=self.past.served,
            owed=self.past.owed_at(self.t),
            ahead=self._ahead(),
            terminal=Terminal.of(self.options.soc_end, forecast, ends=self.ends),
            elapsed_h=seen.elapsed_h,
            soc_age_h=seen.soc_age_h,
            told=seen.told,
            profile_kw=seen.profile_kw,
            profile_pv_kw=seen.profile_pv_kw,
            **self._flexible(),
        )

    def _flexible(self) -> dict[str, Any]:
        """What flexible power took in the step before, by meters of sets and what others were to.

        Nothing before the first step.
        """
        past, told_kw = self.past, self.seen.sets.power_kw
        if past.flexible_kw is None or past.flexible_off_kw is None or past.sets is None:
            return {}
        unread = np.isnan(told_kw)
        gave_kw = np.where(unread, past.sets.power_kw, told_kw)
        return {
            "flexible_kw": past.flexible_kw - float(gave_kw.sum()),
            "flexible_off_kw": past.flexible_off_kw + float(past.sets.power_kw[unread].sum()),
        }

    def _ahead(self) -> KindsAhead:
        """Vehicles, rooms and sets as they are."""
        day = self.seen.scenario
        states = {**self._states(), "chargers": Garage(day, self._ev_kwh()).at(0)}
        found = KindsAhead.of(day, range(day.grid.n_steps), states, self.past_days)
        sets = found.find(SetsAhead)
        return found if sets is None else found.with_window(self.sets.without_those_out(sets))

    def _states(self) -> dict[str, Any]:
        """State of each kind at the beginning of the step."""
        return {
            "chargers": self._ev_kwh(),
            "thermal_loads": self.indoor.now_c,
            "gensets": self.sets.state,
        }

    def _ev_kwh(self) -> Floats:
        """Energy of the vehicles, as read or else as reckoned; NaN if neither, (K,)."""
        kwh, past = self.seen.ev_kwh, self.past.vehicles
        if past is None:
            return kwh
        return np.where(np.isnan(kwh), past.at(self.seen.scenario, 0), kwh)

    def day(self, known: Observation, estimated: str = "") -> Day:
        """A day that stands at the step, what the controller took for true being true.

        Its first step carries out the decision. It owns the step's cold load and advances it.
        Batteries that the decision ``estimated`` to be out have no power: they form no grid.
        """
        scenario = self.seen.believed(known.forecast.load_kw[0], known.forecast.pv_kw[0])
        batteries = scenario.batteries
        out = batteries_out(estimated, batteries.id)
        if out.any():
            p_max_kw = np.where(out, 0.0, batteries.p_max_kw)
            scenario = replace(scenario, batteries=replace(batteries, p_max_kw=p_max_kw))
        if self.sets.out.any():  # nor do they start by themselves
            forming = scenario.gensets.grid_forming & ~self.sets.out
            scenario = replace(scenario, gensets=replace(scenario.gensets, grid_forming=forming))
        day = Day(scenario, self.options)
        t_ref_c = scenario.batteries.t_ref_c
        day.state = BatteryState(known.soc, known.eta_charge, known.eta_discharge, t_ref_c)
        day.outage_messages = known.outage_messages
        day.switching = self.switching
        day.owed = self.past.owed_at(self.t)
        day.ac.go_on_from(self.past.voltages)
        day.plant.cold_load = self.cold_load
        day.plant.begin_with(self._states())
        return day

    def after(self, day: Day, record: StepRecord) -> Past:
        """What the next step goes on from: a :meth:`day` after its first step, and that step."""
        taken_kw = {
            kind: columns["p_kw"] for kind, columns in record.kinds.items() if kind != "gensets"
        }
        return Past(
            t=self.t,
            operating_point=day.operating_point,
            switching=day.switching,
            cold_load=day.plant.cold_load,
            served=record.customers["served"],
            history=self._learned(day.scenario),
            voltages=day.ac.found,
            grid_seen=self.grid_seen,
            owed=day.owed,
            vehicles=Held.of(day.scenario, 0, day.plant.of(Garage).state),
            rooms=self._felt_after(day, record),
            sets=self._told(record),
            flexible_kw=float(sum(kw.sum() for kw in taken_kw.values())),
            flexible_off_kw=float(np.abs(taken_kw.get("chargers", 0.0)).sum())
            + float(day.scenario.thermal_loads.p_max_kw.sum()),
        )

    def _told(self, record: StepRecord) -> Ran:
        """How generating sets are to run from now on."""
        columns = record.kinds.get("gensets")
        if columns is None:
            return self.sets.told(np.empty(0, dtype=bool), np.empty(0))
        return self.sets.told(columns["running"], columns["p_kw"])

    def _felt_after(self, day: Day, record: StepRecord) -> Felt:
        """Rooms and tanks after the step, as far as their readings moved."""
        columns = record.kinds.get("thermal_loads")
        power_kw = np.empty(0) if columns is None else columns["p_kw"]
        return self.indoor.after(day.scenario, power_kw)

    def _learned(self, believed: Scenario) -> History | None:
        """The history with what was read; what was not, or cannot be read, is NaN."""
        seen = self.seen
        unread_load = np.isnan(seen.load_kw) | ~seen.connected
        return self.past.with_measured(
            believed.grid.times[0],
            np.where(unread_load, np.nan, believed.load_kw[0]),
            np.where(np.isnan(seen.pv_kw), np.nan, believed.pv_kw[0]),
        )


def _with_later_refuels(seen: Seen) -> Seen:
    """A measurement without deliveries that are in the tanks already."""
    day = seen.scenario
    if not len(day.refuels):
        return seen
    return replace(seen, scenario=replace(day, refuels=after(day.refuels, day)))


def _beginning_with(seen: Seen, forecast: Forecast) -> Forecast:
    """A forecast whose first step is what was measured; who is cut off takes nothing."""
    return replace(
        forecast,
        load_kw=_first_row(forecast.load_kw * seen.connected, seen.load_kw),
        pv_kw=_first_row(forecast.pv_kw, seen.pv_kw),
    )


def _first_row(rows: Floats, row: Floats) -> Floats:
    return np.vstack([row, rows[1:]])
