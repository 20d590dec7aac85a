"""Readings of vehicles, laid over the sessions of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.plain import number_or_none
from vppres.core.text import iso
from vppres.kinds.kind import ROUNDING_H, Moment, UnitPlan, UnitsNow
from vppres.kinds.vehicles import NO_CAR, OF_SESSIONS, Sessions
from vppres.kinds.vehicles.physics import Garage, Plugged, stored_by
from vppres.kinds.vehicles.words import SHORT_KWH
from vppres.live.range import POWER, Range, above_rating, flag
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from vppres.live.door import Door


RANGES = {
    "plugged": flag("a vehicle is plugged in"),
    "ev_soc": Range(0.0, 1.0, "must lie between 0 and 1", "Give a share, for example 0.5."),
    "energy_needed_kwh": POWER,
    "departure": Range(0.0, 7.3e9, "must be seconds since 1970", "Give a time of this century."),
    "charger_ordered_kw": Range(-1e7, 1e7, "must be a power in kW", "Give a number."),
}
"""Plausible ranges of chargers' readings of their vehicles."""

MEANS: tuple[str, ...] = ()
HELD = ("ev_soc", "energy_needed_kwh")
SETPOINT, NUMBERS = "p_limit_kw", ("p_kw", "p_limit_kw")
"""The number that an operator says, and those that a set-point must have."""

FORESEEN = ("left_short",)
"""Tables of what a plan foresees."""

SHOWN, FIGURES = ("plugged",), ("p_charge_kw",)
"""Readings and columns that the page shows."""

QUANTITIES = ("plugged", "ev_soc", "energy_needed_kwh", "departure")
"""Quantities of the vehicle at a charger."""


@dataclass(frozen=True)
class Stay:
    """A vehicle as it was known at a charger in a step: a row of :class:`Sessions`."""

    charger: str
    vehicle: str
    plug_in: pd.Timestamp
    plug_out: pd.Timestamp
    capacity_kwh: float
    soc_at_plug_in: float
    soc_needed: float
    energy_needed_kwh: float
    v2g_soc_floor: float
    tier: str
    weight: float
    announced: bool


@dataclass(frozen=True, eq=False)
class PluggedInVehicles:
    """The vehicles at chargers from a moment on, their energy, and what they were to take.

    ``at_h`` is the moment, in h since the controller's first step, and ``since`` the time of
    plug-in as text by charger, empty without a vehicle. The others have the shape (K,).
    """

    at_h: float
    since: tuple[str, ...]
    kwh: Floats  #: energy at the moment
    end_kwh: Floats  #: energy after a whole step
    taken_kw: Floats
    stays: tuple[Stay, ...] = ()

    @classmethod
    def before_the_day(cls, n_chargers: int) -> PluggedInVehicles:
        """No vehicle that was here before."""
        none = np.zeros(n_chargers)
        return cls(0.0, ("",) * n_chargers, none, none, none)

    @classmethod
    def of(
        cls, at_h: float, day: Scenario, kwh: Floats, end_kwh: Floats, taken_kw: Floats
    ) -> PluggedInVehicles:
        """The vehicles of the first step of a day, and their energy after a whole step."""
        here = [s for s in day.session_at[0].tolist() if s != NO_CAR]
        rows = rows_of(day.sessions) if here else []
        stays = tuple(Stay(**rows[s]) for s in here)
        return cls(at_h, _since(day, 0), kwh, end_kwh, taken_kw, stays)

    def at(self, moment: Moment, read: ReadVehicles) -> Floats:
        """Energy of vehicles that were read since, or have been here before; NaN of others, (K,).

        What was charged since is added to it.
        """
        pairs = zip(_since(moment.window, 0), self.since, strict=True)
        stays = np.array([name != "" and name == before for name, before in pairs], dtype=bool)
        read_h = moment.at_h - read.age_h
        # An older reading was known when their set-points were made.
        counts = np.isfinite(read.kwh) & ((read_h >= self.at_h - ROUNDING_H) | ~stays)
        dt_h = moment.window.grid.dt_h
        now, then = (moment.held_h(self.at_h, ago_h) / dt_h for ago_h in (0.0, read.age_h))
        read_kwh = read.kwh + (now - then) * (self.end_kwh - self.kwh)
        told_kwh = (1.0 - now) * self.kwh + now * self.end_kwh
        if np.isfinite(read.ordered_kw).any():
            gain_kw = stored_by(moment.window.chargers, read.ordered_kw)
            by_others, since_h = np.isfinite(gain_kw), moment.at_h - self.at_h
            read_kwh = np.where(by_others, read.kwh + gain_kw * read.age_h, read_kwh)
            told_kwh = np.where(by_others, self.kwh + gain_kw * since_h, told_kwh)
        return np.where(counts, read_kwh, np.where(stays, told_kwh, np.nan))


