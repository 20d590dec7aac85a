"""Generating sets over the steps of a window: arrays, by set.

:mod:`vppres.kinds.gensets.rows` states a problem with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError
from vppres.kinds.gensets.data import ROUNDING_H, Gensets, GensetState, steps_of
from vppres.kinds.kind import UnitsAhead
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class SetsAhead(UnitsAhead):
    """State and limits of sets in a window, (W, G) each.

    Parameters
    ----------
    can_run : array of bool
        Steps in which a set may be on.
    rested : array of bool
        Steps in which a set that is off has been so for its least time.
    must_run : array of bool
        Steps in which a set that is on has not yet been so for its least time.
    was_on, was_kw : array
        Whether a set was on before the window, and its power; only in the first step.
    added_litres : array
        Fuel that comes into the tank; in the first step all that is in it.
    forms : array of bool
        Steps in which a set is what forms the grid; it must run in them.
    headroom_kw : array
        Power that it leaves free then above its plan and below it, with fuel for a step of it.
    """

    can_run: Flags
    rested: Flags
    must_run: Flags
    was_on: Floats
    was_kw: Floats
    added_litres: Floats
    forms: Flags
    headroom_kw: Floats

    @classmethod
    def of(cls, scenario: Scenario, steps: range, now: GensetState, past_days: Any = None) -> Self:
        """The window that begins with sets in this state.

        No set has to stay on for longer than its fuel lasts.
        """
        sets, dt_h = scenario.gensets, scenario.grid.dt_h
        n_steps = len(steps)
        step = np.arange(n_steps)[:, None]
        left_on = steps_of(np.where(now.on, sets.min_on_h - now.hours, 0.0), dt_h)
        delivered = scenario.refuelled_litres[steps.start : steps.stop]
        enough = now.fuel_litres >= (step + 1) * sets.least_litres(dt_h)
        left_off = steps_of(np.where(now.on, 0.0, sets.min_off_h - now.hours), dt_h)
        return cls(
            np.ones((n_steps, len(sets)), dtype=bool),
            step >= left_off,
            (step < left_on) & enough,
            _first(now.on.astype(float), n_steps),
            _first(now.power_kw, n_steps),
            _first(now.fuel_litres, n_steps) + delivered,
            np.zeros((n_steps, len(sets)), dtype=bool),
            np.zeros((n_steps, len(sets))),
        )

    def in_the_dark(self, lit: Flags) -> Self:
        """Window with every set off except in the lit steps, (W, 1)."""
        return replace(
            self,
            can_run=self.can_run & lit,
            must_run=self.must_run & lit,
            forms=self.forms & lit,
            headroom_kw=self.headroom_kw * lit,
        )

    def without_duties(self) -> Self:
        """Window without sets that have to stay on."""
        return replace(self, must_run=np.zeros_like(self.must_run))

    def forming(self, forms: Flags, headroom_kw: Floats) -> Self:
        """Window with sets that form the grid, (W, G), and leave power free then, (G,)."""
        return replace(
            self,
            must_run=self.must_run | forms,
            forms=forms,
            headroom_kw=np.where(forms, headroom_kw, 0.0),
        )

    def kept_litres(self, sets: Gensets, dt_h: float) -> Floats:
        """Fuel that is left at least at the end of each step, (W, G)."""
        return dt_h * sets.litres_per_kwh * self.headroom_kw

    def q_most_kvar(self, sets: Gensets) -> Floats:
        """Largest reactive power of each set, (W, G): none of those that follow."""
        return np.where(self.forms, sets.q_max_kvar, 0.0)

    def most_given_kw(self, sets: Gensets) -> Floats:
        """Most that all give together, (W,)."""
        return np.asarray(self.can_run @ sets.p_max_kw)

    def power_beyond_kw(
        self, sets: Gensets, connected: Flags, taken_kw: Floats, running: Flags, dt_h: float
    ) -> Floats:
        """Excess of powers beyond what sets can do, ramps included, (W, G)."""
        over = (
            -taken_kw + self.headroom_kw - running * sets.p_max_kw,
            running * sets.p_min_kw + self.headroom_kw + taken_kw,
            self.moved_too_fast_kw(sets, running, -taken_kw, dt_h),
        )
        return np.asarray(np.max(over, axis=0))

    def stored_beyond_kw(
        self, sets: Gensets, taken_kw: Floats, running: Flags, dt_h: float
    ) -> Floats:
        """Fuel that is missing, as a power over the step, (W, G)."""
        fuel_litres = self.fuel_litres(sets, running, -taken_kw, dt_h)
        missing_litres = self.kept_litres(sets, dt_h) - fuel_litres
        return missing_litres / (sets.litres_per_kwh * dt_h)

    def may_start(self, sets: Gensets, outage: Flags) -> Flags:
        """Steps in which a set that is off may start, (W, G); ``outage`` has the shape (W,)."""
        return self.rested & self.can_run & (outage[:, None] | ~sets.only_in_outage)

    @property
    def usable(self) -> Flags:
        """Sets that may be on in any step, (G,)."""
        return np.asarray(self.can_run.any(axis=0))

    def on_before(self, on: Flags) -> Flags:
        """Whether each set was on in the step before, (W, G)."""
        return np.vstack([self.was_on[:1] > 0.5, on[:-1]])

    def starts(self, on: Flags) -> Flags:
        """Steps in which a set starts, (W, G)."""
        return on & ~self.on_before(on)

    def fuel_litres(self, sets: Gensets, on: Flags, power_kw: Floats, dt_h: float) -> Floats:
        """Fuel at the end of each step, (W, G), negative where there is not enough."""
        burnt = sets.litres(on, power_kw, dt_h)
        level = np.zeros(len(sets))
        rows = []
        for added, used in zip(self.added_litres, burnt, strict=True):
            level = np.minimum(level + added, sets.tank_litres) - used
            rows.append(level)
        return np.array(rows).reshape(burnt.shape)

    def moved_too_fast_kw(self, sets: Gensets, on: Flags, power_kw: Floats, dt_h: float) -> Floats:
        """Excess of the change of powers beyond ramps, (W, G).

        A set may stop from any power, and one that forms the grid follows the load at once.
        """
        before_on = self.on_before(on)
        before_kw = np.vstack([self.was_kw[:1], power_kw[:-1]])
        most_kw = np.where(before_on, before_kw + sets.rise_kw(dt_h), sets.first_kw(dt_h))
        least_kw = np.where(before_on, before_kw - sets.fall_kw(dt_h), 0.0)
        return np.where(on & ~self.forms, np.maximum(power_kw - most_kw, least_kw - power_kw), 0.0)

    def wrongly_switched(self, sets: Gensets, on: Flags, outage: Flags, dt_h: float) -> Flags:
        """Steps in which a set is on or off against a rule, (W, G)."""
        may_start = self.may_start(sets, outage)
        starts = self.starts(on)
        stops = self.on_before(on) & ~on
        wrong = (on & ~self.can_run) | (self.must_run & ~on) | (starts & ~may_start)
        least_on = np.maximum(steps_of(sets.min_on_h, dt_h), 1)
        least_off = np.maximum(steps_of(sets.min_off_h, dt_h), 1)
        for g in range(len(sets)):
            young = np.zeros(len(on), dtype=bool)
            for t in np.flatnonzero(starts[:, g]):
                young[t : t + least_on[g]] = True
                wrong[t : t + least_on[g], g] |= (~on & self.can_run)[t : t + least_on[g], g]
            for t in np.flatnonzero(stops[:, g]):
                wrong[t : t + least_off[g], g] |= on[t : t + least_off[g], g]
            in_use = outage | ~sets.only_in_outage[g] | young | self.must_run[:, g]
            wrong[:, g] |= on[:, g] & ~in_use
        return wrong


def _first(values: Floats, n_steps: int) -> Floats:
    """Values in the first of some steps, 0 in all others, (W, G)."""
    rows = np.zeros((n_steps, len(values)))
    rows[0] = values
    return rows


LEAST_KW = 1e-6
"""By how much a power may miss the least of a set, or its fuel: the rounding of plans."""


class Engines:
    """State of all generating sets from step to step.

    Parameters
    ----------
    scenario : Scenario
        Sets and steps.

    Attributes
    ----------
    state : GensetState
        Sets at the end of the last step.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.state = GensetState.at_first(scenario.gensets)

    def tank_litres(self, t: int) -> Floats:
        """Fuel at the beginning of a step, with what is delivered then and fits in."""
        filled = self.state.fuel_litres + self.scenario.refuelled_litres[t]
        return np.asarray(np.minimum(filled, self.scenario.gensets.tank_litres))

    def possible(self, t: int, on: Flags, wanted_kw: Floats) -> tuple[Flags, Floats]:
        """Which sets run of those that are to, and the power of each nearest to what is wanted.

        A set starts once it has been off for its least time, and stops at once when its set-point
        says so, or when its fuel is not enough for its least power over the step.
        """
        sets = self.scenario.gensets
        dt_h = self.scenario.grid.dt_h
        was_on, was_kw = self.state.on, self.state.power_kw
        started = ~was_on & (self.state.hours >= sets.min_off_h - ROUNDING_H)
        step_kw = dt_h * sets.ramp_up_kw_per_h
        most_kw = np.where(was_on, was_kw + step_kw, np.maximum(sets.p_min_kw, step_kw))
        litres_per_h = self.tank_litres(t) / dt_h - sets.litres_per_h_idle
        by_fuel_kw = litres_per_h / sets.litres_per_kwh
        most_kw = np.minimum(np.minimum(most_kw, sets.p_max_kw), by_fuel_kw)
        fallen_kw = np.where(was_on, was_kw - dt_h * sets.ramp_down_kw_per_h, 0.0)
        least_kw = np.maximum(sets.p_min_kw, fallen_kw)
        runs = on & (was_on | started) & (most_kw > sets.p_min_kw - LEAST_KW)
        within_kw = np.minimum(np.maximum(wanted_kw, least_kw), most_kw)
        return runs, np.where(runs, np.maximum(within_kw, 0.0), 0.0)

    def at(self, t: int) -> GensetState:
        """State at the beginning of a step."""
        return self.state

    def on(self, served: Flags) -> Flags:
        """All of them: sets are of no customer, (G,)."""
        return np.ones(len(self.scenario.gensets), dtype=bool)

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """:meth:`possible`, as power that sets take."""
        runs, given_kw = self.possible(t, running, -wanted_kw)
        return -given_kw, runs

    def able_to_form(self, t: int, runs: Flags) -> list[int]:
        """Sets that can form the grid in a step, those that run first, then the largest.

        They start by themselves, where they may, when nothing else forms it.
        """
        sets = self.scenario.gensets
        ready = self.state.on | (self.state.hours >= sets.min_off_h - ROUNDING_H)
        least_kw, most_kw = self.forming_kw(t)
        able = sets.grid_forming & ready & (most_kw > least_kw - LEAST_KW)
        order = np.lexsort((-sets.p_max_kw, ~(runs & able)))
        return [int(g) for g in order if able[g]]

    def forming_kw(self, t: int) -> tuple[Floats, Floats]:
        """Least and largest power over a step while forming the grid, without ramps, (G,) each."""
        sets = self.scenario.gensets
        litres_per_h = self.tank_litres(t) / self.scenario.grid.dt_h - sets.litres_per_h_idle
        return sets.p_min_kw, np.minimum(sets.p_max_kw, litres_per_h / sets.litres_per_kwh)

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """Power of each beyond its least, (G,)."""
        return -taken_kw - np.where(running, self.scenario.gensets.p_min_kw, 0.0)

    def after(self, t: int, on: Flags, power_kw: Floats) -> GensetState:
        """State at the end of a step in which sets run with these powers."""
        sets = self.scenario.gensets
        dt_h = self.scenario.grid.dt_h
        per_h = np.where(on, sets.litres_per_h_idle + sets.litres_per_kwh * power_kw, 0.0)
        left = np.maximum(self.tank_litres(t) - per_h * dt_h, 0.0)
        hours = np.where(on == self.state.on, self.state.hours + dt_h, dt_h)
        return GensetState(on, hours, np.where(on, power_kw, 0.0), left)

    def advance(self, t: int, taken_kw: Floats, running: Flags) -> None:
        """The state at the end of a step."""
        self.state = self.after(t, running, -taken_kw)


WINDOW, PLANT = SetsAhead, Engines


def check_prices(scenario: Scenario, horizon_h: float, seed: int) -> None:
    """Refuse fuel and starts that could outweigh a customer of the first tier.

    Raises
    ------
    InputError
        If a start and the least time on of all sets at their largest power, a step at least, cost
        as much as a step of such a customer counts.
    """
    sets, dt_h = scenario.gensets, scenario.grid.dt_h
    on_h = np.maximum(sets.min_on_h, dt_h)
    litres = on_h * sets.litres(np.ones(len(sets), dtype=bool), sets.p_max_kw, dt_h=1.0)
    dearest_gbp = float((litres * sets.fuel_price_gbp_per_litre + sets.start_cost_gbp).sum())
    customers = scenario.customers
    first = customers.weight[customers.tier == scenario.tiers[0]]
    least = float(first.min(initial=np.inf)) * dt_h
    if scenario.objective.lambda_grid * dearest_gbp >= least:
        raise InputError.of(
            "scenario.toml",
            "makes fuel and starts of sets count as much as a customer of the first tier",
            f"Give less than {least / dearest_gbp:.1e}.",
            field="objective.lambda_grid",
            value=scenario.objective.lambda_grid,
        )
