"""Rooms and tanks as they really are: their temperature, supplied or not.

Arithmetic of its own, apart from the model.
"""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.scenario.scenario import Scenario


class Climate:
    """Temperature of all rooms and tanks from step to step.

    Parameters
    ----------
    scenario : Scenario
        Thermal loads, customers, temperatures outside and steps.

    Attributes
    ----------
    t_c : array, shape (H,)
        Temperature of each at the end of the last step.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.t_c = scenario.thermal_loads.t_initial_c
        self._owner = scenario.thermal_loads.owner(scenario.customers)

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
        alone_c = self.after_c(t, np.zeros_like(self.t_c))
        c_per_kw = self.after_c(t, np.ones_like(self.t_c)) - alone_c
        return self.possible_kw((setpoint_c - alone_c) / c_per_kw, served)

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """:meth:`possible_kw`; machines are not started."""
        return self.possible_kw(wanted_kw, served), running

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """Nothing: machines do not give, (H,)."""
        return np.zeros_like(taken_kw)

    def after_c(self, t: int, power_kw: Floats) -> Floats:
        """Temperature at the end of a step with these powers, (H,)."""
        loads = self.scenario.thermal_loads
        outside_c = float(self.scenario.temperature_c[t])
        heat_kw = loads.gain_kw + power_kw * loads.heat_per_kw(outside_c)
        rests_at_c = loads.surroundings_c(outside_c) + heat_kw * loads.r_c_per_kw
        time_constant_h = loads.r_c_per_kw * loads.c_kwh_per_c
        away_c = (self.t_c - rests_at_c) * np.exp(-self.scenario.grid.dt_h / time_constant_h)
        return np.asarray(rests_at_c + away_c)

    def advance(self, t: int, taken_kw: Floats, running: Flags | None = None) -> None:
        """The state at the end of a step."""
        self.t_c = self.after_c(t, taken_kw)
