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
from vppres.kinds.kind import Moment, UnitsNow
from vppres.kinds.table import TABLES, parts, units_of
from vppres.live.measurement import Measurement, Read
from vppres.live.past import Past
from vppres.live.state import Standing
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
    """One step between what was measured and what its set-points should lead to."""

    #: All that is measured and expected, NaN where a reading is missing; outages as the site's
    #: series have them. Duties and the units of each kind are those of the step's beginning.
    known: Observation
    #: The site in the steps of the window, with what was expected and measured in its place.
    scenario: Scenario
    ahead: Scenario  #: likewise, in all steps that the decision may rest on
    forecasts: DayForecasts
    beside: Beside
    past: Past
    kinds: dict[str, UnitsNow]
    grid_seen: GridSeen
    options: RunOptions
    closed: Flags  #: lines and ties that are closed, without a loop, (E,)
    connected: Flags  #: customers that can be supplied at all, (C,)
    #: Readings that are missing, frozen or of no device, and switches left open, in words.
    estimated: tuple[str, ...]

    @classmethod
    def of(
        cls,
        measured: Measurement,
        at: Standing,
        window: range,
        ahead: range,
        options: RunOptions,
        past_days: dict[str, Any],
    ) -> Present:
        """The step of a measurement, which is laid over all that is known of the site.

        Rows of the ``window`` are forecast, the decision may rest on those ``ahead`` in any way.
        Nothing of what is measured is trusted: a guard estimates what is missing, otherwise it is
        refused.

        Raises
        ------
        InputError
            With every value that does not fit the scenario.
        """
        site, past, row = at.known, at.past, window.start
        t = row + at.forgotten
        read = Read.of(measured, site, options.guard, past.t - at.forgotten, past.kinds)
        now, beyond = (_to_come(_without_gaps(read.series, site), rows) for rows in (window, ahead))
        beyond = replace(beyond, history=past.history)
        own = forecasts_of(beyond, options, ForecastErrors())
        forecasts = GivenFirst(own, beyond, read.foretold["load_kw"], read.foretold["pv_kw"])
        forecast = _begun(forecasts.at(0, range(now.grid.n_steps)), read, row)
        served = np.ones(len(read.connected), dtype=bool) if past.served is None else past.served
        begins = Moment(site, row, served, t * now.grid.dt_h + read.seen["elapsed_h"], now)
        kinds = _kinds_now(begins, read, past)
        closed, left_open = _configuration(now, read.switches, past.closed)
        known = Observation(
            t,
            forecast,
            **read.seen,
            **past.known_at(t),
            ahead=_kinds_ahead(now, kinds, past_days),
            flexible_kw=None if past.t < 0 else sum((k.taken_kw for k in kinds.values()), 0.0),
            flexible_off_kw=sum((k.taken_off_kw for k in kinds.values()), 0.0),
            terminal=Terminal.of(options.soc_end, forecast, ends=window.stop == site.grid.n_steps),
            profile_kw=site.load_kw[row] * read.connected,
            profile_pv_kw=site.pv_kw[row],
            closed=closed,
        )
        words = (word for units in kinds.values() for word in units.estimated)
        return cls(
            known,
            scenario=now,
            ahead=beyond,
            forecasts=forecasts,
            beside=Beside(site.price_gbp_per_kwh[:row], read.announced_kw[row:]),
            past=past,
            kinds=kinds,
            grid_seen=past.grid_seen.after(now.grid.start, float(now.grid_limit_kw[0])),
            options=options,
            closed=closed,
            connected=read.connected,
            estimated=(*read.left_out, *left_open, *words),
        )

    def observation(self, view: OutageView) -> Observation:
        """Observation of the controller, of outages by way of ``view``."""
        return view.told(self.known, self.grid_seen, self.ahead, 0, self.forecasts, self.beside)

    def day(self, known: Observation, estimated: str = "") -> Day:
        """A day that stands at the step, what the controller took for true being true.

        Its first step carries out the decision. Batteries that the decision ``estimated`` to be out
        have no power: they form no grid.
        """
        of_step = known.forecast
        scenario = replace(
            self.scenario,
            load_kw=_first_row(self.scenario.load_kw, of_step.load_kw[0]),
            pv_kw=_first_row(self.scenario.pv_kw, of_step.pv_kw[0]),
        )
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
        day.plant.switching = self.known.switching
        day.plant.owed = self.known.owed
        if np.array_equal(self.closed, self.past.closed):
            day.ac.go_on_from(self.past.voltages)
        day.plant.begin_with(_states(self.kinds))
        return day

    def after(self, day: Day, record: StepRecord) -> Past:
        """State of a :meth:`day` after its first step, from which the next step goes on."""
        believed, known = day.scenario, self.known
        load_kw, pv_kw = known.forecast.load_kw[0], known.forecast.pv_kw[0]
        return Past(
            t=known.t0,
            operating_point=day.operating_point,
            switching=day.plant.switching,
            served=record.customers["served"],
            history=self.past.with_measured(  # what was not read, or cannot be, is NaN
                believed.grid.times[0],
                np.where(np.isnan(load_kw) | ~self.connected, np.nan, believed.load_kw[0]),
                np.where(np.isnan(pv_kw), np.nan, believed.pv_kw[0]),
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


def _configuration(
    now: Scenario, read: dict[str, bool], before: Flags
) -> tuple[Flags, tuple[str, ...]]:
    """Lines and ties that are closed without a loop, (E,), and switches left open, in words."""
    branches = Branches.of(now)
    out = out_of_branches(now.out_of_service(range(1)), branches.ends)[0]
    return branches.with_states(read if now.follows_switches else {}, before, out)


def _states(kinds: dict[str, UnitsNow]) -> dict[str, Any]:
    """State of each kind at the beginning of the step."""
    return {kind: now.state for kind, now in kinds.items()}


def _kinds_now(begins: Moment, read: Read, past: Past) -> dict[str, UnitsNow]:
    """Units of each kind at the beginning of the step."""
    live = parts("live")
    return {
        kind: live[kind].now(begins, read.of_kinds[kind], past.kinds.get(kind))
        for kind in units_of(begins.window)
    }


def _kinds_ahead(
    day: Scenario, kinds: dict[str, UnitsNow], past_days: dict[str, Any]
) -> KindsAhead:
    """The window of each kind, without units that are out."""
    found = KindsAhead.of(day, range(day.grid.n_steps), _states(kinds), past_days)
    return KindsAhead({kind: kinds[kind].able(of) for kind, of in found.by_kind.items()})


def _without_gaps(read: Scenario, site: Scenario) -> Scenario:
    """The site as it was read, with its own series where a reading is missing."""
    return replace(
        read,
        load_kw=np.where(np.isnan(read.load_kw), site.load_kw, read.load_kw),
        pv_kw=np.where(np.isnan(read.pv_kw), site.pv_kw, read.pv_kw),
    )


def _to_come(scenario: Scenario, rows: range) -> Scenario:
    """The scenario in some steps alone, of which the first is the present one."""
    found = scenario.between(rows.start, rows.stop)
    now = found.grid.start
    return replace(found, **{name: getattr(found, name).to_come(now) for name in TABLES})


def _begun(forecast: Forecast, read: Read, row: int) -> Forecast:
    """A forecast that begins with what was measured; who is cut off takes nothing."""
    load_kw = _first_row(forecast.load_kw, read.series.load_kw[row])
    return replace(
        forecast,
        load_kw=np.where(read.connected, load_kw, 0.0),
        pv_kw=_first_row(forecast.pv_kw, read.series.pv_kw[row]),
    )


def _first_row(rows: Floats, row: Floats) -> Floats:
    return np.vstack([row, rows[1:]])
