"""State of generating sets from readings: on or off, hours, fuel, failed starts.

A set with the set-point to run that stands still, or that says that it failed to start, is out:
plans do without it until it takes that back, or runs. One that never said that there was a fault
has nothing to take back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.core.plain import number_or_none
from vppres.kinds.gensets import ROUNDING_H, Gensets, GensetState
from vppres.kinds.gensets.physics import SetsAhead
from vppres.kinds.kind import EARLY_SHARE, Moment, UnitPlan, UnitsNow
from vppres.live.range import (
    NUMBER,
    POWER,
    POWER_KW,
    RATED_SHARE,
    Range,
    above_rating,
    flag,
    rated,
    slack_kw,
)
from vppres.scenario.scenario import Scenario

if TYPE_CHECKING:
    from vppres.live.door import Door

RANGES = {
    "running": flag("it runs"),
    "genset_kw": POWER,
    "genset_ordered_kw": POWER,
    "fuel_litres": Range(
        0.0, 1e7, NUMBER, "Give what is in the tank, in l.", "is more than any tank: check the unit"
    ),
    "start_fault": flag("it failed to start"),
}
"""Plausible ranges of sets' readings, and of another sender's orders to them."""

MEANS: tuple[str, ...] = ("genset_kw",)
HELD = ("fuel_litres",)
SETPOINT, NUMBERS = "p_kw", ("p_kw",)
"""The number that an operator says, and those that a set-point must have."""

FORESEEN = ("genset_kw", "fuel_litres")
"""Tables of what a plan foresees."""

SHOWN = ("running", "fuel_litres")
FIGURES = ("p_min_kw", "p_max_kw", "tank_litres", "litres_per_kwh", "litres_per_h_idle")
"""Readings and columns that the page shows."""

QUANTITIES = ("running", "genset_kw", "fuel_litres", "start_fault")
"""Quantities that a set can report."""

STILL_SHARE = 0.05
"""Share of the tank that a set may have burnt while its gauge stands still: gauges are coarse."""


@dataclass(frozen=True, eq=False)
class Ran:
    """Sets from the beginning of a step on, as their set-points have them run, (G,) each."""

    at_h: float  #: when it began, in h since the controller's first step
    before: GensetState  #: state then, with the least fuel that may have been in the tank
    most_litres: Floats  #: the most that may have been
    read_litres: Floats  #: last reading of the gauge; NaN if there was none
    out: Flags  #: sets that do not start
    fault: Floats  #: what each said last of a fault; NaN if nothing
    #: How they were to run.
    on: Flags
    power_kw: Floats
    asked_h: Floats | None = None  #: :attr:`waits_since_h`; None in states of earlier versions

    @property
    def waits_since_h(self) -> Floats:
        """Time of the order to start of each that has not run since; NaN of others, (G,)."""
        if self.asked_h is None:
            return np.where(self.on & ~self.before.on, self.at_h, np.nan)
        return self.asked_h

    @classmethod
    def before_the_day(cls, sets: Gensets, at_h: float) -> Ran:
        """Without readings: the state of the scenario."""
        first = GensetState.at_first(sets)
        unread = np.full(len(sets), np.nan)
        out = np.zeros(len(sets), dtype=bool)
        return cls(at_h, first, first.fuel_litres, unread, out, unread, first.on, first.power_kw)

    def as_ordered(self, ordered_kw: Floats) -> Ran:
        """State after another sender's orders; NaN where there was none."""
        by_others = np.isfinite(ordered_kw)
        power_kw = np.where(by_others, ordered_kw, self.power_kw)
        return replace(self, on=np.where(by_others, power_kw > 0.0, self.on), power_kw=power_kw)


@dataclass(frozen=True, eq=False)
class GensetReadings:
    """Readings of sets at the beginning of a step, (G,) each; NaN where there is none.

    ``ordered_kw`` is the most that another sender ordered each since the last decision, and
    ``gauge_age_h`` how old the readings of fuel are.
    """

    running: Floats
    power_kw: Floats
    fuel_litres: Floats
    start_fault: Floats
    ordered_kw: Floats
    gauge_age_h: Floats


PAST = Ran


def read(
    door: Door,
    scenario: Scenario,
    measured: Mapping[str, Any],
    ages_h: Mapping[str, Floats],
    past: Ran | None,
) -> tuple[Scenario, GensetReadings]:
    """Readings of sets, and the orders of another sender."""
    names = ("running", "genset_kw", "fuel_litres", "start_fault", "genset_ordered_kw")
    ids, none = scenario.gensets.id, np.full(len(scenario.gensets), np.nan)
    values = {name: door.values(name, measured[name], ids, none) for name in names}
    return scenario, GensetReadings(
        running=values["running"],
        power_kw=values["genset_kw"],
        fuel_litres=values["fuel_litres"],
        start_fault=values["start_fault"],
        ordered_kw=values["genset_ordered_kw"],
        gauge_age_h=ages_h["fuel_litres"],
    )


