"""Temperatures of rooms and tanks: readings, and estimates where thermometers say nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.plain import number_or_none
from vppres.kinds.cooling import ThermalLoads
from vppres.kinds.cooling.physics import Climate, Rooms, after_c
from vppres.kinds.kind import EARLY_SHARE, ROUNDING_H, Moment, UnitPlan, UnitsNow
from vppres.live.range import Range
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from vppres.live.door import Door

RANGES = {
    "indoor_c": Range(-50.0, 100.0, "must lie between -50 and 100", "Give degrees Celsius."),
    "thermostat_ordered_c": Range(-50.0, 100.0, "must lie between -50 and 100", "Give it in °C."),
}
"""Plausible ranges of thermometers' readings."""

QUANTITIES = ("indoor_c",)
MEANS: tuple[str, ...] = ()
HELD = QUANTITIES
SETPOINT, NUMBERS = "setpoint_c", ("setpoint_c",)
"""The number that an operator says, and those that a set-point must have."""

FORESEEN = ("indoor_c",)
"""Tables of what a plan foresees."""

SHOWN, FIGURES = ("indoor_c",), ("t_min_c", "t_max_c")
"""Readings and columns that the page shows."""

ABOVE_BAND_C = 40.0
"""A temperature so far above its comfort band is in another unit, or a spike."""

BAND_C = 0.02
"""By how much a set-point may be outside the comfort band: what solvers and rounding are off by."""

STILL_C = 1.0
"""Change by the model, in K, beyond which a reading that stands still counts as frozen."""

POWER_SHARE = 1e-3
"""Share of a machine's power that solvers leave of none, or of all of it."""

LEAST_RISE_C = 0.02
"""By how much a room must change for a thermostat to notice."""


def setpoints_c(loads: ThermalLoads, start_c: Floats, end_c: Floats, power_kw: Floats) -> Floats:
    """Temperatures with which thermostats do what is planned for a step, (H,).

    A machine that rests has the end of the band that it holds by itself, or what the room is
    beyond it. One that runs has the temperature at the end of the step. At full power it has the
    end of the band that it makes for, which keeps it running where the room does not follow.
    """
    warms = np.where(loads.heats, 1.0, -1.0)  # a cooled room is a heated one upside down
    start, end, near = warms * start_c, warms * end_c, warms * loads.held_c
    far = warms * np.where(loads.heats, loads.t_max_c, loads.t_min_c)
    rests = power_kw <= POWER_SHARE * loads.p_max_kw
    full = power_kw >= (1.0 - POWER_SHARE) * loads.p_max_kw
    ahead = np.maximum(near, end)
    ahead = np.where(ahead > start + LEAST_RISE_C, ahead, far)
    asked = np.where(full, ahead, end)
    return np.asarray(warms * np.where(rests, np.minimum(near, np.minimum(start, end)), asked))


