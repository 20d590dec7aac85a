"""Readings and set-points of thermostats of rooms and tanks in the service."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.kinds.cooling import ThermalLoads
from vppres.kinds.cooling.live import RANGES, STILL_C
from vppres.kinds.cooling.physics import Climate
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, expected_by, said_of
from vppres.service.of_kind import OfKind, Reckoned, Stored, Wrong
from vppres.service.payloads import OperatorSetpoint


class Thermostats(OfKind):
    """Rooms and tanks by their thermostats."""

    kind = "thermal_loads"
    source = "thermostats"

    def readings(self, stored: Stored) -> dict[str, Any]:
        """Temperatures, and what others than the controller set thermostats to last."""
        found = stored.ordered(self.kind, "setpoint_c")
        last = {name: one.dropna() for name, one in found[1].items()} if found else {}
        told = {name: float(one.iloc[-1]) for name, one in last.items() if len(one)}
        return super().readings(stored) | {"thermostat_ordered_c": told or None}

    def impossible(self, said: OperatorSetpoint, units: ThermalLoads, i: int) -> Iterator[Wrong]:
        """A temperature outside the comfort band."""
        low_c, high_c = units.t_min_c[i], units.t_max_c[i]
        if said.setpoint_c is not None and not low_c <= said.setpoint_c <= high_c:
            words = f"is outside its comfort band of {low_c:g} to {high_c:g} °C"
            yield "setpoint_c", said.setpoint_c, words, "Give a temperature in the band."

    def begun(self, units: ThermalLoads, state: Floats) -> ThermalLoads:
        """Rooms and tanks that begin with these temperatures."""
        return replace(units, t_initial_c=state)

    def state(self, scenario: Scenario, t: int, plan: Plan, reckoned: Floats) -> Floats:
        """Temperatures that a step was decided on."""
        return said_of(plan, "indoor_c", scenario.thermal_loads.id, reckoned)

    def reckoned(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str, Reckoned]]:
        """Temperatures. When within its step a thermostat lets its machine run is not known."""
        told, every = expected_by(plan), RANGES["indoor_c"]
        for name, start_c in told.get("indoor_c", {}).items():
            end_c = told["indoor_end_c"].get(name)
            if start_c is not None and end_c is not None:
                slack_c = STILL_C + abs(end_c - start_c)
                limits_c = every.lowest, every.highest
                yield name, "indoor_c", Reckoned(start_c, end_c, *limits_c, slack_c)

    def measured(
        self, scenario: Scenario, units: Climate, t: int
    ) -> Iterator[tuple[str, str, float]]:
        """Temperatures."""
        for name, t_c in zip(scenario.thermal_loads.id, units.state, strict=True):
            yield "indoor_c", str(name), float(t_c)

    def powers(self, t: int, units: Climate, asked: Mapping[str, Floats], served: Flags) -> Floats:
        """Power of machines at these set temperatures."""
        held_c = units.scenario.thermal_loads.held_c
        asked_c = asked["setpoint_c"]
        return units.thermostat_kw(t, np.where(np.isnan(asked_c), held_c, asked_c), served)


SERVICE = Thermostats()
