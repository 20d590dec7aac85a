"""Injections of a phased feeder: limits of its phases instead of voltages along the lines."""

from __future__ import annotations

from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.solve.cache import ModelCache
from vppres.solve.network.injections import Injections
from vppres.solve.network.rows import Rows
from vppres.solve.phases import Draws, PhaseLimits


class PhasedInjections(Injections):
    """The same columns and rows, with the limits of a phased window's phases."""

    def __init__(self, cache: ModelCache, data: WindowData) -> None:
        super().__init__(cache, data)
        draws = Draws.of_problem(self.site, data, self.problem, None)
        self.limits = PhaseLimits(self.site, data, draws)

    @property
    def near(self) -> list[Rows]:
        """Rows of limits that the last candidate nearly reached."""
        return [*self.limits.near]

    def voltage_rows(self, x: Floats, tolerance_pu2: float) -> list[Rows]:
        """Rows of the voltages and of the former's phases that exceed their limits."""
        return [*self.limits.exceeded(x, tolerance_pu2)]
