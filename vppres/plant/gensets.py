"""Generating sets as they really are: what they can give, what they burn, how long they have run.

Arithmetic of its own, apart from the model.
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.scenario.gensets import ROUNDING_H, GensetState
from vppres.scenario.scenario import Scenario

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
        """What each gives beyond its least power, (G,)."""
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
