"""Rooms and tanks over the steps of a window: arrays, by thermal load.

:mod:`vppres.kinds.cooling.rows` states a problem with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.cooling.data import ThermalLoads
from vppres.kinds.kind import UnitsAhead, price_scale, refuse_dear_energy
from vppres.scenario.scenario import Scenario

OF_A_STEP = 0.5
"""Part of what vehicles may count that rooms and tanks may: with them, less than a step."""


@dataclass(frozen=True, eq=False)
class Rooms(UnitsAhead):
    """Temperatures of rooms and tanks in a window, with their bands and machines, (W, H) each."""

    #: Part of the temperature before a step that is left at its end; 0 in the first step, of which
    #: ``drift_c`` has that part already.
    keeps: Floats
    drift_c: Floats  #: what surroundings and gains add to it
    c_per_kw: Floats  #: what a kW of the machine adds to it, negative for cooling
    most_kw: Floats  #: largest power of the machine
    #: Comfort band.
    t_min_c: Floats
    t_max_c: Floats
    weight: Floats  #: priority weight

    @classmethod
    def of(cls, scenario: Scenario, steps: range, now_c: Floats, past_days: Any = None) -> Self:
        """The window that begins with these temperatures."""
        loads = scenario.thermal_loads
        outside_c = scenario.temperature_c[steps.start : steps.stop, None]
        keeps = np.exp(-scenario.grid.dt_h / loads.time_constant_h)
        rest_c = loads.surroundings_c(outside_c) + loads.r_c_per_kw * loads.gain_kw
        rest_c = np.broadcast_to(rest_c, (len(steps), len(loads)))
        drift_c = (1.0 - keeps) * rest_c
        drift_c[0] += keeps * now_c
        kept = np.tile(keeps, (len(steps), 1))
        kept[0] = 0.0
        weight = scenario.customers.weight[loads.owner(scenario.customers)]
        each = (loads.p_max_kw, loads.t_min_c, loads.t_max_c, weight)
        return cls(
            kept,
            drift_c,
            (1.0 - keeps) * loads.r_c_per_kw * loads.heat_per_kw(outside_c),
            *(np.tile(values, (len(steps), 1)) for values in each),
        )

    def in_the_dark(self, lit: Flags) -> Self:
        """Window without power except in the lit steps, (W, 1)."""
        return replace(self, most_kw=self.most_kw * lit)

    def most_taken_kw(self, loads: ThermalLoads) -> Floats:
        """Most that all machines take together, (W,)."""
        return np.asarray(self.most_kw.sum(axis=1))

    def power_beyond_kw(
        self, loads: ThermalLoads, connected: Flags, taken_kw: Floats, running: Flags, dt_h: float
    ) -> Floats:
        """Excess of powers beyond what machines can do, none of a customer off, (W, H)."""
        return np.maximum(taken_kw - connected * self.most_kw, -taken_kw)

    def t_c(self, power_kw: Floats) -> Floats:
        """Temperature at the end of each step with these powers, (W, H)."""
        now = np.zeros(self.keeps.shape[1])
        rows = []
        for keeps, added in zip(self.keeps, self.drift_c + self.c_per_kw * power_kw, strict=True):
            now = keeps * now + added
            rows.append(now)
        return np.array(rows).reshape(power_kw.shape)

    def missed_c(self, t_c: Floats) -> tuple[Floats, Floats]:
        """Temperature above the band and below it, in K, (W, H) each."""
        return np.maximum(t_c - self.t_max_c, 0.0), np.maximum(self.t_min_c - t_c, 0.0)

    def price(self, least_weight: float, dt_h: float) -> Floats:
        """Price of a K h outside the band, in weighted customer hours, (W, H).

        All of a window without any power count a quarter of a step of the customer of this least
        weight: no service is given up for comfort.
        """
        over_c, under_c = self.missed_c(self.t_c(np.zeros_like(self.most_kw)))
        scale = price_scale(self.weight, (over_c + under_c) * dt_h, least_weight, dt_h)
        return OF_A_STEP * scale * self.weight


class Climate:
    """Temperature of all rooms and tanks from step to step.

    Attributes
    ----------
    state : array, shape (H,)
        Temperature of each at the end of the last step.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.state = scenario.thermal_loads.t_initial_c
        self._owner = scenario.thermal_loads.owner(scenario.customers)

    def at(self, t: int) -> Floats:
        """Temperature at the beginning of a step, (H,)."""
        return self.state

    def on(self, served: Flags) -> Flags:
        """Machines whose customer is served, (H,)."""
        return np.asarray(served[self._owner])

    def possible_kw(self, wanted_kw: Floats, served: Flags) -> Floats:
        """Power of each machine nearest to what is wanted; none of a customer that is off, (H,)."""
        most_kw = self.scenario.thermal_loads.p_max_kw * served[self._owner]
        return np.clip(wanted_kw, 0.0, most_kw)

    def thermostat_kw(self, t: int, setpoint_c: Floats, served: Flags) -> Floats:
        """Power with which each machine comes nearest to a temperature by the end of a step, (H,).

        A room beyond its set-point already is left to itself.
        """
        alone_c = self.after_c(t, np.zeros_like(self.state))
        c_per_kw = self.after_c(t, np.ones_like(self.state)) - alone_c
        return self.possible_kw((setpoint_c - alone_c) / c_per_kw, served)

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """:meth:`possible_kw`; machines are not started."""
        return self.possible_kw(wanted_kw, served), running

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """Nothing: machines do not give, (H,)."""
        return np.zeros_like(taken_kw)

    def rests_at_c(self, t: int, power_kw: Floats) -> Floats:
        """Temperature to which each comes with these powers in the long run, (H,)."""
        loads = self.scenario.thermal_loads
        outside_c = float(self.scenario.temperature_c[t])
        heat_kw = loads.gain_kw + power_kw * loads.heat_per_kw(outside_c)
        return np.asarray(loads.surroundings_c(outside_c) + heat_kw * loads.r_c_per_kw)

    def after_c(self, t: int, power_kw: Floats) -> Floats:
        """Temperature at the end of a step with these powers, (H,)."""
        rests_at_c = self.rests_at_c(t, power_kw)
        time_constant_h = self.scenario.thermal_loads.time_constant_h
        away_c = (self.state - rests_at_c) * np.exp(-self.scenario.grid.dt_h / time_constant_h)
        return np.asarray(rests_at_c + away_c)

    def advance(self, t: int, taken_kw: Floats, running: Flags, served: Flags) -> None:
        """The state at the end of a step."""
        self.state = self.after_c(t, taken_kw)


WINDOW, PLANT = Rooms, Climate


def check_prices(scenario: Scenario, horizon_h: float, seed: int) -> None:
    """Refuse prices of energy beside which comfort that is missed would count nothing.

    That is of a window each of whose steps misses the most of the day. A kWh moves a temperature at
    the end of its step at least, and so for one step.
    """
    loads, dt_h = scenario.thermal_loads, scenario.grid.dt_h
    rooms = Rooms.of(scenario, range(scenario.grid.n_steps), loads.t_initial_c)
    over_c, under_c = rooms.missed_c(rooms.t_c(np.zeros_like(rooms.most_kw)))
    window_h = dt_h * len(scenario.grid.window(0, horizon_h))
    most_k_h = window_h * (over_c + under_c).max(axis=0)
    weight = rooms.weight[0]
    scale = OF_A_STEP * price_scale(weight, most_k_h, float(scenario.customers.weight.min()), dt_h)
    if scale:
        worth = scale * float((weight * np.abs(rooms.c_per_kw).min(axis=0)).min())
        refuse_dear_energy(scenario, f"the comfort of {len(loads)} rooms and tanks", worth)
