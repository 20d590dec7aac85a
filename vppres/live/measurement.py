"""Measurements and expectations of your own plant, laid over a scenario's series."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.observation import Told
from vppres.core.arrays import Flags, Floats, Names
from vppres.core.errors import InputError, VppresError
from vppres.kinds.live_fields import ReadOfKinds
from vppres.kinds.table import parts
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


@contextmanager
def reading(measured: Measurement) -> Iterator[None]:
    """Refuse what cannot be read of a measurement, which may come from any caller.

    Raises
    ------
    InputError
        If it holds anything that cannot be read.
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
        yield
    except VppresError:
        raise
    except Exception as error:
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


def row_of(grid: TimeGrid, measured: Measurement) -> tuple[int, bool]:
    """The step of a measurement, and whether it is of a moment within it.

    The first step where there is none; :func:`_moment_at` says so.
    """
    with reading(measured):
        door = Door(grid, measured.time)
        return max(door.t, 0), (door.moment("now", measured.now) or door.begun) > door.begun


@dataclass(frozen=True, eq=False)
class Read:
    """Readings and expectations of a measurement that fit its site, NaN where one is missing."""

    series: Scenario  #: the site, with what was read and foretold in its series' place
    connected: Flags  #: customers that can be supplied at all, (C,)
    seen: dict[str, Any]  #: readings of the moment, by field of the observation
    of_kinds: dict[str, Any]  #: readings of the units of each kind
    switches: dict[str, bool]  #: states of the switches that were read
    announced_kw: Floats  #: limits of import that are announced, (T,)
    foretold: dict[str, Flags]  #: items whose series another provider foretold, by series
    left_out: tuple[str, ...]  #: readings that no device can have, in words

    @classmethod
    def of(
        cls,
        measured: Measurement,
        site: Scenario,
        estimates: bool,
        last: int,
        past: Mapping[str, Any],
    ) -> Read:
        """All that is read of a measurement; what is missing may be if a guard ``estimates`` it.

        ``last`` is the step that was decided last, ``past`` the state of each kind after it.

        Raises
        ------
        InputError
            With every value that does not fit the scenario.
        """
        with reading(measured):
            door = Door(site.grid, measured.time, estimates, ranges=ranges_of(site))
            _check_order(door, measured, last)
            moment = _moment_at(door, measured)
            connected = door.flags("connected", measured.connected, site.customers.id)
            series = _read_series(door, site, measured, connected)
            seen = _read_devices(door, site, measured, moment)
            switches = _read_switches(door, measured.closed, site.switches.id)
            unknown = np.full(site.grid.n_steps, np.nan)
            announced_kw = door.series("announced_limit_kw", measured.announced_limit_kw, unknown)
            ids = {"load_kw": site.customers.id, "pv_kw": site.pv.id}
            foretold = {name: _is_foretold(measured, name, each) for name, each in ids.items()}
            series, of_kinds = _read_kinds(door, series, measured, moment, past)
            door.finish()
        left_out = tuple(door.left_out)
        return cls(series, connected, seen, of_kinds, switches, announced_kw, foretold, left_out)


def _moment_at(door: Door, measured: Measurement) -> pd.Timestamp:
    """The moment of a measurement, which must lie within its step."""
    now = door.moment("now", measured.now) or door.begun
    if not door.begun <= now < door.begun + door.grid.step:
        door.problem("now", "lies outside the step", "Give a time within it.", measured.now)
    return now


def _read_kinds(
    door: Door,
    scenario: Scenario,
    measured: Measurement,
    now: pd.Timestamp,
    past: Mapping[str, Any],
) -> tuple[Scenario, dict[str, Any]]:
    """Readings of the units of each kind, and the scenario with what was read in its place."""
    kinds = {}
    for kind, live in parts("live").items():
        ids = getattr(scenario, kind).id
        of_kind = {name: getattr(measured, name) for name in live.RANGES}
        times = {name: (measured.read_at or {}).get(name) for name in live.RANGES}
        ages_h = {name: door.ages_h(f"read_at {name}", at, ids, now) for name, at in times.items()}
        scenario, kinds[kind] = live.read(door, scenario, of_kind, ages_h, past.get(kind))
    return scenario, kinds


