"""The paper's error model behind the interface of forecasters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.forecasts.interface import Fitted, LoadAndPV
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True)
class PaperErrors:
    """The actual day with drawn errors: no forecast, but what the paper calls one.

    It knows the day that comes, and its first step exactly.

    Parameters
    ----------
    scenario : Scenario
        The actual day.
    errors : ForecastErrors
        Their size.
    seed : int
        Seed of the first path, which is the forecast of a run with that seed; the next ones
        follow.
    n_paths : int
        Number of paths.
    """

    scenario: Scenario
    errors: ForecastErrors
    seed: int = 0
    n_paths: int = 1

    def fit(self, history: History) -> Fitted:
        """Nothing is learnt from what was before."""
        return self

    def forecast(self, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """The steps from ``issued_at`` on, none after the end of the day.

        Raises
        ------
        InputError
            If the day has no such steps.
        """
        grid = self.scenario.grid
        t0 = round((issued_at - grid.start) / pd.Timedelta(minutes=grid.step_minutes))
        drawn = [
            Forecaster(self.scenario, self.errors, self.seed + path).at(t0, range(t0, t0 + steps))
            for path in range(self.n_paths)
        ]
        return LoadAndPV(
            issued_at,
            grid.step_minutes,
            np.array([one.load_kw for one in drawn]),
            np.array([one.pv_kw for one in drawn]),
        )
