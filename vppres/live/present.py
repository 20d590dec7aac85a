"""The step that is decided now: what may be known of it, and what its set-points lead to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import batteries_out
from vppres.contract.forecast import Forecast, ForecastErrors
from vppres.contract.observation import Observation
from vppres.contract.terminal import Terminal
from vppres.core.arrays import Flags, Floats
from vppres.day.forecasting import DayForecasts, forecasts_of
from vppres.day.options import RunOptions
from vppres.day.outages import Beside, GridSeen, OutageView
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.kinds.customer.physics import SwitchingState
from vppres.kinds.kind import Moment, UnitsNow
from vppres.kinds.table import parts, units_of
from vppres.live.measurement import Seen
from vppres.live.past import Past
from vppres.plant.plant import BatteryState
from vppres.scenario.configuration import Branches, out_of_branches
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class GivenFirst:
    """A forecaster's forecasts, but for the series that another provider foretold."""

    own: DayForecasts
    scenario: Scenario
    load: Flags
    pv: Flags

    @classmethod
    def of(cls, own: DayForecasts, scenario: Scenario, seen: Seen) -> DayForecasts:
        """The forecaster's alone where there is no other provider."""
        if not (seen.foretold_load.any() or seen.foretold_pv.any()):
            return own
        return cls(own, scenario, seen.foretold_load, seen.foretold_pv)

    def at(self, t0: int, steps: range) -> Forecast:
        """Forecast at the beginning of step ``t0``."""
        found = self.own.at(t0, steps)
        rows = slice(steps.start, steps.stop)
        return replace(
            found,
            load_kw=np.where(self.load, self.scenario.load_kw[rows], found.load_kw),
            pv_kw=np.where(self.pv, self.scenario.pv_kw[rows], found.pv_kw),
        )


