"""Rooms and tanks on arrays: the plant, checks of plans, and what is reckoned between readings.

The temperature follows from the power by the exact solution of one resistance and one capacity.
:mod:`vppres.kinds.cooling.rows` states the same for the solver and takes nothing from here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.cooling import OF_A_STEP, ThermalLoads
from vppres.kinds.kind import Followers, UnitPlan, UnitsAhead, price_scale, refuse_dear_energy
from vppres.scenario.scenario import Scenario


def rests_at_c(
    loads: ThermalLoads, outside_c: Floats | float, gain_kw: Floats, power_kw: Floats
) -> Floats:
    """Temperature to which each comes with these powers in the long run, (..., H)."""
    cop = np.maximum(loads.cop + loads.cop_per_c * (outside_c - loads.cop_at_c), 1.0)
    heat_kw = gain_kw + power_kw * np.where(loads.heats, cop, -cop)
    around_c = np.where(np.isnan(loads.around_c), outside_c, loads.around_c)
    return np.asarray(around_c + heat_kw * loads.r_c_per_kw)


def after_c(loads: ThermalLoads, start_c: Floats, rests_c: Floats, hours: Floats | float) -> Floats:
    """Temperature after some hours on the way to where it rests, (H,)."""
    time_constant_h = loads.r_c_per_kw * loads.c_kwh_per_c
    return np.asarray(rests_c + (start_c - rests_c) * np.exp(-hours / time_constant_h))


@dataclass(frozen=True, eq=False)
class Rooms(UnitsAhead):
    """Rooms and tanks in a window: what is around them, their bands and machines, (W, H) each."""

    units: ThermalLoads
    begins_c: Floats  #: temperature at the beginning of the window; NaN in all steps but the first
    outside_c: Floats  #: temperature of the air outside
    gain_kw: Floats  #: heat that comes by itself
    most_kw: Floats  #: largest power of the machine
    #: Comfort band.
    t_min_c: Floats
    t_max_c: Floats
    weight: Floats  #: priority weight

    @classmethod
    def of(cls, scenario: Scenario, steps: range, now_c: Floats, past_days: Any = None) -> Self:
        """The window that begins with these temperatures."""
        loads, n_steps = scenario.thermal_loads, len(steps)
        begins_c = np.vstack([now_c, np.full((n_steps - 1, len(loads)), np.nan)])
        outside_c = scenario.temperature_c[steps.start : steps.stop, None]
        gain_kw = np.broadcast_to(loads.gain_kw, begins_c.shape)
        weight = scenario.customers.weight[loads.owner(scenario.customers)]
        each = (loads.p_max_kw, loads.t_min_c, loads.t_max_c, weight)
        return cls(
            loads,
            scenario.grid.dt_h,
            begins_c,
            np.broadcast_to(outside_c, begins_c.shape),
            gain_kw,
            *(np.tile(values, (n_steps, 1)) for values in each),
        )

    def in_the_dark(self, lit: Flags) -> Self:
        """Window without power except in the lit steps, (W, 1)."""
        return replace(self, most_kw=self.most_kw * lit)

    def most_taken_kw(self) -> Floats:
        """Most that all machines take together, (W,)."""
        return np.asarray(self.most_kw.sum(axis=1))

    def power_beyond_kw(self, plan: UnitPlan) -> Floats:
        """Excess of powers beyond what machines can do, none of a customer off, (W, H)."""
        return np.maximum(plan.taken_kw - plan.connected * self.most_kw, -plan.taken_kw)

    def t_c(self, power_kw: Floats) -> Floats:
        """Temperature at the end of each step with these powers, (W, H)."""
        now = self.begins_c[0]
        rows = []
        for rests_c in rests_at_c(self.units, self.outside_c, self.gain_kw, power_kw):
            now = after_c(self.units, now, rests_c, self.dt_h)
            rows.append(now)
        return np.array(rows).reshape(power_kw.shape)


class Climate(Followers):
    """Temperature of all rooms and tanks from step to step.

    Attributes
    ----------
    state : array, shape (H,)
        Temperature of each at the end of the last step.
    """

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario, scenario.thermal_loads, scenario.thermal_loads.t_initial_c)

    def possible_kw(self, t: int, wanted_kw: Floats, served: Flags) -> Floats:
        """Power of each machine nearest to what is wanted; none of a customer that is off, (H,)."""
        return np.clip(wanted_kw, 0.0, self.units.p_max_kw * self.on(served))

    def thermostat_kw(self, t: int, setpoint_c: Floats, served: Flags) -> Floats:
        """Power with which each machine comes nearest to a temperature by the end of a step, (H,).

        A room beyond its set-point already is left to itself.
        """
        alone_c = self.after_c(t, np.zeros_like(self.state))
        c_per_kw = self.after_c(t, np.ones_like(self.state)) - alone_c
        return self.possible_kw(t, (setpoint_c - alone_c) / c_per_kw, served)

    def rests_at_c(self, t: int, power_kw: Floats) -> Floats:
        """Temperature to which each comes with these powers in the long run, (H,)."""
        loads = self.units
        return rests_at_c(loads, float(self.scenario.temperature_c[t]), loads.gain_kw, power_kw)

    def after_c(self, t: int, power_kw: Floats) -> Floats:
        """Temperature at the end of a step with these powers, (H,)."""
        return after_c(self.units, self.state, self.rests_at_c(t, power_kw), self.dt_h)

    def after(self, t: int, taken_kw: Floats, running: Flags) -> Floats:
        """:meth:`after_c`."""
        return self.after_c(t, taken_kw)


WINDOW, PLANT = Rooms, Climate


def check_prices(scenario: Scenario, horizon_h: float, seed: int) -> None:
    """Refuse prices of energy beside which comfort that is missed would count nothing.

    That is of a window each of whose steps misses the most of the day. A kWh moves a temperature at
    the end of its step at least, and so for one step.
    """
    loads, dt_h = scenario.thermal_loads, scenario.grid.dt_h
    rooms = Rooms.of(scenario, range(scenario.grid.n_steps), loads.t_initial_c)
    alone_c = rooms.t_c(np.zeros_like(rooms.most_kw))
    missed_c = np.maximum(np.maximum(alone_c - rooms.t_max_c, rooms.t_min_c - alone_c), 0.0)
    window_h = dt_h * len(scenario.grid.window(0, horizon_h))
    weight = rooms.weight[0]
    least_weight = float(scenario.customers.weight.min())
    scale = OF_A_STEP * price_scale(weight, window_h * missed_c.max(axis=0), least_weight, dt_h)
    if scale:
        at_rest = (rooms.outside_c, rooms.gain_kw)
        by_kw = [rests_at_c(loads, *at_rest, np.full_like(alone_c, kw)) for kw in (0.0, 1.0)]
        c_per_kw = np.abs(after_c(loads, np.zeros(len(loads)), by_kw[1] - by_kw[0], dt_h))
        worth = scale * float((weight * c_per_kw.min(axis=0)).min())
        refuse_dear_energy(scenario, f"the comfort of {len(loads)} rooms and tanks", worth)