def _since(scenario: Scenario, t: int) -> tuple[str, ...]:
    """Time of plug-in of the vehicle at each charger."""
    rows = scenario.session_at[t].tolist()
    plug_in = scenario.sessions.plug_in
    return tuple("" if row == NO_CAR else plug_in[row].isoformat() for row in rows)


PAST = PluggedInVehicles


@dataclass(frozen=True, eq=False)
class VehiclesNow(UnitsNow):
    """Energy of the vehicle at each charger in a step, (K,), 0 without one, at a moment."""

    at_h: float

    def after(self, day: Scenario, state: Floats, columns: Mapping[str, Any]) -> PluggedInVehicles:
        """The vehicles with their set-points from now on."""
        return PluggedInVehicles.of(self.at_h, day, self.state, state, columns["p_kw"])


@dataclass(frozen=True, eq=False)
class ReadVehicles:
    """Energy of vehicles by readings, (K,), NaN without one, and how old these are, in h."""

    kwh: Floats
    age_h: Floats
    #: Mean power that each charger was ordered since the last decision, where others ordered it.
    ordered_kw: Floats


def now(moment: Moment, read: ReadVehicles, past: PluggedInVehicles | None) -> VehiclesNow:
    """Vehicles as they were read, or else as reckoned, or else as their sessions say."""
    day, past = moment.window, past or PluggedInVehicles.before_the_day(len(read.kwh))
    kwh = np.clip(past.at(moment, read), 0.0, Garage(day).full_kwh(0))
    off_kw = float(np.abs(past.taken_kw).sum())
    taken_kw = float(past.taken_kw.sum())
    return VehiclesNow(Garage(day, kwh).at(0), taken_kw, off_kw, (), moment.at_h)


def read(
    door: Door,
    scenario: Scenario,
    measured: Mapping[str, Any],
    ages_h: Mapping[str, Floats],
    past: PluggedInVehicles | None,
) -> tuple[Scenario, ReadVehicles]:
    """The scenario with sessions as they are measured, and energies that were read, (K,).

    Vehicles stay as they were known in the step before until they leave. A charger without
    a vehicle ends its session; that is named. A vehicle that tells the energy that it needs has
    a session from now on; its departure is that of the session before if it tells none. One that is
    plugged in after its departure, or of which none is known, stays for this step, and is named.
    Energies are NaN if neither a state of charge nor a need was read.
    """
    chargers = scenario.chargers
    none = np.full(len(chargers), np.nan)
    plugged, soc, needed_kwh = (
        door.values(name, measured[name], chargers.id, none) for name in QUANTITIES[:3]
    )
    departure = door.moments("departure", measured["departure"], chargers.id)
    held_kwh, age_h = none.copy(), np.zeros(len(chargers))
    ordered_kw = door.values(
        "charger_ordered_kw", measured["charger_ordered_kw"], chargers.id, none
    )
    if door.problems or not len(chargers):
        return scenario, ReadVehicles(held_kwh, age_h, ordered_kw)
    own: dict[str, list[Row]] = {str(name): [] for name in chargers.id}
    for row in rows_of(scenario.sessions):
        own[row["charger"]].append(row)
    for stay in past.stays if past else ():
        row = dict(vars(stay))
        own[stay.charger] = [*_sessions_beside(own[stay.charger], row, door.begun), row]
    for k, (name, rows) in enumerate(own.items()):
        seen = _Read(plugged[k], soc[k], needed_kwh[k], departure[k])
        before = _at_charger(rows, seen.here, door.begun)
        now, words = _as_read(seen, before, name, scenario, door.begun)
        door.left_out.extend(words)
        own[name] = [row for row in rows if row is not before]
        if now is not None:
            own[name] = [*_sessions_beside(own[name], now, door.begun), now]
            if np.isnan(now["energy_needed_kwh"]):
                held_kwh[k], age_h[k] = seen.soc * now["capacity_kwh"], ages_h["ev_soc"][k]
            elif np.isfinite(seen.needed_kwh):
                held_kwh[k], age_h[k] = 0.0, ages_h["energy_needed_kwh"][k]
    told_of = [row for rows in own.values() for row in rows]
    laid = replace(scenario, sessions=sessions_of(told_of))
    return laid, ReadVehicles(held_kwh, age_h, ordered_kw)