@dataclass(frozen=True, eq=False)
class Present:
    """One step between what was measured and what its set-points should lead to.

    ``t`` counts from the controller's first step. The steps of the window are in ``seen``, itself
    the first; the decision may rest on all that are ``ahead``. Lines and ties that are ``closed``,
    (E,), have no loop; ``left_open`` says why others are not. ``ends``: what is known ends
    with the window. Duties and the units of each kind are those of its beginning.
    """

    t: int
    seen: Seen
    ahead: Scenario
    beside: Beside
    ends: bool
    past: Past
    switching: SwitchingState
    kinds: dict[str, UnitsNow]
    grid_seen: GridSeen
    options: RunOptions
    past_days: dict[str, Any]
    closed: Flags
    left_open: tuple[str, ...]

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
        past_days: dict[str, Any],
    ) -> Present:
        """The step of a measurement, which is laid over everything that is ``known``.

        Rows of the ``window`` are forecast, the decision may rest on those ``ahead`` in any way.
        """
        beyond, seen = everything.window(ahead), everything.window(window)
        now = seen.scenario
        row, at_h = everything.t, t * now.grid.dt_h + seen.elapsed_h
        served = np.ones(len(now.customers), dtype=bool) if past.served is None else past.served
        moment = Moment(known, row, served, at_h, now)
        live = parts("live")
        branches = Branches.of(now)
        read = everything.closed if now.follows_switches else {}
        out = out_of_branches(now.out_of_service(range(1)), branches.ends)[0]
        closed, left_open = branches.with_states(read, past.closed, out)
        return cls(
            t=t,
            seen=seen,
            ahead=replace(beyond.scenario, history=past.history),
            beside=Beside(known.price_gbp_per_kwh[: everything.t], beyond.announced_kw),
            ends=window.stop == known.grid.n_steps,
            past=past,
            switching=past.switching_at(t),
            kinds={
                kind: live[kind].now(moment, seen.kinds[kind], past.kinds.get(kind))
                for kind in units_of(now)
            },
            grid_seen=past.grid_seen.after(now.grid.start, float(now.grid_limit_kw[0])),
            options=options,
            past_days=past_days,
            closed=closed,
            left_open=left_open,
        )

    def observation(self, view: OutageView) -> Observation:
        """Observation of the controller, of outages by way of ``view``."""
        forecasts = GivenFirst.of(
            forecasts_of(self.ahead, self.options, ForecastErrors()), self.ahead, self.seen
        )
        measured = self._measured(forecasts)
        return view.told(measured, self.grid_seen, self.ahead, 0, forecasts, self.beside)

    def _measured(self, forecasts: DayForecasts) -> Observation:
        """Observation of the measurements, with the forecast of the window."""
        seen = self.seen
        forecast = forecasts.at(0, range(seen.scenario.grid.n_steps))
        b, kinds = seen.scenario.batteries, self.kinds.values()
        return Observation(
            self.t,
            replace(  # it begins with what was measured; who is cut off takes nothing
                forecast,
                load_kw=_first_row(forecast.load_kw * seen.connected, seen.load_kw),
                pv_kw=_first_row(forecast.pv_kw, seen.pv_kw),
            ),
            seen.soc if self.options.guard else np.clip(seen.soc, b.soc_min, b.soc_max),
            seen.eta_charge,
            seen.eta_discharge,
            self.switching,
            self.past.owed_at(self.t),
            seen.online,
            operating_point=self.past.operating_point,
            battery_kw=seen.battery_kw,
            import_kw=seen.import_kw,
            served=self.past.served,
            ahead=self._ahead(),
            terminal=Terminal.of(self.options.soc_end, forecast, ends=self.ends),
            elapsed_h=seen.elapsed_h,
            soc_age_h=seen.soc_age_h,
            told=seen.told,
            profile_kw=seen.profile_kw,
            profile_pv_kw=seen.profile_pv_kw,
            flexible_kw=None if self.past.t < 0 else sum((k.taken_kw for k in kinds), 0.0),
            flexible_off_kw=sum((k.taken_off_kw for k in kinds), 0.0),
            closed=self.closed,
            whole=None if seen.dimmable.all() else ~seen.dimmable,
        )

    def _ahead(self) -> KindsAhead:
        """The window of each kind, without units that are out."""
        day = self.seen.scenario
        found = KindsAhead.of(day, range(day.grid.n_steps), self._states(), self.past_days)
        return KindsAhead({kind: self.kinds[kind].able(of) for kind, of in found.by_kind.items()})

    def _states(self) -> dict[str, Any]:
        """State of each kind at the beginning of the step."""
        return {kind: now.state for kind, now in self.kinds.items()}

    @property
    def estimated(self) -> tuple[str, ...]:
        """Readings of all kinds that are missing or frozen, and switches left out, in words."""
        return (*self.left_open, *(words for now in self.kinds.values() for words in now.estimated))

    def day(self, known: Observation, estimated: str = "") -> Day:
        """A day that stands at the step, what the controller took for true being true.

        Its first step carries out the decision. Batteries that the decision ``estimated`` to be out
        have no power: they form no grid.
        """
        scenario = self.seen.believed(known.forecast.load_kw[0], known.forecast.pv_kw[0])
        batteries = scenario.batteries
        out = batteries_out(estimated, batteries.id)
        if out.any():
            p_max_kw = np.where(out, 0.0, batteries.p_max_kw)
            scenario = replace(scenario, batteries=replace(batteries, p_max_kw=p_max_kw))
        for now in self.kinds.values():
            scenario = now.believed(scenario)
        day = Day(scenario, self.options)
        day.go_on_in(self.closed)
        t_ref_c = scenario.batteries.t_ref_c
        day.state = BatteryState(known.soc, known.eta_charge, known.eta_discharge, t_ref_c)
        day.outage_messages = known.outage_messages
        day.plant.switching = self.switching
        day.plant.owed = self.past.owed_at(self.t)
        if np.array_equal(self.closed, self.past.closed):
            day.ac.go_on_from(self.past.voltages)
        day.plant.begin_with(self._states())
        return day

    def after(self, day: Day, record: StepRecord) -> Past:
        """State of a :meth:`day` after its first step, from which the next step goes on."""
        believed = day.scenario
        seen = self.seen
        unread_load = np.isnan(seen.load_kw) | ~seen.connected
        return Past(
            t=self.t,
            operating_point=day.operating_point,
            switching=day.plant.switching,
            served=record.customers["served"],
            history=self.past.with_measured(  # what was not read, or cannot be, is NaN
                believed.grid.times[0],
                np.where(unread_load, np.nan, believed.load_kw[0]),
                np.where(np.isnan(seen.pv_kw), np.nan, believed.pv_kw[0]),
            ),
            voltages=day.ac.found,
            closed=self.closed,
            grid_seen=self.grid_seen,
            owed=day.plant.owed,
            kinds={
                kind: now.after(day.scenario, day.plant.state_of(kind), record.kinds[kind])
                for kind, now in self.kinds.items()
            },
        )


def _first_row(rows: Floats, row: Floats) -> Floats:
    return np.vstack([row, rows[1:]])
