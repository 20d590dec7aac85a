"""Forecasts of which another provider's go first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.contract.forecast import Forecast
from vppres.core.arrays import Flags
from vppres.day.forecasting import DayForecasts
from vppres.live.measurement import Seen
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class GivenFirst:
    """A forecaster's forecasts, but for the series that another provider foretold."""

    own: DayForecasts
    scenario: Scenario
    load: Flags
    pv: Flags

    @classmethod
    def of(cls, own: DayForecasts, scenario: Scenario, seen: Seen) -> DayForecasts:
        """The forecaster's alone where there is no other provider."""
        if not (seen.foretold_load.any() or seen.foretold_pv.any()):
            return own
        return cls(own, scenario, seen.foretold_load, seen.foretold_pv)

    def at(self, t0: int, steps: range) -> Forecast:
        """Forecast at the beginning of step ``t0``."""
        found = self.own.at(t0, steps)
        rows = slice(steps.start, steps.stop)
        return replace(
            found,
            load_kw=np.where(self.load, self.scenario.load_kw[rows], found.load_kw),
            pv_kw=np.where(self.pv, self.scenario.pv_kw[rows], found.pv_kw),
        )