Row = dict[str, Any]  # of a session, by column


@dataclass(frozen=True)
class _Read:
    """Readings of the vehicle at a charger, NaN or None where there is none."""

    plugged: float
    soc: float
    needed_kwh: float
    departure: pd.Timestamp | None

    @property
    def here(self) -> bool:
        """Whether a vehicle is read to be here."""
        return self.plugged == 1.0 or bool(self.plugged != 0.0 and np.isfinite(self.needed_kwh))


def _as_read(
    read: _Read,
    before: Row | None,
    charger: str,
    scenario: Scenario,
    begun: pd.Timestamp,
) -> tuple[Row | None, list[str]]:
    """The session of a charger as it is read, and what is odd about it."""
    end = begun + scenario.grid.step
    if read.plugged == 0.0:
        left = f"vehicle {before['vehicle']} is not at {charger}" if before else ""
        return None, [left] if left else []
    if before is None and not np.isfinite(read.needed_kwh):
        unknown = f"vehicle at {charger} is here and what it needs is not known"
        return None, [unknown] if read.here else []
    words = []
    vehicle = f"vehicle {before['vehicle'] if before else charger} at {charger}"
    leaves = read.departure or (before["plug_out"] if before else None)
    if read.here and (leaves is None or leaves <= begun):
        known = "after its departure" if leaves else "and its departure is not known"
        words.append(f"{vehicle} is here {known}")
        leaves = end
    elif read.here and leaves is not None and leaves < end:
        words.append(f"{vehicle} leaves within this step and is not charged in it")
    leaves = max(leaves or begun, begun)
    if not np.isfinite(read.needed_kwh):
        assert before is not None
        return {**before, "plug_in": min(before["plug_in"], begun), "plug_out": leaves}, words
    row = _session_from_need(scenario, charger, before, read.needed_kwh)
    most_kwh = (before or row)["capacity_kwh"]
    if read.needed_kwh > most_kwh:
        words.append(f"{vehicle} needs {read.needed_kwh:g} kWh, and holds {most_kwh:g} kWh")
        row["energy_needed_kwh"] = most_kwh
    return {**row, "plug_in": begun, "plug_out": leaves}, words


def _at_charger(rows: Sequence[Row], here: bool, begun: pd.Timestamp) -> Row | None:
    """The session of a charger now, of its own.

    Where a vehicle is here beside its time, that is the one that is late or early by less: of those
    that are announced, or were over last.
    """
    now = [row for row in rows if row["plug_in"] <= begun < row["plug_out"]]
    if now or not here:
        return max(now, key=lambda row: row["plug_out"], default=None)
    past = ((begun - row["plug_out"], row) for row in rows if row["plug_out"] <= begun)
    coming = ((row["plug_in"] - begun, row) for row in rows if row["plug_in"] > begun)
    beside = [*past, *(one for one in coming if one[1]["announced"])]
    return min(beside, key=lambda one: one[0], default=(None, None))[1]


def _sessions_beside(rows: Iterable[Row], one: Row, begun: pd.Timestamp) -> list[Row]:
    """Sessions of a charger for which a vehicle at it leaves time; some begin later."""
    found = []
    for row in rows:
        if row["plug_out"] <= begun:
            found.append(row)
        elif row["plug_in"] > one["plug_in"] and row["plug_out"] > one["plug_out"]:
            found.append({**row, "plug_in": max(row["plug_in"], one["plug_out"])})
    return found


def rows_of(sessions: Sessions) -> list[dict[str, Any]]:
    """Sessions one by one."""
    names = [f.name for f in fields(sessions)]
    columns = (getattr(sessions, name) for name in names)
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def sessions_of(rows: Sequence[Mapping[str, Any]]) -> Sessions:
    """Sessions from their rows."""
    columns: dict[str, Any] = {f.name: [row[f.name] for row in rows] for f in fields(Sessions)}
    return Sessions(**columns)