def _read_series(
    door: Door, scenario: Scenario, measured: Measurement, connected: Flags
) -> Scenario:
    """The scenario with series as read and foretold, NaN where a reading of now is missing.

    Customers that are not ``connected`` take nothing.
    """
    load_kw = door.table("load_kw", measured.load_kw, scenario.customers.id, scenario.load_kw)
    pv_kw = door.table("pv_kw", measured.pv_kw, scenario.pv.id, scenario.pv_kw)
    own = {
        "price_gbp_per_kwh": scenario.price_gbp_per_kwh,
        "grid_limit_kw": scenario.grid_limit_kw,
        "export_limit_kw": np.broadcast_to(scenario.export_limit_kw, scenario.grid.n_steps),
        "export_price_gbp_per_kwh": scenario.export_price,
    }
    read: dict[str, Any] = {
        "load_kw": np.where(connected, load_kw, 0.0),
        "pv_kw": np.clip(pv_kw, 0.0, scenario.pv.p_max_kw),
        **{name: door.series(name, getattr(measured, name), each) for name, each in own.items()},
    }
    return replace(scenario, **read)


def _read_devices(
    door: Door, scenario: Scenario, measured: Measurement, now: pd.Timestamp
) -> dict[str, Any]:
    """Readings of a moment, by field of the observation, NaN where one is missing.

    A missing efficiency is the nominal one, no estimate is better.
    """
    b = scenario.batteries
    unknown = np.full(len(b), np.nan)
    soc = door.values("soc", measured.soc, b.id, unknown)
    eta_charge = door.values("eta_charge", measured.eta_charge, b.id, b.eta_charge)
    eta_discharge = door.values("eta_discharge", measured.eta_discharge, b.id, b.eta_discharge)
    battery_kw = door.values("battery_kw", measured.battery_kw, b.id, unknown)
    online = door.flags("online", measured.online, b.id)
    import_kw = door.number("import_kw", measured.import_kw)
    dimmable = door.flags("dimmable", measured.dimmable, scenario.customers.id)
    if not door.estimates:
        _check_complete(door, b, measured, soc, online)
        soc = np.clip(soc, b.soc_min, b.soc_max)
    return {
        "soc": soc,
        "eta_charge": np.where(np.isnan(eta_charge), b.eta_charge, eta_charge),
        "eta_discharge": np.where(np.isnan(eta_discharge), b.eta_discharge, eta_discharge),
        "battery_kw": None if measured.battery_kw is None else battery_kw,
        "online": online,
        "import_kw": import_kw,
        "whole": None if dimmable.all() else ~dimmable,
        "elapsed_h": (now - door.begun) / HOUR,
        "soc_age_h": door.ages_h("soc_at", measured.soc_at, b.id, now),
        "told": _read_overrides(door, measured.ordered_kw, b.id, now),
    }


def _read_switches(door: Door, read: Any, ids: Names) -> dict[str, bool]:
    """States of the switches that were read."""
    closed = door.flags("closed", read, ids)
    given = set(read.keys()) if isinstance(read, (Mapping, pd.Series)) else set()
    return {str(name): bool(one) for name, one in zip(ids, closed, strict=True) if name in given}


def _is_foretold(measured: Measurement, field: str, ids: Names) -> Flags:
    """Items whose series another provider foretold."""
    names = set((measured.foretold or {}).get(field, ()))
    return np.array([str(name) in names for name in ids], dtype=bool)


def _read_overrides(door: Door, ordered_kw: Any, ids: Names, now: pd.Timestamp) -> tuple[Told, ...]:
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


def _check_order(door: Door, measured: Measurement, last: int) -> None:
    """Time does not go back behind the step that was decided last: that cannot be undone."""
    if 0 <= door.t < last:
        door.problem(
            "time",
            f"lies before the step that was decided last, {door.grid.times[last].isoformat()}",
            "Decide steps in their order; to begin again, make another Controller.",
            measured.time,
        )


def _check_complete(
    door: Door, b: Batteries, measured: Measurement, soc: Floats, online: Flags
) -> None:
    """Report readings that are missing and without which only a guard can do."""
    given = measured.soc.keys() if isinstance(measured.soc, (Mapping, pd.Series)) else ()
    for i in np.flatnonzero(np.isnan(soc)):
        if b.id[i] not in given:
            cure = "Give the state of charge of every battery."
            door.problem("soc", "is missing", cure, of=b.id[i])
    for i in np.flatnonzero(~online):
        message = "needs a guard, which plans without the battery"
        door.problem("online", message, "Leave RunOptions.guard as it is.", False, b.id[i])
