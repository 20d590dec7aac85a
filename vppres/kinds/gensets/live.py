"""What generating sets tell, and what is reckoned of them: on or off, hours, fuel, failed starts.

A set with the set-point to run that stands still, or that says that it failed to start, is out:
plans do without it until it takes that back, or runs. One that never said that there was a fault
has nothing to take back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.kinds.gensets.data import ROUNDING_H, Gensets, GensetState, Refuels
from vppres.kinds.gensets.physics import SetsAhead
from vppres.scenario.scenario import Scenario

QUANTITIES = ("running", "genset_kw", "fuel_litres", "start_fault")
"""What a set can tell."""

ORDERED = "genset_ordered_kw"
"""What another sender ordered it."""

STILL_SHARE = 0.05
"""Share of the tank that a set may have burnt while its gauge stands still: gauges are coarse."""


@dataclass(frozen=True, eq=False)
class Ran:
    """Sets from the beginning of a step on, as their set-points have them run, (G,) each.

    Parameters
    ----------
    at_h : float
        When it began, in h since the controller's first step.
    before : GensetState
        State then, with the least fuel that may have been in the tank.
    most_litres : array
        The most that may have been.
    read_litres : array
        Last reading of the gauge; NaN if there was none.
    out : array of bool
        Sets that do not start.
    fault : array
        What each said last of a fault; NaN if nothing.
    on, power_kw : array
        How they were to run.
    """

    at_h: float
    before: GensetState
    most_litres: Floats
    read_litres: Floats
    out: Flags
    fault: Floats
    on: Flags
    power_kw: Floats

    @classmethod
    def before_the_day(cls, sets: Gensets, at_h: float) -> Ran:
        """Without readings: the state of the scenario."""
        first = GensetState.at_first(sets)
        unread = np.full(len(sets), np.nan)
        out = np.zeros(len(sets), dtype=bool)
        return cls(at_h, first, first.fuel_litres, unread, out, unread, first.on, first.power_kw)

    def as_ordered(self, ordered_kw: Floats) -> Ran:
        """The same where another sender ordered something else; NaN where none did."""
        by_others = np.isfinite(ordered_kw)
        power_kw = np.where(by_others, ordered_kw, self.power_kw)
        return replace(self, on=np.where(by_others, power_kw > 0.0, self.on), power_kw=power_kw)


@dataclass(frozen=True, eq=False)
class Readings:
    """What sets told at the beginning of a step, (G,) each; NaN where one told nothing.

    ``ordered_kw`` is the most that another sender ordered each since the last decision.
    """

    running: Floats
    power_kw: Floats
    fuel_litres: Floats
    start_fault: Floats
    ordered_kw: Floats


@dataclass(frozen=True, eq=False)
class SetsNow:
    """Sets at the beginning of a step, (G,) each.

    Parameters
    ----------
    state : GensetState
        The estimate. Fuel is the reading, or the least that may be left.
    known : Ran
        What is known of them now, before they are told how to run from now on; fuel is the least
        that may be left since the gauge moved.
    estimated : tuple of str
        Readings that are missing or frozen, and sets that are out, in words.
    """

    state: GensetState
    known: Ran
    estimated: tuple[str, ...]

    @classmethod
    def of(
        cls, sets: Gensets, told: Readings, past: Ran, at_h: float, dt_h: float, added: Floats
    ) -> SetsNow:
        """The sets after their set-points, ``added`` fuel having been delivered since.

        ``past`` says how they were to run since. After the end of its step they have no set-point:
        they stop. Times are in h since the controller's first step.
        """
        by_others = np.isfinite(told.ordered_kw)
        past = past.as_ordered(told.ordered_kw)
        gone_h = at_h - past.at_h
        runs = _Running.of(told, past, by_others, gone_h, dt_h)
        burning_h = np.where(runs.on | by_others, gone_h, min(gone_h, dt_h))
        fuel = _Fuel.of(sets, told, past, runs, burning_h, added)
        gave_kw = np.where(np.isfinite(told.power_kw), told.power_kw, past.power_kw)
        # A mean is less than the least power where the set started within it.
        power_kw = np.where(runs.on, np.clip(gave_kw, sets.p_min_kw, sets.p_max_kw), 0.0)
        state = GensetState(runs.on, runs.hours, power_kw, fuel.litres)
        known = replace(
            past,
            at_h=at_h,
            before=replace(state, fuel_litres=fuel.least_litres),
            most_litres=fuel.most_litres,
            read_litres=fuel.read_litres,
            out=runs.out,
            fault=np.where(np.isfinite(told.start_fault), told.start_fault, past.fault),
        )
        return cls(state, known, (*fuel.words(sets.id), *runs.words(sets.id)))

    @property
    def out(self) -> Flags:
        """Sets that do not start."""
        return self.known.out

    def without_those_out(self, known: SetsAhead) -> SetsAhead:
        """A window in which no set runs that is out."""
        can_run = known.can_run & ~self.out
        return replace(known, can_run=can_run, must_run=known.must_run & ~self.out)

    def told(self, on: Flags, power_kw: Floats) -> Ran:
        """How they are to run from now on."""
        return replace(self.known, on=on, power_kw=power_kw)


def after(refuels: Refuels, day: Scenario) -> Refuels:
    """Deliveries after the beginning of a day: what came by then is in the tank."""
    later = np.array([time > day.grid.start for time in refuels.time], dtype=bool)
    return Refuels(refuels.genset[later], refuels.time[later], refuels.litres[later])


@dataclass(frozen=True, eq=False)
class _Running:
    """Which sets run and for how long, (G,) each; who was to start and never did, and who is out.

    ``failed`` stood still for a whole step in which they were to run, ``faulty`` tell a fault.
    """

    on: Flags
    hours: Floats
    never: Flags
    out: Flags
    failed: Flags
    faulty: Flags

    @classmethod
    def of(
        cls, told: Readings, past: Ran, by_others: Flags, gone_h: float, dt_h: float
    ) -> _Running:
        """The estimate so many hours after their set-points; ``by_others``, by another sender."""
        held = gone_h <= dt_h + ROUNDING_H
        was, read = past.before.on, np.isfinite(told.running)
        gave_nothing = (past.power_kw > 0.0) & (told.power_kw <= 0.0)
        faulty = told.start_fault > 0.5
        on = np.where(read, told.running > 0.5, past.on & held & ~gave_nothing & ~faulty)
        never = past.on & ~was & ~on & held & ~(told.power_kw > 0.0)
        failed = never & ~by_others & (gone_h >= dt_h - ROUNDING_H)
        hours = _hours(past, on, gone_h, dt_h)
        # When another sender switched is not known.
        hours = np.where(by_others & ((was != on) | (past.on != on)), 0.0, hours)
        kept = past.out & ~((told.start_fault <= 0.5) & (past.fault != 0.0))
        out = (failed | faulty | kept) & ~on
        return cls(on, hours, never, out, failed, faulty)

    def words(self, ids: Names) -> list[str]:
        """Sets that are out, and why."""
        of_failed = np.where(self.failed, "told to run, stands still", "no start")
        why = np.where(self.faulty, "start fault", of_failed)
        return [f"genset {ids[g]} is out ({why[g]})" for g in np.flatnonzero(self.out)]


@dataclass(frozen=True, eq=False)
class _Fuel:
    """Fuel in the tanks, (G,) each: the estimate, the least and the most since a gauge moved.

    ``read_litres`` is the last reading; ``missing`` gauges say nothing, ``frozen`` ones stand still
    although much must have been burnt.
    """

    litres: Floats
    least_litres: Floats
    most_litres: Floats
    read_litres: Floats
    missing: Flags
    frozen: Flags

    @classmethod
    def of(
        cls,
        sets: Gensets,
        told: Readings,
        past: Ran,
        runs: _Running,
        burning_h: Floats,
        added: Floats,
    ) -> _Fuel:
        """What is left after so many hours of burning and what was delivered."""
        least, most = _left_litres(sets, told, past, runs.on, runs.never, burning_h)
        least, most = (np.minimum(left + added, sets.tank_litres) for left in (least, most))
        told_litres = np.minimum(told.fuel_litres, sets.tank_litres)
        gauged = np.isfinite(told_litres)
        still = gauged & (told_litres == past.read_litres)
        least, most = (np.where(gauged & ~still, told_litres, left) for left in (least, most))
        frozen = still & (told_litres - most > STILL_SHARE * sets.tank_litres)
        return cls(
            litres=np.where(gauged & ~frozen, told_litres, least),
            least_litres=least,
            most_litres=most,
            read_litres=np.where(gauged, told_litres, past.read_litres),
            missing=~gauged & np.isfinite(past.read_litres),
            frozen=frozen,
        )

    def words(self, ids: Names) -> list[str]:
        """Gauges that say nothing, and those that stand still."""
        return [
            f"fuel_litres {ids[g]} {self.litres[g]:.0f} at least ({kind})"
            for kind, flags in (("missing", self.missing), ("frozen", self.frozen))
            for g in np.flatnonzero(flags)
        ]


def _hours(past: Ran, on: Flags, gone_h: float, dt_h: float) -> Floats:
    """How long sets have been on, or off; 0 where one did what it was not told."""
    was = past.before.on
    over_h = max(gone_h - dt_h, 0.0)
    changed_h = np.where(past.on == on, gone_h, 0.0)
    # Told to run until the end of a step that is over, and to do nothing since.
    changed_h = np.where(past.on & ~on, over_h, changed_h)
    never_started = ~was & ~on & (~past.on | (over_h == 0.0))
    return np.where((was & on) | never_started, past.before.hours + gone_h, changed_h)


def _left_litres(
    sets: Gensets, told: Readings, past: Ran, on: Flags, never: Flags, burning_h: Floats
) -> tuple[Floats, Floats]:
    """The least and the most that may be left of the fuel, by the line of each set.

    What was measured counts. Otherwise a set gave its set-point, or at least its least power;
    one that runs by hand, or may form the grid, may have given its largest.
    """
    measured = np.isfinite(told.power_kw)
    given = measured & (told.power_kw > 0.0)
    most_kw = np.where(past.on & ~sets.grid_forming, past.power_kw, sets.p_max_kw)
    least_kw = np.where(past.on, sets.p_min_kw, 0.0)
    may_have_run = (past.on | on | given) & ~never
    has_run = (past.on & on) | given
    burnt = [
        sets.litres(ran, np.where(measured, told.power_kw, kw) * ran, dt_h=1.0) * burning_h
        for ran, kw in ((may_have_run, most_kw), (has_run, least_kw))
    ]
    return (
        np.maximum(past.before.fuel_litres - burnt[0], 0.0),
        np.maximum(past.most_litres - burnt[1], 0.0),
    )


def set_points(day: Scenario, t: int, columns: Mapping[str, Any]) -> dict[str, Any]:
    """Start or stop, power and fuel of a step by generating set, from its record."""
    return {
        "running": columns["running"],
        "p_kw": columns["p_kw"],
        "hours_before": columns["hours_before"],
        "p_before_kw": columns["p_before_kw"],
        "fuel_litres": columns["fuel_start_litres"],
        "fuel_end_litres": columns["fuel_end_litres"],
        "out": np.zeros(len(day.gensets), dtype=bool),
    }


def foreseen(
    window: Scenario, known: SetsAhead, taken_kw: Floats, running: Flags, times: pd.DatetimeIndex
) -> dict[str, pd.DataFrame]:
    """What sets give and what is left in their tanks; nothing runs where a plan has none."""
    sets = window.gensets
    litres = known.fuel_litres(sets, running, -taken_kw, window.grid.dt_h)
    names = [str(name) for name in sets.id]
    return {
        "genset_kw": pd.DataFrame(-taken_kw[1:], times, names),
        "fuel_litres": pd.DataFrame(litres[1:], times, names),
    }
