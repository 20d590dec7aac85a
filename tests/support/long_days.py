"""Scenarios of more than one day."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.scenario.scenario import Scenario


def repeated(scenario: Scenario, n_steps: int, start: str | None = None) -> Scenario:
    """The scenario's steps over and over, from a time on."""
    rows = np.arange(n_steps) % scenario.grid.n_steps
    series: dict[str, Any] = {name: values[rows] for name, values in scenario.series.items()}
    grid = replace(scenario.grid, n_steps=n_steps)
    if start is not None:
        grid = replace(grid, start=pd.Timestamp(start))
    return replace(scenario, grid=grid, **series)
