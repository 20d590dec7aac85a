"""Measurements and expectations of your own plant, laid over a scenario's series."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.observation import Told
from vppres.core.arrays import Flags, Floats, Names
from vppres.core.errors import InputError, VppresError
from vppres.kinds.live_fields import ReadOfKinds
from vppres.kinds.table import TABLES, parts
from vppres.live.door import HOUR, WHERE, Door, readable
from vppres.live.ranges import ranges_of
from vppres.scenario.assets import Batteries
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

Values = Mapping[str, float] | pd.Series  # by identifier
Switches = Mapping[str, bool] | pd.Series  # by identifier


@dataclass(frozen=True, eq=False)
class Measurement(ReadOfKinds):
    """State at the beginning of a step: measured now, expected for the steps ahead.

    Only the time must be given. What is not given of the series is what the scenario says, so that
    a scenario can serve as the forecast of a day; what is missing of the measurements is estimated
    by the guard (``docs/operation.md``). A number that no device can have counts as missing, and is
    named in what was estimated.

    Parameters
    ----------
    time : pandas.Timestamp, datetime or str
        Beginning of the step to decide on, with time zone; one of the scenario's steps. Text is ISO
        8601 with an offset. Steps are decided in order; the last one may be decided again.
    soc : mapping or Series, optional
        State of charge of every battery by its identifier, as a share of its capacity. What lies
        outside the battery's limits counts as the limit, and more than 0.05 outside as missing.
    load_kw, pv_kw : mapping, Series or DataFrame, optional
        Demand of customers and available power of PV systems in kW, by identifier. A mapping or
        Series is the current step; a DataFrame has one row per time (its index) and one column per
        identifier. PV power above a system's rating counts as the rating. NaN, or a negative value,
        is a missing reading; only the current step can miss one.
    price_gbp_per_kwh, grid_limit_kw : float or Series, optional
        Import price in GBP/kWh and largest import in kW (0 in an outage): a number for the current
        step, or a Series by time.
    export_limit_kw, export_price_gbp_per_kwh : float or Series, optional
        Largest export in kW, which is 0 in an outage whatever it says, and what it earns in
        GBP/kWh; likewise.
    eta_charge, eta_discharge : mapping or Series, optional
        Measured efficiencies by identifier; nominal where not given.
    battery_kw : mapping or Series, optional
        Mean power of each battery since the last step in kW, by identifier, positive where charged.
        Without it set-points count as followed, and a frozen state of charge is not noticed.
    online : mapping or Series of bool, optional
        Whether each battery reports to be able to work; all that are not named do.
    import_kw : float, optional
        Mean import since the last step in kW, losses included, negative where exported. With
        ``battery_kw`` of all batteries it shows frozen readings of demand and PV power.
    connected : mapping or Series of bool, optional
        Whether each customer can be supplied at all; all that are not named can. Who cannot takes
        nothing in the whole window, and is not served.
    dimmable : mapping or Series of bool, optional
        Whether each customer that the scenario dims can be dimmed now; all that are not named can.
        Who cannot gets all of its demand in the window or nothing.
    closed : mapping or Series of bool, optional
        Whether each switch is closed, by identifier; where not given as at the last decision, as in
        the scenario before the first. Plans are of the feeder in this configuration; a switch that
        closes a loop is left open in them, and named in what was estimated.
    announced_limit_kw : Series, optional
        Largest import in kW by time while there is grid, as it is known beforehand. It says nothing
        of outages, and so reaches controllers that do not know them otherwise; where it says
        nothing the limit of now is taken to stay.
    now : pandas.Timestamp, datetime or str, optional
        The moment, where a step that was decided is decided anew for the rest of it; its beginning
        if not given. States are those of then, and means those since the last decision.
    soc_at : mapping or Series, optional
        When each state of charge was read; now, if not given. What was stored since is added: by
        ``battery_kw`` where it is given, else by what was ordered.
    plugged : mapping or Series, optional
        Whether a vehicle is plugged in at each charger, 1 or 0; as the scenario's sessions say if
        not given. A vehicle that is gone before its departure is named in what was estimated.
    ev_soc : mapping or Series, optional
        State of charge of vehicles, by charger; reckoned from what was ordered if not given.
    energy_needed_kwh : mapping or Series, optional
        Energy that vehicles still need, by charger, of those that tell no state of charge.
    departure : mapping or Series, optional
        When vehicles leave, by charger; as the scenario's sessions say if not given.
    indoor_c : mapping or Series, optional
        Temperatures of rooms and tanks in °C, by thermal load; reckoned from the last readings and
        what was ordered if not given. A reading that stands still although the temperature must
        have moved is named in what was estimated, and not used.
    running : mapping or Series, optional
        Whether each generating set runs, 1 or 0; its set-point if not given. One with the set-point
        to run for a step and stands still is out.
    genset_kw : mapping or Series, optional
        Mean power of each set since the last step in kW; its set-point if not given.
    fuel_litres : mapping or Series, optional
        What is in each tank; the least that the line of fuel leaves if not given. A gauge that
        stands still although a twentieth of the tank must have been burnt is named in what was
        estimated, and not used.
    start_fault : mapping or Series, optional
        1 of a set that failed to start: it is out until 0 is given, or it runs.
    genset_ordered_kw : mapping or Series, optional
        The most that each set was ordered to give since the last decision, where that was not what
        was decided; 0 of one that was to stand still. ``running`` says what it does now.
    charger_ordered_kw, thermostat_ordered_c : mapping or Series, optional
        Mean power that chargers were ordered since the last decision, and what thermostats were
        set to last, where that was not what was decided.
    read_at : mapping, optional
        When vehicles, rooms, tanks and sets were read, by quantity and identifier; now, if not
        given. What their set-points changed since is added.
    ordered_kw : DataFrame, optional
        Set-points of batteries since the last decision, where these differ from it: a row
        for each time from which on it held, a column for each battery.

    Examples
    --------
    >>> now = Measurement("2022-07-19T13:00Z", soc={"b02": 0.5}, grid_limit_kw=0.0)
    >>> now.soc["b02"]
    0.5
    """

    time: pd.Timestamp | datetime | str
    soc: Values | None = None
    load_kw: Values | pd.DataFrame | None = None
    pv_kw: Values | pd.DataFrame | None = None
    price_gbp_per_kwh: float | pd.Series | None = None
    grid_limit_kw: float | pd.Series | None = None
    export_limit_kw: float | pd.Series | None = None
    export_price_gbp_per_kwh: float | pd.Series | None = None
    eta_charge: Values | None = None
    eta_discharge: Values | None = None
    battery_kw: Values | None = None
    online: Switches | None = None
    import_kw: float | None = None
    connected: Switches | None = None
    dimmable: Switches | None = None
    closed: Switches | None = None
    announced_limit_kw: pd.Series | None = None
    foretold: Mapping[str, Sequence[str]] | None = None
    now: pd.Timestamp | datetime | str | None = None
    soc_at: Mapping[str, Any] | pd.Series | None = None
    read_at: Mapping[str, Mapping[str, Any]] | None = None
    ordered_kw: pd.DataFrame | None = None


@dataclass(frozen=True, eq=False)
class Seen:
    """A measurement in arrays, by its own names; NaN where a reading is missing."""

    t: int  #: the step
    #: The scenario with what was expected in its place, and what was measured where that is
    #: anything.
    scenario: Scenario
    load_kw: Floats
    pv_kw: Floats
    soc: Floats
    eta_charge: Floats
    eta_discharge: Floats
    battery_kw: Floats | None
    online: Flags
    import_kw: float | None
    connected: Flags
    dimmable: Flags
    closed: dict[str, bool]  #: states of switches, as far as they were read
    #: Largest import while there is grid, as far as it was announced, (T,); NaN elsewhere.
    announced_kw: Floats
    #: Series whose steps ahead are another provider's forecast, (C,) and (P,).
    foretold_load: Flags
    foretold_pv: Flags
    left_out: tuple[str, ...]  #: readings that no device can have, in words; they count as missing
    elapsed_h: float  #: how much of the step is over
    soc_age_h: Floats  #: how old the states of charge are, (B,)
    #: Set-points of batteries since the last decision, where these differ from it.
    told: tuple[Told, ...]
    kinds: dict[str, Any]  #: readings of the units of each kind
    #: What the scenario says of demand and PV power in the step, (C,) and (P,).
    profile_kw: Floats
    profile_pv_kw: Floats

    def window(self, rows: range) -> Seen:
        """Measurements of some steps alone, of which the first is the present one."""
        scenario = self.scenario.between(rows.start, rows.stop)
        now = scenario.grid.start
        scenario = replace(
            scenario, **{name: getattr(scenario, name).to_come(now) for name in TABLES}
        )
        return replace(
            self,
            t=0,
            scenario=scenario,
            announced_kw=self.announced_kw[rows.start : rows.stop],
        )

    def believed(self, load_kw: Floats, pv_kw: Floats) -> Scenario:
        """The scenario with what is taken for true of the step, (C,) and (P,)."""
        return replace(
            self.scenario,
            load_kw=_with_row(self.scenario.load_kw, self.t, load_kw),
            pv_kw=_with_row(self.scenario.pv_kw, self.t, pv_kw),
        )


def see(
    scenario: Scenario,
    measured: Measurement,
    guard: bool = True,
    earliest: int = 0,
    before: Callable[[int, bool], Mapping[str, Any]] = lambda *_: {},
) -> Seen:
    """Lay a measurement over a scenario.

    Nothing of it is trusted: a ``guard`` estimates what is missing, otherwise it is refused.
    ``earliest`` is the first step that can still be decided; ``before`` gives the units as they
    were known before a step, or a moment within it, by kind.

    Raises
    ------
    InputError
        With every value that does not fit the scenario.
    """
    if not isinstance(measured, Measurement):
        raise InputError.of(
            WHERE,
            "is not a Measurement",
            "Give a vppres.Measurement.",
            field="observation",
            value=readable(measured),
        )
    try:
        return _measurement_arrays(scenario, measured, guard, earliest, before)
    except VppresError:
        raise
    except Exception as error:  # a mapping may come from any caller
        raise InputError.of(
            WHERE,
            f"cannot be read: {type(error).__name__}, {readable(error)}",
            "Give plain dictionaries, numbers, Series and DataFrames.",
        ) from error


def step_at(grid: TimeGrid, time: Any) -> int:
    """The step that begins at a time.

    Raises
    ------
    InputError
        If none does.
    """
    door = Door(grid, time)
    door.finish()
    return door.t


def _measurement_arrays(
    scenario: Scenario,
    measured: Measurement,
    guard: bool,
    earliest: int,
    before: Callable[[int, bool], Mapping[str, Any]],
) -> Seen:
    """The measurement, read; problems are listed in the order of the readings."""
    door = Door(scenario.grid, measured.time, guard, ranges=ranges_of(scenario))
    _check_order(door, measured, earliest)
    c, pv, b = scenario.customers, scenario.pv, scenario.batteries
    load_kw = door.table("load_kw", measured.load_kw, c.id, scenario.load_kw)
    pv_kw = door.table("pv_kw", measured.pv_kw, pv.id, scenario.pv_kw)
    of_grid = _grid_series(door, scenario, measured)
    of_batteries = _of_batteries(door, b, measured)
    import_kw = door.number("import_kw", measured.import_kw)
    connected = door.flags("connected", measured.connected, c.id)
    dimmable = door.flags("dimmable", measured.dimmable, c.id)
    closed = _states(door, measured.closed, scenario.switches.id)
    unknown = np.full(scenario.grid.n_steps, np.nan)
    announced = door.series("announced_limit_kw", measured.announced_limit_kw, unknown)
    now = door.moment("now", measured.now) or door.begun
    if not door.begun <= now < door.begun + door.grid.step:
        door.problem("now", "lies outside the step", "Give a time within it.", measured.now)
    soc_age_h = door.ages_h("soc_at", measured.soc_at, b.id, now)
    told = _overrides(door, measured.ordered_kw, b.id, now)
    if not guard:
        _check_complete(door, scenario, measured, of_batteries["soc"], of_batteries["online"])
    past, kinds = before(door.t, now > door.begun), {}
    for kind, live in parts("live").items():
        ids = getattr(scenario, kind).id
        of_kind = {name: getattr(measured, name) for name in live.RANGES}
        times = {name: (measured.read_at or {}).get(name) for name in live.RANGES}
        ages_h = {name: door.ages_h(f"read_at {name}", at, ids, now) for name, at in times.items()}
        scenario, kinds[kind] = live.read(door, scenario, of_kind, ages_h, past.get(kind))
    door.finish()
    pv_kw = np.clip(pv_kw, 0.0, pv.p_max_kw)
    foretold = measured.foretold or {}
    return Seen(
        t=door.t,
        scenario=replace(
            scenario,
            load_kw=np.where(np.isnan(load_kw), scenario.load_kw, load_kw) * connected,
            pv_kw=np.where(np.isnan(pv_kw), scenario.pv_kw, pv_kw),
            **of_grid,
        ),
        load_kw=np.where(connected, load_kw[door.t], 0.0),
        profile_kw=scenario.load_kw[door.t] * connected,
        profile_pv_kw=scenario.pv_kw[door.t],
        pv_kw=pv_kw[door.t],
        **of_batteries,
        import_kw=import_kw,
        connected=connected,
        dimmable=dimmable,
        closed=closed,
        announced_kw=announced,
        foretold_load=_is_named(c.id, foretold.get("load_kw", ())),
        foretold_pv=_is_named(pv.id, foretold.get("pv_kw", ())),
        left_out=tuple(door.left_out),
        elapsed_h=(now - door.begun) / HOUR,
        soc_age_h=soc_age_h,
        told=told,
        kinds=kinds,
    )


def _of_batteries(door: Door, b: Batteries, measured: Measurement) -> dict[str, Any]:
    """Readings of the batteries; a missing efficiency is the nominal one, no estimate is better."""
    unknown = np.full(len(b), np.nan)
    soc = door.values("soc", measured.soc, b.id, unknown)
    eta_charge = door.values("eta_charge", measured.eta_charge, b.id, b.eta_charge)
    eta_discharge = door.values("eta_discharge", measured.eta_discharge, b.id, b.eta_discharge)
    battery_kw = door.values("battery_kw", measured.battery_kw, b.id, unknown)
    return {
        "soc": soc,
        "eta_charge": np.where(np.isnan(eta_charge), b.eta_charge, eta_charge),
        "eta_discharge": np.where(np.isnan(eta_discharge), b.eta_discharge, eta_discharge),
        "battery_kw": None if measured.battery_kw is None else battery_kw,
        "online": door.flags("online", measured.online, b.id),
    }


def _states(door: Door, read: Any, ids: Names) -> dict[str, bool]:
    """States of the switches that were read."""
    closed = door.flags("closed", read, ids)
    given = set(read.keys()) if isinstance(read, (Mapping, pd.Series)) else set()
    return {str(name): bool(one) for name, one in zip(ids, closed, strict=True) if name in given}


def _grid_series(door: Door, scenario: Scenario, measured: Measurement) -> dict[str, Any]:
    """Prices and limits of the grid as measured, (T,) each; the scenario's where not given."""
    price = scenario.price_gbp_per_kwh
    limit = scenario.grid_limit_kw
    export_limit = np.broadcast_to(scenario.export_limit_kw, limit.shape)
    own = {
        "price_gbp_per_kwh": (measured.price_gbp_per_kwh, price),
        "grid_limit_kw": (measured.grid_limit_kw, limit),
        "export_limit_kw": (measured.export_limit_kw, export_limit),
        "export_price_gbp_per_kwh": (measured.export_price_gbp_per_kwh, scenario.export_price),
    }
    return {name: door.series(name, given, known) for name, (given, known) in own.items()}