@dataclass(frozen=True, eq=False)
class Felt:
    """Rooms and tanks from a moment on, in h since the controller's first step, (H,) each."""

    at_h: float
    read_c: Floats  #: last reading; NaN if there was none
    reckoned_c: Floats  #: what has become of it since it moved last
    rests_at_c: Floats  #: what it comes to in the long run
    #: The lowest and the highest that it became since then.
    lowest_c: Floats
    highest_c: Floats
    taken_kw: Floats  #: what machines are to take

    @classmethod
    def before_the_day(cls, scenario: Scenario, at_h: float) -> Felt:
        """Without readings: the temperatures of the scenario."""
        start_c = scenario.thermal_loads.t_initial_c
        none = np.full(len(start_c), np.nan)
        return cls(at_h, none, start_c, start_c, start_c, start_c, np.zeros(len(start_c)))

    def now(self, moment: Moment, ordered_c: Floats) -> Felt:
        """At a moment: in steps that were not decided thermostats hold what others ordered."""
        felt = self.moved_to(self.followed(self.reckoned_c, moment, moment.held_h(self.at_h)))
        climate = Climate(moment.known)
        climate.state = felt.reckoned_c
        for t in moment.begun_since(self.at_h)[:-1]:
            climate.state = climate.after_c(t, climate.thermostat_kw(t, ordered_c, moment.served))
            felt = felt.moved_to(climate.state)
        return felt

    def followed(self, t_c: Floats, moment: Moment, held_h: Floats) -> Floats:
        """Temperatures after so many hours with the set-points."""
        return after_c(moment.window.thermal_loads, t_c, self.rests_at_c, held_h)

    def read_now(self, moment: Moment, read: ReadRooms) -> Floats:
        """Readings with what set-points made of them since; NaN of those known before, (H,).

        One that a clock ahead dates a little later than the last decision was known then.
        """
        read_h = moment.at_h - read.age_h
        early_h = EARLY_SHARE * moment.window.grid.dt_h
        known = (read_h <= self.at_h + early_h) & (read.t_c == self.read_c)
        known |= read_h < self.at_h - ROUNDING_H
        held_h = moment.held_h(self.at_h) - moment.held_h(self.at_h, read.age_h)
        return np.where(known, np.nan, self.followed(read.t_c, moment, held_h))

    def moved_to(self, t_c: Floats) -> Felt:
        """Copy with other temperatures by the model."""
        lowest_c, highest_c = np.minimum(self.lowest_c, t_c), np.maximum(self.highest_c, t_c)
        return replace(self, reckoned_c=t_c, lowest_c=lowest_c, highest_c=highest_c)


PAST = Felt


@dataclass(frozen=True, eq=False)
class ReadRooms:
    """Temperatures that thermometers tell, (H,), NaN without one, and how old these are, in h."""

    t_c: Floats
    age_h: Floats
    ordered_c: Floats  #: what others than the controller set thermostats to since


def read(
    door: Door,
    scenario: Scenario,
    measured: Mapping[str, Any],
    ages_h: Mapping[str, Floats],
    past: Felt | None,
) -> tuple[Scenario, ReadRooms]:
    """Temperatures as they are read."""
    loads = scenario.thermal_loads
    none = np.full(len(loads), np.nan)
    t_c = door.values("indoor_c", measured["indoor_c"], loads.id, none)
    ordered = measured["thermostat_ordered_c"]
    ordered_c = door.values("thermostat_ordered_c", ordered, loads.id, loads.held_c)
    return scenario, ReadRooms(t_c, ages_h["indoor_c"], ordered_c)


def now(moment: Moment, read: ReadRooms, past: Felt | None) -> Indoor:
    """Rooms and tanks in the present step."""
    if past is None:
        felt, read_c = Felt.before_the_day(moment.known, moment.at_h), read.t_c
    else:
        felt, read_c = past.now(moment, read.ordered_c), past.read_now(moment, read)
    return Indoor.of(moment, read.t_c, read_c, felt)


@dataclass(frozen=True, eq=False)
class Indoor(UnitsNow):
    """Temperatures at the beginning of a step, (H,) each.

    The state is the reading if there is one, else the model's. A reading that stands still is not
    believed once the temperature has moved through more than ``STILL_C``, there and back too.
    ``felt`` has the readings, and what is reckoned since they moved last.
    """

    felt: Felt

    @classmethod
    def of(cls, moment: Moment, told_c: Floats, read_c: Floats, past: Felt) -> Indoor:
        """Temperatures of readings, as they were read and as they are now, NaN without one."""
        loads = moment.window.thermal_loads
        ids = loads.id
        read = np.isfinite(read_c)
        still = read & (told_c == past.read_c)
        moves = read & ~still
        reckoned_c, lowest_c, highest_c = (
            np.where(moves, read_c, each)
            for each in (past.reckoned_c, past.lowest_c, past.highest_c)
        )
        frozen = still & (highest_c - lowest_c > STILL_C)
        missing = ~read & np.isfinite(past.read_c)
        now_c = np.where(read & ~frozen, read_c, reckoned_c)
        words = [
            f"indoor_c {ids[i]} {now_c[i]:.1f} ({kind})"
            for kind, flags in (("missing", missing), ("frozen", frozen))
            for i in np.flatnonzero(flags)
        ]
        felt = replace(
            past,
            at_h=moment.at_h,
            read_c=np.where(read, told_c, past.read_c),
            reckoned_c=reckoned_c,
            lowest_c=lowest_c,
            highest_c=highest_c,
        )
        taken_kw = float(past.taken_kw.sum())
        return cls(now_c, taken_kw, float(loads.p_max_kw.sum()), tuple(words), felt)

    def after(self, day: Scenario, state: Floats, columns: Mapping[str, Any]) -> Felt:
        """Rooms and tanks with their set-points from now on."""
        taken_kw = columns["p_kw"]
        return replace(
            self.felt, rests_at_c=Climate(day).rests_at_c(0, taken_kw), taken_kw=taken_kw
        )