def now(moment: Moment, told: GensetReadings, past: Ran | None) -> SetsNow:
    """Sets at the moment, with what was delivered since their last set-points."""
    known = moment.known
    sets, dt_h, at_h = known.gensets, known.grid.dt_h, moment.at_h
    past = past or Ran.before_the_day(sets, at_h)
    begun = moment.begun_since(past.at_h)
    added = known.refuelled_litres[begun.start : begun.stop].sum(axis=0)
    return SetsNow.of(sets, told, past, at_h, dt_h, added)


@dataclass(frozen=True, eq=False)
class SetsNow(UnitsNow):
    """Sets at the beginning of a step, (G,) each.

    Fuel of the state is the reading, or the least that may be left. ``known`` is what is known of
    them before their next set-points; its fuel is the least that may be left since
    the gauge moved.
    """

    known: Ran

    @classmethod
    def of(
        cls, sets: Gensets, told: GensetReadings, past: Ran, at_h: float, dt_h: float, added: Floats
    ) -> SetsNow:
        """The sets after their set-points, ``added`` fuel having been delivered since.

        ``past`` says how they were to run since. After the end of its step they have no set-point:
        they stop. Times are in h since the controller's first step.
        """
        by_others, was_told_kw = np.isfinite(told.ordered_kw), past.power_kw
        past = past.as_ordered(told.ordered_kw)
        gone_h = at_h - past.at_h
        runs = _Running.of(told, past, by_others, gone_h, dt_h)
        burning_h = np.where(runs.on | by_others, gone_h, min(gone_h, dt_h))
        fuel = _Fuel.of(sets, told, past, runs, burning_h, added, gone_h, EARLY_SHARE * dt_h)
        unread = np.isnan(told.power_kw)
        gave_kw = np.where(unread, past.power_kw, told.power_kw)
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
            asked_h=np.where(runs.started, np.nan, past.waits_since_h),
        )
        words = (*fuel.words(sets.id), *runs.words(sets.id))
        metered_kw = np.where(unread, was_told_kw, told.power_kw)
        return cls(state, -float(metered_kw.sum()), float(was_told_kw[unread].sum()), words, known)

    @property
    def out(self) -> Flags:
        """Sets that do not start."""
        return self.known.out

    def able(self, ahead: SetsAhead) -> SetsAhead:  # type: ignore[override]
        """A window in which no set runs that is out."""
        can_run, must_run = ahead.can_run & ~self.out, ahead.must_run & ~self.out
        return replace(ahead, units=self._able(ahead.units), can_run=can_run, must_run=must_run)

    def believed(self, scenario: Scenario) -> Scenario:
        """A scenario in which sets that are out do not start by themselves."""
        if not self.out.any():
            return scenario
        return replace(scenario, gensets=self._able(scenario.gensets))

    def _able(self, sets: Gensets) -> Gensets:
        """Sets of which those that are out form no grid."""
        return replace(sets, grid_forming=sets.grid_forming & ~self.out)

    def columns(self) -> dict[str, Any]:
        """Sets that do not start."""
        return {"out": self.out}

    def after(self, day: Scenario, state: GensetState, columns: Mapping[str, Any]) -> Ran:
        """The sets with their set-points from now on."""
        known, on = self.known, columns["running"]
        begins = on & ~self.state.on & np.isnan(known.waits_since_h)
        asked_h = np.where(begins, known.at_h, np.where(on, known.waits_since_h, np.nan))
        return replace(known, on=on, power_kw=columns["p_kw"], asked_h=asked_h)