def _session_from_need(
    scenario: Scenario, charger: str, before: Mapping[str, Any] | None, needed_kwh: float
) -> dict[str, Any]:
    """A session of a vehicle that tells the energy that it needs; without a name its charger's.

    One of which no tier is known has the weight of the least.
    """
    least = float(scenario.sessions.weight.min(initial=np.inf))
    unknown = {
        "vehicle": charger,
        "tier": scenario.tiers[-1],
        "weight": least if np.isfinite(least) else 1.0,
    }
    nothing = dict.fromkeys(OF_SESSIONS, np.nan)
    own = {**nothing, **(before or unknown), "charger": charger, "announced": True}
    told = {"soc_at_plug_in": np.nan, "soc_needed": np.nan, "v2g_soc_floor": np.nan}
    return {**own, **told, "energy_needed_kwh": needed_kwh}


def set_points(day: Scenario, t: int, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Powers and limits of a step by charger, from its record."""
    plug_out = day.sessions.plug_out
    here = day.session_at[t].tolist()
    return {
        "vehicle": columns["vehicle"],
        "leaves": [pd.NaT if s == NO_CAR else plug_out[s] for s in here],
        "p_kw": columns["p_kw"],
        "p_limit_kw": np.maximum(columns["p_kw"], 0.0),
        "energy_kwh": columns["energy_start_kwh"],
        "needed_kwh": columns["needed_kwh"],
    }


def foreseen(
    window: Scenario, ahead: Plugged, plan: UnitPlan, times: pd.DatetimeIndex
) -> dict[str, pd.DataFrame]:
    """Known vehicles that leave short within the plan; what leaves after it is not judged."""
    chargers, sessions = window.chargers, window.sessions
    short_kwh = ahead.short_kwh(ahead.energy_kwh(plan.taken_kw))
    _, after = sessions.steps(window.grid)
    rows = []
    for t, k in np.argwhere(ahead.known & (short_kwh > SHORT_KWH)).tolist():
        s = int(window.session_at[t, k])
        if after[s] == t + 1:  # what is due by the window's end alone is no departure
            who = (str(chargers.id[k]), str(sessions.vehicle[s]))
            rows.append((*who, sessions.plug_out[s], float(short_kwh[t, k])))
    columns = ["id", "vehicle", "leaves", "short_kwh"]
    return {"left_short": pd.DataFrame(rows, columns=columns).set_index("id")}


def own_ranges(scenario: Scenario) -> Iterator[tuple[str, Any, Floats, Callable[[float], Range]]]:
    """None: the range of what a charger tells is that of every charger."""
    return iter(())


def excesses(table: pd.DataFrame, scenario: Scenario) -> dict[str, Any]:
    """Excess of set-points beyond the ratings of chargers, by what is said of it."""
    chargers = scenario.chargers
    p_kw, limit_kw = (table[name].to_numpy(float) for name in NUMBERS)
    most_kw = np.maximum(p_kw, limit_kw)
    return {
        "power above its rating": above_rating(most_kw, chargers.p_charge_kw),
        "discharge above its rating": above_rating(-p_kw, chargers.p_discharge_kw),
    }


def defaults(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Chargers charge as fast as they can, by charger."""
    chargers = scenario.chargers
    return {
        str(name): {"p_kw": float(p_kw), "p_limit_kw": float(p_kw)}
        for name, p_kw in zip(chargers.id, chargers.p_charge_kw, strict=True)
    }


def by_rule(now: Scenario) -> dict[str, Any]:
    """No charging."""
    return {"p_kw": 0.0, "p_limit_kw": 0.0}


def expected(rows: pd.DataFrame) -> dict[str, Any]:
    """Vehicles that are plugged in, by charger."""
    return {
        "vehicles": {
            str(name): {
                "vehicle": str(row["vehicle"]),
                "leaves": iso(row["leaves"].tz_convert("UTC")),
                "energy_kwh": number_or_none(row["energy_kwh"]),
                "needed_kwh": number_or_none(row["needed_kwh"]),
            }
            for name, row in rows[rows["leaves"].notna()].iterrows()
        }
    }