def set_points(day: Scenario, t: int, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Powers and temperatures of a step by thermal load, from its record."""
    loads = day.thermal_loads
    start_c, end_c, p_kw = columns["t_start_c"], columns["t_end_c"], columns["p_kw"]
    return {
        "customer": loads.customer,
        "p_kw": p_kw,
        "setpoint_c": setpoints_c(loads, start_c, end_c, p_kw),
        "indoor_c": start_c,
        "indoor_end_c": end_c,
    }


def foreseen(
    window: Scenario, rooms: Rooms, plan: UnitPlan, times: pd.DatetimeIndex
) -> dict[str, pd.DataFrame]:
    """Temperatures that the plan's powers lead to; those without power where it has none."""
    ids = [str(i) for i in window.thermal_loads.id]
    t_c = rooms.t_c(plan.taken_kw)
    return {"indoor_c": pd.DataFrame(t_c[1:], times, ids)}


def own_ranges(scenario: Scenario) -> Iterator[tuple[str, Any, Floats, Callable[[float], Range]]]:
    """Up to what no room or tank of its comfort band becomes."""
    loads = scenario.thermal_loads
    yield "indoor_c", loads, loads.t_max_c, _temperature


def _temperature(t_max_c: float) -> Range:
    """Temperatures of a comfort band that ends there."""
    beyond = f"is more than {ABOVE_BAND_C:g} K above its comfort band: check the unit"
    every = RANGES["indoor_c"]
    return replace(every, highest=min(t_max_c + ABOVE_BAND_C, every.highest), beyond=beyond)


def excesses(table: pd.DataFrame, scenario: Scenario) -> dict[str, Any]:
    """Excess of set-points beyond the comfort band, by what is said of it."""
    loads = scenario.thermal_loads
    setpoint_c = table["setpoint_c"].to_numpy(float)
    below_c = np.where(loads.heats, -np.inf, loads.t_min_c - setpoint_c)
    above_c = np.where(loads.heats, setpoint_c - loads.t_max_c, -np.inf)
    return {
        "cooled below its comfort band": below_c - BAND_C,
        "heated above its comfort band": above_c - BAND_C,
    }


def defaults(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Thermostats hold the comfort band, by thermal load."""
    loads = scenario.thermal_loads
    pairs = zip(loads.id, loads.held_c, strict=True)
    return {str(name): {"setpoint_c": float(t_c)} for name, t_c in pairs}


def by_rule(now: Scenario) -> dict[str, Any]:
    """Thermostats at which no machine runs in an outage, and that hold the band with grid."""
    loads, every = now.thermal_loads, RANGES["indoor_c"]
    idle_c = np.where(loads.heats, every.lowest, every.highest)
    return {"setpoint_c": loads.held_c if now.grid_limit_kw[0] > 0.0 else idle_c}


def expected(rows: pd.DataFrame) -> dict[str, Any]:
    """Temperatures that a plan begins and ends its step with, by thermal load."""
    return {
        name: {str(one): number_or_none(value) for one, value in rows[name].items()}
        for name in ("indoor_c", "indoor_end_c")
    }