def _is_named(ids: Names, named: Sequence[str]) -> Flags:
    """Whether each identifier is named."""
    chosen = set(named)
    return np.array([str(name) in chosen for name in ids], dtype=bool)


def _overrides(door: Door, ordered_kw: Any, ids: Names, now: pd.Timestamp) -> tuple[Told, ...]:
    """Set-points of batteries from times on, the earliest first."""
    if ordered_kw is None:
        return ()
    found = []
    for time, row in ordered_kw.iterrows():
        moment = door.moment("ordered_kw", time)
        power_kw = door.values("ordered_kw", row, ids, np.zeros(len(ids)))
        if moment is not None:
            found.append(Told(max((now - moment) / HOUR, 0.0), np.nan_to_num(power_kw)))
    return tuple(sorted(found, key=lambda one: -one.before_h))


def _check_order(door: Door, measured: Measurement, earliest: int) -> None:
    """Time does not go back: what happened since cannot be undone."""
    if 0 <= door.t < earliest:
        door.problem(
            "time",
            f"lies before the step that was decided last, {door.grid.times[earliest].isoformat()}",
            "Decide steps in their order; to begin again, make another Controller.",
            measured.time,
        )


def _check_complete(
    door: Door, scenario: Scenario, measured: Measurement, soc: Floats, online: Flags
) -> None:
    """Report readings that are missing and without which only a guard can do."""
    b = scenario.batteries
    given = measured.soc.keys() if isinstance(measured.soc, (Mapping, pd.Series)) else ()
    for i in np.flatnonzero(np.isnan(soc)):
        if b.id[i] not in given:
            cure = "Give the state of charge of every battery."
            door.problem("soc", "is missing", cure, of=b.id[i])
    for i in np.flatnonzero(~online):
        message = "needs a guard, which plans without the battery"
        door.problem("online", message, "Leave RunOptions.guard as it is.", False, b.id[i])


def _with_row(series: Floats, t: int, row: Floats) -> Floats:
    changed = series.copy()
    changed[t] = row
    return changed
