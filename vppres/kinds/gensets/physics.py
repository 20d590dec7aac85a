"""Generating sets over the steps of a window: arrays, by set.

:mod:`vppres.kinds.gensets.rows` states a problem with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import InputError
from vppres.kinds.gensets import ROUNDING_H, Gensets, GensetState, steps_of
from vppres.kinds.kind import EnergyHeld, Followers, UnitPlan, UnitsAhead
from vppres.scenario.scenario import Scenario

LARGEST_SHARE = 0.25
"""Share of the range of powers of a set that its headroom may take up, at either end."""


@dataclass(frozen=True, eq=False)
class SetsAhead(UnitsAhead):
    """State and limits of sets in a window, (W, G) each."""

    switched: ClassVar[bool] = True

    units: Gensets
    can_run: Flags  #: steps in which a set may be on
    rested: Flags  #: steps in which a set that is off has been so for its least time
    must_run: Flags  #: steps in which a set that is on has not yet been so for its least time
    #: Whether a set was on before the window, and its power; only in the first step.
    was_on: Floats
    was_kw: Floats
    added_litres: Floats  #: fuel that comes into the tank; in the first step all that is in it
    forms: Flags  #: steps in which a set is what forms the grid; it must run in them
    #: Power that it leaves free then above its plan and below it, with fuel for a step of it.
    headroom_kw: Floats
    holds: Flags  #: steps in which a set gives its part reactive power while it runs

    @classmethod
    def of(cls, scenario: Scenario, steps: range, now: GensetState, past_days: Any = None) -> Self:
        """The window that begins with sets in this state.

        No set has to stay on for longer than its fuel lasts.
        """
        sets, dt_h = scenario.gensets, scenario.grid.dt_h
        n_steps, none = len(steps), np.zeros((len(steps), len(sets)), dtype=bool)
        step = np.arange(n_steps)[:, None]
        left_on = steps_of(np.where(now.on, sets.min_on_h - now.hours, 0.0), dt_h)
        delivered = scenario.refuelled_litres[steps.start : steps.stop]
        enough = now.fuel_litres >= (step + 1) * sets.least_litres(dt_h)
        left_off = steps_of(np.where(now.on, 0.0, sets.min_off_h - now.hours), dt_h)
        return cls(
            sets,
            dt_h,
            ~none,
            step >= left_off,
            (step < left_on) & enough,
            _first(now.on.astype(float), n_steps),
            _first(now.power_kw, n_steps),
            _first(now.fuel_litres, n_steps) + delivered,
            none,
            none.astype(float),
            none,
        )

    def in_the_dark(self, lit: Flags) -> Self:
        """Window with every set off except in the lit steps, (W, 1)."""
        return replace(
            self,
            can_run=self.can_run & lit,
            must_run=self.must_run & lit,
            forms=self.forms & lit,
            headroom_kw=self.headroom_kw * lit,
            holds=self.holds & lit,
        )

    def without_duties(self) -> Self:
        """Window without sets that have to stay on."""
        return replace(self, must_run=np.zeros_like(self.must_run))

    def holding(self, part: Wholes) -> Self:
        """Window in which the largest set that can run in a step holds its part: one of several.

        It can if it may be on, and has had fuel for a step at its least power by then.
        """
        return replace(self, holds=_holding(self, part))

    def forming_steps(self) -> Flags:
        """Steps in which each forms the grid of an island, (W, G)."""
        return self.forms

    def holding_steps(self) -> Flags:
        """Steps in which each holds a part if it runs, (W, G)."""
        return self.holds

    def kept_kw(self) -> Floats:
        """Headroom of the set that forms the grid, (W, G)."""
        return self.headroom_kw

    def able_to_form(self) -> Flags:
        """Sets that are to form islands, (G,)."""
        return np.asarray(self.units.grid_forming)

    def formed(self, dark: Flags, headroom: float) -> tuple[Self, Flags]:
        """Window with the set that forms dark steps, (W,), as far as it can, and these steps.

        It runs in every step in which it can, and what it forms is lit then; no plan lets an island
        go dark to save fuel. So who forms the grid is known before the window is solved, and its
        voltages can be held at one bus in each step.

        Of several the one forms it that can for most steps, then the one that runs, then the
        largest. Once its fuel ends it runs no more in the window, but for steps that it forms.
        """
        room_kw = headroom_kw(self.units, headroom)
        best, lit = _best_former(self, dark, room_kw)
        if not lit.any():
            return self, lit
        forms, can_run = np.zeros_like(self.forms), self.can_run.copy()
        forms[:, best] = lit
        since_lit = np.logical_or.accumulate(lit)
        can_run[:, best] &= lit | ~np.logical_or.accumulate(dark & ~lit & since_lit)
        formed = replace(
            self,
            can_run=can_run,
            must_run=self.must_run | forms,
            forms=forms,
            headroom_kw=np.where(forms, room_kw, 0.0),
        )
        return formed, lit

    def by_rule(self, lacking_kw: float, island: bool) -> Sequence[tuple[Floats, Flags]]:
        """Sets as they are, at what is left of the demand beside PV, at their least power."""
        sets = self.units
        share = sets.p_max_kw / sets.p_max_kw.sum()
        every_kw = (self.was_kw[0], lacking_kw * share, 0.0 * share)
        return [self.beside(wanted_kw, island) for wanted_kw in every_kw]

    def beside(self, wanted_kw: Floats, island: bool) -> tuple[Floats, Flags]:
        """Sets that are on or form an island or part, and have fuel, near what they are to give."""
        least_kw, most_kw = _range_kw(self)
        wanted = (self.was_on[0] > 0.5) | self.forms[0] | self.holds[0]
        in_use = island | ~self.units.only_in_outage | self.must_run[0]
        on = wanted & in_use & self.can_run[0] & (most_kw >= least_kw)
        return -np.where(on, np.clip(wanted_kw, least_kw, most_kw), 0.0), on

    def store(self, scenario: Scenario, steps: range, eta_discharge: float) -> EnergyHeld:
        """Fuel, as what a set at its largest power makes of it."""
        sets, usable = self.units, self.can_run.any(axis=0)
        kwh_per_litre = np.where(usable, sets.kwh_per_litre / eta_discharge, 0.0)
        delivered = scenario.refuelled_litres[steps.start : steps.stop] @ kwh_per_litre
        delivered[0] = 0.0  # it is in the tank already
        held = np.minimum(self.added_litres[0], sets.tank_litres)
        power_kw = float(sets.p_max_kw[usable].sum())
        return EnergyHeld(kwh_per_litre, power_kw, float(held @ kwh_per_litre), delivered)

    def left_kwh(self, plan: UnitPlan, kwh_each: Floats) -> float:
        """Energy in a battery that stands for the fuel that is left; ``kwh_each`` is of a litre."""
        return float(self.fuel_litres(plan)[-1] @ kwh_each)

    def most_left_kwh(self, kwh_each: Floats) -> float:
        """Most energy that fuel at the end of the window can stand for."""
        return float(self.added_litres.sum(axis=0) @ kwh_each)

    def q_most_kvar(self) -> Floats:
        """Largest reactive power of each set, (W, G): none of those that follow."""
        return np.where(self.forms | self.holds, self.units.q_max_kvar, 0.0)

    def most_given_kw(self) -> Floats:
        """Most that all give together, (W,)."""
        return np.asarray(self.can_run @ self.units.p_max_kw)

    def power_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of powers beyond what sets can do, ramps included, (W, G)."""
        sets = self.units
        over = (
            -plan.taken_kw + self.headroom_kw - plan.running * sets.p_max_kw,
            plan.running * sets.p_min_kw + self.headroom_kw + plan.taken_kw,
            moved_too_fast_kw(self, plan),
        )
        return np.asarray(np.max(over, axis=0))

    def stored_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Fuel that is missing, as a power over the step, (W, G)."""
        litres_per_kw = self.units.litres_per_kwh * self.dt_h
        missing_litres = litres_per_kw * self.headroom_kw - self.fuel_litres(plan)
        return missing_litres / litres_per_kw

    def may_start(self, outage: Flags) -> Flags:
        """Steps in which a set that is off may start, (W, G), as ``outage`` at its bus."""
        return self.rested & self.can_run & (outage | ~self.units.only_in_outage)

    def on_before(self, on: Flags) -> Flags:
        """Whether each set was on in the step before, (W, G)."""
        return np.vstack([self.was_on[:1] > 0.5, on[:-1]])

    def starts(self, on: Flags) -> Flags:
        """Steps in which a set starts, (W, G)."""
        return on & ~self.on_before(on)

    def fuel_litres(self, plan: UnitPlan) -> Floats:
        """Fuel at the end of each step, (W, G), negative where there is not enough."""
        sets = self.units
        burnt = sets.litres(plan.running, -plan.taken_kw, self.dt_h)
        level = np.zeros(len(sets))
        rows = []
        for added, used in zip(self.added_litres, burnt, strict=True):
            level = np.minimum(level + added, sets.tank_litres) - used
            rows.append(level)
        return np.array(rows).reshape(burnt.shape)

    def switched_early(self, on: Flags, outage: Flags) -> Flags:
        """Steps in which a set starts before it may, or runs where it must not, (W, G)."""
        return (self.starts(on) & ~self.may_start(outage)) | (on & ~self.can_run)

    def wrongly_switched(self, on: Flags, outage: Flags) -> Flags:
        """Steps in which a set is on or off against a rule, (W, G)."""
        wrong = (on & ~self.can_run) | (self.must_run & ~on)
        wrong |= self.starts(on) & ~self.may_start(outage)
        return wrong | _broken_times(self, on, outage)


def _range_kw(ahead: SetsAhead) -> tuple[Floats, Floats]:
    """Least and largest power in the first step of sets that are on or start in it, (G,) each."""
    sets, dt_h = ahead.units, ahead.dt_h
    forms, held_litres = ahead.forms[0], np.minimum(ahead.added_litres[0], sets.tank_litres)
    most_kw = most_by_fuel_kw(sets, held_litres, dt_h)
    starts = ahead.holds[0] & ~forms & (ahead.was_on[0] < 0.5)
    most_kw = np.where(starts, np.minimum(most_kw, first_kw(sets, dt_h)), most_kw)
    fallen_kw = np.where(forms, 0.0, ahead.was_kw[0] - sets.ramp_down_kw_per_h * dt_h)
    return np.maximum(sets.p_min_kw, fallen_kw), most_kw


def _holding(ahead: SetsAhead, part: Wholes) -> Flags:
    """Steps in which each set holds its part of the feeder, (W, G)."""
    sets = ahead.units
    had_litres = np.minimum(np.cumsum(ahead.added_litres, axis=0), sets.tank_litres)
    able = sets.grid_forming & ahead.can_run & ahead.rested
    able &= had_litres >= sets.least_litres(ahead.dt_h)
    holds = np.zeros_like(ahead.forms)
    for t, numbers in enumerate(part):
        for number in np.unique(numbers[able[t] & (numbers >= 0)]):
            inside = able[t] & (numbers == number)
            holds[t, np.argmax(np.where(inside, sets.p_max_kw, -1.0))] = True
    return holds


def _best_former(ahead: SetsAhead, dark: Flags, room_kw: Floats) -> tuple[int, Flags]:
    """Set that forms dark steps, (W,), before all others, and the steps that it forms."""
    sets = ahead.units
    able = np.flatnonzero(sets.grid_forming & dark.any()).tolist()
    lit_by = {g: _lit_by(ahead, g, dark, room_kw) for g in able}

    def rank(g: int) -> tuple[int, bool, float, int]:
        return int(lit_by[g].sum()), ahead.was_on[0, g] > 0.5, float(sets.p_max_kw[g]), -g

    best = max(lit_by, key=rank, default=0)
    return best, lit_by.get(best, np.zeros_like(dark))


def _lit_by(ahead: SetsAhead, g: int, dark: Flags, room_kw: Floats) -> Flags:
    """Steps that a set can form at its least power, (W,), if it has nothing else to do.

    It starts where it may, runs while it has fuel, and rests then.
    """
    sets, dt_h = ahead.units, ahead.dt_h
    least_kw = sets.p_min_kw + room_kw
    burnt = float(sets.litres(np.ones(len(sets), dtype=bool), least_kw, dt_h)[g])
    needed = burnt + dt_h * float(sets.litres_per_kwh[g] * room_kw[g])
    least_off = int(steps_of(sets.min_off_h[g], dt_h))
    lit = np.zeros(len(dark), dtype=bool)
    fuel, on, stopped = 0.0, bool(ahead.was_on[0, g] > 0.5), -least_off
    for t in range(len(dark)):
        fuel = min(fuel + float(ahead.added_litres[t, g]), float(sets.tank_litres[g]))
        ready = on or (bool(ahead.rested[t, g]) and t - stopped >= least_off)
        if dark[t] and ready and ahead.can_run[t, g] and fuel >= needed:
            lit[t] = on = True
            fuel -= burnt
        else:
            stopped = t if on else stopped
            on = False
    return lit


def moved_too_fast_kw(ahead: SetsAhead, plan: UnitPlan) -> Floats:
    """Excess of the change of powers beyond ramps, (W, G).

    A set may stop from any power, and one that forms the grid follows the load at once.
    """
    sets, dt_h = ahead.units, ahead.dt_h
    on, power_kw = plan.running, -plan.taken_kw
    before_on = ahead.on_before(on)
    before_kw = np.vstack([ahead.was_kw[:1], power_kw[:-1]])
    most_kw = np.where(before_on, before_kw + sets.ramp_up_kw_per_h * dt_h, first_kw(sets, dt_h))
    least_kw = np.where(before_on, before_kw - sets.ramp_down_kw_per_h * dt_h, 0.0)
    return np.where(on & ~ahead.forms, np.maximum(power_kw - most_kw, least_kw - power_kw), 0.0)


def _broken_times(ahead: SetsAhead, on: Flags, outage: Flags) -> Flags:
    """Steps against a least time on or off, or in which a set runs without an outage, (W, G)."""
    sets, dt_h = ahead.units, ahead.dt_h
    starts, stops = ahead.starts(on), ahead.on_before(on) & ~on
    wrong = np.zeros_like(on)
    least_on = np.maximum(steps_of(sets.min_on_h, dt_h), 1)
    least_off = np.maximum(steps_of(sets.min_off_h, dt_h), 1)
    for g in range(len(sets)):
        young = np.zeros(len(on), dtype=bool)
        for t in np.flatnonzero(starts[:, g]):
            young[t : t + least_on[g]] = True
            wrong[t : t + least_on[g], g] |= (~on & ahead.can_run)[t : t + least_on[g], g]
        for t in np.flatnonzero(stops[:, g]):
            wrong[t : t + least_off[g], g] |= on[t : t + least_off[g], g]
        in_use = outage[:, g] | ~sets.only_in_outage[g] | young | ahead.must_run[:, g]
        wrong[:, g] |= on[:, g] & ~in_use
    return wrong


def first_kw(sets: Gensets, dt_h: float) -> Floats:
    """Most that a set gives in the step in which it starts, (G,)."""
    return np.maximum(sets.p_min_kw, sets.ramp_up_kw_per_h * dt_h)


def most_by_fuel_kw(sets: Gensets, litres: Floats, dt_h: float) -> Floats:
    """Largest power over a step with so much fuel, (G,)."""
    by_fuel_kw = (litres / dt_h - sets.litres_per_h_idle) / sets.litres_per_kwh
    return np.asarray(np.minimum(sets.p_max_kw, by_fuel_kw))


def headroom_kw(sets: Gensets, share: float) -> Floats:
    """Power that each leaves free above and below its plan while it forms the grid, (G,)."""
    range_kw = sets.p_max_kw - sets.p_min_kw
    return np.minimum(share * sets.p_max_kw, LARGEST_SHARE * range_kw)


def _first(values: Floats, n_steps: int) -> Floats:
    """Values in the first of some steps, 0 in all others, (W, G)."""
    rows = np.zeros((n_steps, len(values)))
    rows[0] = values
    return rows


LEAST_KW = 1e-6
"""By how much a power may miss the least of a set, or its fuel: the rounding of plans."""


class Engines(Followers):
    """State of all generating sets from step to step.

    Attributes
    ----------
    state : GensetState
        Sets at the end of the last step.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario, scenario.gensets, GensetState.at_first(scenario.gensets))

    def tank_litres(self, t: int) -> Floats:
        """Fuel at the beginning of a step, with what is delivered then and fits in."""
        filled = self.state.fuel_litres + self.scenario.refuelled_litres[t]
        return np.asarray(np.minimum(filled, self.units.tank_litres))

    def possible(self, t: int, on: Flags, wanted_kw: Floats) -> tuple[Flags, Floats]:
        """Which sets run of those that are to, and the power of each nearest to what is wanted.

        A set starts once it has been off for its least time, and stops at once when its set-point
        says so, or when its fuel is not enough for its least power over the step.
        """
        sets, dt_h = self.units, self.dt_h
        was_on, was_kw = self.state.on, self.state.power_kw
        started = ~was_on & (self.state.hours >= sets.min_off_h - ROUNDING_H)
        most_kw = np.where(was_on, was_kw + sets.ramp_up_kw_per_h * dt_h, first_kw(sets, dt_h))
        most_kw = np.minimum(most_kw, most_by_fuel_kw(sets, self.tank_litres(t), dt_h))
        fallen_kw = np.where(was_on, was_kw - sets.ramp_down_kw_per_h * dt_h, 0.0)
        least_kw = np.maximum(sets.p_min_kw, fallen_kw)
        runs = on & (was_on | started) & (most_kw > sets.p_min_kw - LEAST_KW)
        within_kw = np.minimum(np.maximum(wanted_kw, least_kw), most_kw)
        return runs, np.where(runs, np.maximum(within_kw, 0.0), 0.0)

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
        sets = self.units
        ready = self.state.on | (self.state.hours >= sets.min_off_h - ROUNDING_H)
        least_kw, most_kw = self.forming_kw(t)
        able = sets.grid_forming & ready & (most_kw > least_kw - LEAST_KW)
        order = np.lexsort((-sets.p_max_kw, ~(runs & able)))
        return [int(g) for g in order if able[g]]

    def forming_kw(self, t: int) -> tuple[Floats, Floats]:
        """Least and largest power over a step while forming the grid, without ramps, (G,) each."""
        sets, dt_h = self.units, self.dt_h
        return sets.p_min_kw, most_by_fuel_kw(sets, self.tank_litres(t), dt_h)

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """Power of each beyond its least, (G,)."""
        return -taken_kw - np.where(running, self.units.p_min_kw, 0.0)

    def after(self, t: int, taken_kw: Floats, running: Flags) -> GensetState:
        """State at the end of a step in which sets run with these powers."""
        sets, dt_h = self.units, self.dt_h
        given_kw = np.where(running, 0.0 - taken_kw, 0.0)
        left = np.maximum(self.tank_litres(t) - sets.litres(running, given_kw, dt_h), 0.0)
        hours = np.where(running == self.state.on, self.state.hours + dt_h, dt_h)
        return GensetState(running, hours, given_kw, left)


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
