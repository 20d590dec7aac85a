"""Vehicles that are plugged in over the steps of a window: arrays, by charger.

:mod:`vppres.kinds.vehicles.rows` states a problem with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.kind import Followers, UnitPlan, UnitsAhead, price_scale, refuse_dear_energy
from vppres.kinds.vehicles import Chargers, Sessions
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

NEGLIGIBLE_KW = 1e-3
"""Power that counts as none: what is left of a plan when a vehicle is full."""


def stored_by(chargers: Chargers, power_kw: Floats) -> Floats:
    """By how much the energy of vehicles grows with these powers, in kW, (..., K)."""
    into, out_of = power_kw * chargers.eta_charge, power_kw / chargers.eta_discharge
    return np.where(power_kw > 0.0, into, out_of)


@dataclass(frozen=True, eq=False)
class PastDays:
    """Calendar days before a run, with the sessions that began on each of them.

    A day with a session that goes on in the run is none, nor is the one on which the run begins.
    Between the first and the last, a day without a session is one on which no vehicle came.
    """

    sessions: Sessions  #: those that ended before the first step of the run
    begun: Wholes  #: day on which each began, counted as :meth:`datetime.date.toordinal` does
    days: Wholes  #: the past days, counted alike
    seed: int  #: of the run

    @classmethod
    def of(cls, scenario: Scenario, seed: int) -> Self | None:
        """The past days of a scenario, None without any."""
        grid, sessions = scenario.grid, scenario.sessions
        over = sessions.over(grid.start)
        if not over.any():
            return None
        begun = np.array([grid.local(time).toordinal() for time in sessions.plug_in])
        shown = np.arange(begun[over].min(), begun[over].max() + 1)
        of_run = np.append(begun[~over], grid.local(grid.start).toordinal())
        days = np.setdiff1d(shown, of_run)
        return cls(sessions.rows(over), begun[over], days, seed) if len(days) else None

    def drawn_for(self, day: int) -> int:
        """The past day that a day is expected to be like: the same for a seed."""
        rng = np.random.default_rng([self.seed, day])
        return int(self.days[rng.integers(len(self.days))])

    def expected(self, grid: TimeGrid, steps: range) -> Sessions:
        """Sessions of the days of some steps, moved there by whole days."""
        ends = (grid.local(grid.start + t * grid.step) for t in (steps.start, steps.stop - 1))
        first, last = (time.toordinal() for time in ends)
        days = np.arange(first, last + 1)
        drawn = np.array([self.drawn_for(int(day)) for day in days])
        of_day, rows = np.nonzero(self.begun == drawn[:, None])
        later = (days - drawn)[of_day]
        moved = np.array([pd.Timedelta(days=int(each)) for each in later], dtype=object)
        found = self.sessions.rows(rows)
        return replace(found, plug_in=found.plug_in + moved, plug_out=found.plug_out + moved)


@dataclass(frozen=True, eq=False)
class Plugged(UnitsAhead):
    """Vehicles in W steps at K chargers, (W, K) each; energies in kWh."""

    units: Chargers
    here: Flags  #: steps in which a vehicle is plugged in, as far as is known or expected
    #: Those of them with a vehicle that is known. One that is expected may not come, and gives
    #: nothing back.
    known: Flags
    stays: Flags  #: steps that begin with the vehicle of the step before
    #: Energy in the vehicle of which it is the first step of the window, otherwise 0.
    held_kwh: Floats
    #: Energy that it holds at most, and below which it is not discharged.
    full_kwh: Floats
    floor_kwh: Floats
    #: Energy at the end of the step on the straight line from what it holds at plug-in to what it
    #: needs at departure.
    line_kwh: Floats
    weight: Floats  #: weight of its tier

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        steps: range,
        now_kwh: Floats,
        past_days: PastDays | None = None,
    ) -> Self:
        """The vehicles of a window as far as they are known when it begins.

        They are those that are plugged in then, and those that are announced. At chargers that are
        free of them, vehicles are expected to come later as on a past day.

        ``now_kwh`` is the energy of those that are plugged in, (K,). Without ``past_days`` none is
        expected.
        """
        shape = (len(steps), len(scenario.chargers))
        flags, numbers = ([np.zeros(shape, each) for _ in range(8)] for each in (bool, float))
        found = cls(scenario.chargers, scenario.grid.dt_h, *flags[:3], *numbers[3:])
        found._enter(scenario, scenario.sessions, steps, now_kwh)
        if past_days is not None:
            expected = past_days.expected(scenario.grid, steps)
            found._enter(scenario, expected, steps, now_kwh, expected=True)
        return found

    def _enter(
        self,
        scenario: Scenario,
        sessions: Sessions,
        steps: range,
        now_kwh: Floats,
        *,
        expected: bool = False,
    ) -> None:
        """Write sessions into the arrays: those that are known, or those that are expected."""
        column = {name: k for k, name in enumerate(scenario.chargers.id)}
        first, after = sessions.steps(scenario.grid)
        come = first <= steps.start
        counts = ~come if expected else sessions.announced | come
        inside = np.minimum(after, steps.stop) > np.maximum(first, steps.start)
        for s in np.flatnonzero(counts & inside):
            k = column[sessions.charger[s]]
            begin = max(first[s], steps.start) - steps.start
            end = min(after[s], steps.stop) - steps.start
            stay = slice(begin, end)
            if expected and self.here[stay, k].any():
                continue
            held_kwh = sessions.held_kwh[s]
            over = np.arange(steps.start + begin, steps.start + end) + 1 - first[s]
            grown = over / (after[s] - first[s])
            self.here[stay, k] = True
            self.known[stay, k] = not expected
            self.stays[begin + 1 : end, k] = True
            self.held_kwh[begin, k] = now_kwh[k] if come[s] else held_kwh
            self.full_kwh[stay, k] = sessions.full_kwh[s]
            self.floor_kwh[stay, k] = sessions.floor_kwh[s]
            self.line_kwh[stay, k] = held_kwh + grown * (sessions.needed_kwh[s] - held_kwh)
            self.weight[stay, k] = sessions.weight[s]

    @property
    def due(self) -> Flags:
        """Last steps of the vehicles: before they leave, or of the window, (W, K)."""
        return self.here & ~np.vstack([self.stays[1:], np.zeros_like(self.stays[:1])])

    @property
    def needed_kwh(self) -> Floats:
        """Energy that each vehicle is to have at the end of its last step, otherwise 0, (W, K).

        One that leaves after the window is to have its part of what it needs by then.
        """
        return np.where(self.due, self.line_kwh, 0.0)

    @property
    def lowest_kwh(self) -> Floats:
        """Energy below which each vehicle may not come, (W, K).

        It is its floor, or what it holds at first if that is less.
        """
        held = np.zeros(self.held_kwh.shape[1])
        rows = []
        for stays, begins_kwh in zip(self.stays, self.held_kwh, strict=True):
            held = np.where(stays, held, begins_kwh)
            rows.append(held)
        return np.minimum(self.floor_kwh, np.array(rows).reshape(self.floor_kwh.shape))

    def energy_kwh(self, power_kw: Floats) -> Floats:
        """Energy at the end of each step, (W, K), of a power that is negative to discharge."""
        stored_kw = stored_by(self.units, power_kw)
        held = np.zeros(len(self.units))
        rows = []
        for t, stays in enumerate(self.stays):
            held = np.where(stays, held, self.held_kwh[t]) + self.dt_h * stored_kw[t]
            rows.append(held)
        return np.array(rows).reshape(power_kw.shape)

    def short_kwh(self, energy_kwh: Floats) -> Floats:
        """Energy that each vehicle lacks when it leaves, (W, K)."""
        return np.maximum(self.needed_kwh - energy_kwh, 0.0)

    @classmethod
    def past_days(cls, scenario: Scenario, seed: int) -> PastDays | None:
        """Days whose sessions are drawn for those of a run; None without any."""
        return PastDays.of(scenario, seed)

    def in_the_dark(self, lit: Flags) -> Self:
        """Window with no vehicle plugged in except in the lit steps, (W, 1)."""
        return replace(self, here=self.here & lit, known=self.known & lit)

    def by_rule(self, lacking_kw: float, island: bool) -> Sequence[tuple[Floats, Flags]]:
        """Vehicles charge as fast as they can while there is grid, or take nothing."""
        room_kw = (self.full_kwh[0] - self.held_kwh[0]) / self.dt_h / self.units.eta_charge
        most_kw = np.where(self.here[0], np.clip(room_kw, 0.0, self.units.p_charge_kw), 0.0)
        nothing = super().by_rule(lacking_kw, island)
        return nothing if island else [(most_kw, nothing[0][1]), *nothing]

    def here_kw(self, taken_kw: Floats) -> Floats:
        """Planned powers of the first step; a vehicle that has not come takes none."""
        return np.where(self.here[0], taken_kw, 0.0)

    def most_taken_kw(self) -> Floats:
        """Most that all take together, (W,)."""
        return np.asarray(self.here @ self.units.p_charge_kw)

    def most_given_kw(self) -> Floats:
        """Most that all give together, (W,)."""
        return np.asarray(self.known @ self.units.p_discharge_kw)

    def power_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of powers beyond what chargers can do, (W, K).

        None moves power without a vehicle, or for a customer that is off.
        """
        most_kw = (self.here & plan.connected) * self.units.p_charge_kw
        back_kw = (self.known & plan.connected) * self.units.p_discharge_kw
        return np.maximum(plan.taken_kw - most_kw, -plan.taken_kw - back_kw)

    def stored_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of energies beyond their limits, as a power over the step, (W, K)."""
        energy_kwh = self.energy_kwh(plan.taken_kw)
        below_kwh = np.where(self.here, self.lowest_kwh - energy_kwh, 0.0)
        return np.maximum(energy_kwh - self.full_kwh, below_kwh) / self.dt_h


class Garage(Followers):
    """Energy of the vehicles at all chargers from step to step.

    Where the energy of a vehicle before the first step, (K,), is not given or NaN, it is as its
    session says.

    Attributes
    ----------
    state : array, shape (K,)
        Energy of each vehicle at the end of the last step, 0 without one.
    """

    def __init__(self, scenario: Scenario, state: Floats | None = None) -> None:
        unknown = np.full(len(scenario.chargers), np.nan)
        super().__init__(scenario, scenario.chargers, unknown if state is None else state)

    def here(self, t: int) -> Flags:
        """Chargers with a vehicle in a step, (K,)."""
        return np.asarray(self.scenario.session_at[t] >= 0)

    def at(self, t: int) -> Floats:
        """Energy of each vehicle at the beginning of a step, 0 without one, (K,)."""
        now = self.scenario.session_at[t]
        stays = now == self.scenario.session_at[t - 1] if t else ~np.isnan(self.state)
        arrives_kwh = self._of(self.scenario.sessions.held_kwh, t)
        return np.where(stays & self.here(t), self.state, arrives_kwh)

    def full_kwh(self, t: int) -> Floats:
        """Most energy that each vehicle of a step holds, 0 without one, (K,)."""
        return self._of(self.scenario.sessions.full_kwh, t)

    def _of(self, by_session: Floats, t: int) -> Floats:
        """A number of the sessions of a step by charger, 0 without one, (K,)."""
        found = np.zeros(len(self.state))
        here = self.here(t)
        found[here] = by_session[self.scenario.session_at[t][here]]
        return found

    def possible_kw(self, t: int, wanted_kw: Floats, served: Flags) -> Floats:
        """Power of each charger nearest to what is wanted, negative to discharge, (K,).

        A charger below its least power charges with that; in an outage it stops.
        """
        chargers, dt_h = self.units, self.dt_h
        held_kwh = self.at(t)
        wanted_kw = np.where(self.here(t) & self.on(served), wanted_kw, 0.0)
        room_kw = (self.full_kwh(t) - held_kwh) / dt_h
        above_kwh = held_kwh - self._of(self.scenario.sessions.floor_kwh, t)
        most = np.minimum(chargers.p_charge_kw, np.maximum(room_kw, 0.0) / chargers.eta_charge)
        back = np.maximum(above_kwh, 0.0) / dt_h * chargers.eta_discharge
        least = chargers.p_charge_min_kw
        charge = np.where(wanted_kw > NEGLIGIBLE_KW, wanted_kw, 0.0)
        little = (charge > 0.0) & (charge < least * (1.0 - 1e-9))
        charge = np.where(little, 0.0 if self.scenario.outage[t] else least, charge)
        discharge = np.minimum(np.maximum(-wanted_kw, 0.0), chargers.p_discharge_kw)
        return np.asarray(np.minimum(charge, most) - np.minimum(discharge, back))

    def after_kwh(self, t: int, power_kw: Floats) -> Floats:
        """Energy of each vehicle at the end of a step with these powers, (K,)."""
        into_kwh = stored_by(self.units, power_kw) * self.dt_h
        return np.clip(self.at(t) + into_kwh, 0.0, self.full_kwh(t))

    def after(self, t: int, taken_kw: Floats, running: Flags) -> Floats:
        """:meth:`after_kwh`."""
        return self.after_kwh(t, taken_kw)


WINDOW, PLANT = Plugged, Garage


def check_prices(scenario: Scenario, horizon_h: float, seed: int) -> None:
    """Refuse prices of energy beside which a kWh that a known or expected vehicle lacks is none."""
    grid = scenario.grid
    counted = [scenario.sessions.rows(~scenario.sessions.over(grid.start))]
    past_days = PastDays.of(scenario, seed)
    if past_days is not None:
        counted.append(past_days.expected(grid, range(grid.n_steps)))
    weight, full_kwh = (
        np.concatenate([getattr(each, name) for each in counted]) for name in ("weight", "full_kwh")
    )
    scale = price_scale(weight, full_kwh, float(scenario.customers.weight.min()), grid.dt_h)
    if scale:
        worth = scale * float(weight.min()) * float(scenario.chargers.eta_charge.min())
        refuse_dear_energy(scenario, f"{len(weight)} sessions of vehicles", worth)