@dataclass(frozen=True, eq=False)
class _Running:
    """Which sets run and for how long, (G,) each; who was to start and never did, and who is out.

    ``failed`` stood still for a whole step in which they were to run, ``faulty`` tell a fault.
    ``started`` were read to run, or took the time of a step for which nothing was read.
    """

    on: Flags
    started: Flags
    hours: Floats
    never: Flags
    out: Flags
    failed: Flags
    faulty: Flags

    @classmethod
    def of(
        cls, told: GensetReadings, past: Ran, by_others: Flags, gone_h: float, dt_h: float
    ) -> _Running:
        """The estimate so many hours after their set-points; ``by_others``, by another sender."""
        held = gone_h <= dt_h + ROUNDING_H
        was, read = past.before.on, np.isfinite(told.running)
        gave_nothing = (past.power_kw > 0.0) & (told.power_kw <= 0.0)
        faulty = told.start_fault > 0.5
        on = np.where(read, told.running > 0.5, past.on & held & ~gave_nothing & ~faulty)
        never = np.isfinite(past.waits_since_h) & ~on & held & ~(told.power_kw > 0.0)
        # A decision within the step does not begin the wait anew.
        waited = past.at_h + gone_h - past.waits_since_h >= dt_h - ROUNDING_H
        failed = never & ~by_others & waited
        started = on & (read | (told.power_kw > 0.0) | waited)
        hours = _hours(past, on, gone_h, dt_h)
        # When another sender switched is not known.
        hours = np.where(by_others & ((was != on) | (past.on != on)), 0.0, hours)
        kept = past.out & ~((told.start_fault <= 0.5) & (past.fault != 0.0))
        out = (failed | faulty | kept) & ~on
        return cls(on, started, hours, never, out, failed, faulty)

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
        told: GensetReadings,
        past: Ran,
        runs: _Running,
        burning_h: Floats,
        added: Floats,
        since_h: float,
        early_h: float,
    ) -> _Fuel:
        """Fuel that is left after so many hours of burning and what was delivered."""
        burnt = _burnt_litres(sets, told, past, runs.on, runs.never)
        left = zip((past.before.fuel_litres, past.most_litres), burnt, strict=True)
        least, most = (
            np.minimum(np.maximum(was - per_h * burning_h, 0.0) + added, sets.tank_litres)
            for was, per_h in left
        )
        told_litres = np.minimum(told.fuel_litres, sets.tank_litres)
        age_h = told.gauge_age_h
        same = told_litres == past.read_litres
        # One that a clock ahead dates a little later than the last decision was known then.
        known = (age_h > since_h + ROUNDING_H) | (same & (age_h > since_h - early_h))
        gauged = np.isfinite(told_litres) & ~(known & np.isfinite(past.read_litres))
        still = gauged & same
        # What it has burnt since the gauge was read.
        gone_h = np.minimum(age_h, burning_h)
        now_litres = [np.maximum(told_litres - per_h * gone_h, 0.0) for per_h in burnt]
        least, most = (
            np.where(gauged & ~still, now, left)
            for now, left in zip(now_litres, (least, most), strict=True)
        )
        frozen = still & (told_litres - most > STILL_SHARE * sets.tank_litres)
        return cls(
            litres=np.where(gauged & ~frozen, now_litres[0], least),
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


def _burnt_litres(
    sets: Gensets, told: GensetReadings, past: Ran, on: Flags, never: Flags
) -> list[Floats]:
    """The most and the least fuel that may have been burnt in an hour, by the line of each set.

    What was measured counts. Otherwise a set gave its set-point, or at least its least power;
    one that runs by hand, or may form the grid, may have given its largest.
    """
    measured = np.isfinite(told.power_kw)
    given = measured & (told.power_kw > 0.0)
    most_kw = np.where(past.on & ~sets.grid_forming, past.power_kw, sets.p_max_kw)
    least_kw = np.where(past.on, sets.p_min_kw, 0.0)
    may_have_run = (past.on | on | given) & ~never
    has_run = (past.on & on) | given
    return [
        sets.litres(ran, np.where(measured, told.power_kw, kw) * ran, dt_h=1.0)
        for ran, kw in ((may_have_run, most_kw), (has_run, least_kw))
    ]


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
    window: Scenario, known: SetsAhead, plan: UnitPlan, times: pd.DatetimeIndex
) -> dict[str, pd.DataFrame]:
    """Planned power and fuel of sets; nothing runs where a plan has none."""
    sets = window.gensets
    litres = known.fuel_litres(plan)
    names = [str(name) for name in sets.id]
    return {
        "genset_kw": pd.DataFrame(-plan.taken_kw[1:], times, names),
        "fuel_litres": pd.DataFrame(litres[1:], times, names),
    }


def own_ranges(scenario: Scenario) -> Iterator[tuple[str, Any, Floats, Callable[[float], Range]]]:
    """Ranges of sets' power and of the fuel in their tanks."""
    sets = scenario.gensets
    yield "genset_kw", sets, sets.p_max_kw, lambda kw: rated(0.0, "set", kw, NUMBER)
    yield "fuel_litres", sets, sets.tank_litres, _in_tank


def _in_tank(litres: float) -> Range:
    """Up to more than what a tank holds."""
    beyond = f"is more than its tank of {litres:g} l holds"
    return replace(RANGES["fuel_litres"], highest=RATED_SHARE * litres, beyond=beyond)


def excesses(table: pd.DataFrame, scenario: Scenario) -> dict[str, Any]:
    """Excess of set-points beyond ratings; what stands still gives nothing."""
    sets = scenario.gensets
    on, p_kw = table["running"].to_numpy(bool), table["p_kw"].to_numpy(float)
    below_kw = np.where(on, sets.p_min_kw - p_kw, -p_kw)
    return {
        "power above its rating": above_rating(p_kw, sets.p_max_kw),
        "power below its least": below_kw - slack_kw(sets.p_max_kw),
        "power without running": np.where(on, -np.inf, p_kw - POWER_KW),
    }


def defaults(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Sets stand still, by set."""
    return {str(name): {"running": False, "p_kw": 0.0} for name in scenario.gensets.id}


def by_rule(now: Scenario) -> dict[str, Any]:
    """Sets go on with their last set-points."""
    return {}


def expected(rows: pd.DataFrame) -> dict[str, Any]:
    """State that a plan begins its step with, and fuel at its end, by set."""
    numbers = ("hours_before", "p_before_kw", "fuel_litres", "fuel_end_litres")
    return {
        "gensets": {
            str(name): {one: number_or_none(row[one]) for one in numbers}
            | {"out": bool(row["out"])}
            for name, row in rows.iterrows()
        }
    }
