"""Rooms and tanks over the steps of a window: arrays, by thermal load.

:mod:`vppres.model.beyond_paper.thermal_loads` states a problem with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from vppres.contract.by_step import UnitsAhead
from vppres.contract.plugged import price_scale
from vppres.core.arrays import Flags, Floats
from vppres.scenario.scenario import Scenario
from vppres.scenario.thermal_loads import ThermalLoads

OF_A_STEP = 0.5
"""Part of what vehicles may count that rooms and tanks may: with them, less than a step."""


@dataclass(frozen=True, eq=False)
class Rooms(UnitsAhead):
    """What becomes of the temperature of each room or tank in a window, (W, H) each.

    Parameters
    ----------
    keeps : array
        Part of the temperature before a step that is left at its end; 0 in the first step, of which
        ``drift_c`` has that part already.
    drift_c : array
        What surroundings and gains add to it.
    c_per_kw : array
        What a kW of the machine adds to it, negative for cooling.
    most_kw : array
        Largest power of the machine.
    t_min_c, t_max_c : array
        Comfort band.
    weight : array
        Priority weight.
    """

    keeps: Floats
    drift_c: Floats
    c_per_kw: Floats
    most_kw: Floats
    t_min_c: Floats
    t_max_c: Floats
    weight: Floats

    @classmethod
    def of(cls, scenario: Scenario, steps: range, now_c: Floats) -> Self | None:
        """The window that begins with these temperatures; None without thermal loads."""
        loads = scenario.thermal_loads
        if not len(loads):
            return None
        outside_c = scenario.temperature_c[steps.start : steps.stop, None]
        keeps = np.exp(-scenario.grid.dt_h / (loads.r_c_per_kw * loads.c_kwh_per_c))
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
        """The same without power but in the lit steps, (W, 1)."""
        return replace(self, most_kw=self.most_kw * lit)

    def most_taken_kw(self, loads: ThermalLoads) -> Floats:
        """Most that all machines take together, (W,)."""
        return np.asarray(self.most_kw.sum(axis=1))

    def power_beyond_kw(
        self, loads: ThermalLoads, connected: Flags, taken_kw: Floats, running: Flags, dt_h: float
    ) -> Floats:
        """By how much powers are beyond what machines can do, none of a customer off, (W, H)."""
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
        """By how much temperatures are above the band and below it, (W, H) each."""
        return np.maximum(t_c - self.t_max_c, 0.0), np.maximum(self.t_min_c - t_c, 0.0)

    def price(self, least_weight: float, dt_h: float) -> Floats:
        """Price of a K h outside the band, in weighted customer hours, (W, H).

        All of a window without any power count a quarter of a step of the customer of this least
        weight: no service is given up for comfort.
        """
        over_c, under_c = self.missed_c(self.t_c(np.zeros_like(self.most_kw)))
        scale = price_scale(self.weight, (over_c + under_c) * dt_h, least_weight, dt_h)
        return OF_A_STEP * scale * self.weight
