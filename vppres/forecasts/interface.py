"""Interface of forecasters: their history, and their paths of load and PV power."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats, freeze_arrays
from vppres.scenario.history import History

Basis = Literal["model", "past days", "recent values", "nothing"]
"""Evidence that a forecast rests on, from the best to the least: see
:mod:`vppres.forecasts.seasonal`."""

MEDIAN = 0.5


@dataclass(frozen=True, eq=False)
class LoadAndPV:
    """A forecast of load and PV power: M equally likely paths of W steps, of all items together.

    Path ``m`` is one possible course of everything: its load and its PV power belong together,
    and so do its steps. What is asked of sums over items or steps is asked of the paths' sums.
    """

    start: pd.Timestamp  #: beginning of the first step
    step_minutes: float  #: step length in minutes
    load_kw: Floats  #: demand of each customer, (M, W, C); NaN where nothing is known of one
    pv_kw: Floats  #: available power of each PV system, (M, W, P)
    basis: Basis = "model"  #: what it rests on

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def times(self) -> pd.DatetimeIndex:
        """Beginning of every step."""
        return pd.date_range(
            self.start,
            periods=self.load_kw.shape[1],
            freq=pd.Timedelta(minutes=self.step_minutes),
            name="time",
        )

    @property
    def net_kw(self) -> Floats:
        """Demand of all customers less all PV power, shape (M, W)."""
        return np.asarray(self.load_kw.sum(axis=2) - self.pv_kw.sum(axis=2))

    def point(self) -> tuple[Floats, Floats]:
        """Point forecast for a plan: demand (W, C) and PV power (W, P).

        The feeder's total is the median of its paths. It is shared out like the means of the
        items: medians of single homes would add up to too little, as their demand is skew.
        """
        return middle(self.load_kw), middle(self.pv_kw)


class ForecastMethod(Protocol):
    """A way of making forecasts."""

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """The steps from ``issued_at`` on, from what was over by then and nothing later.

        The history may go on after ``issued_at``, which changes nothing.
        """
        ...


def quantiles(paths: Floats, levels: ArrayLike) -> Floats:
    """Quantiles over paths that hold new values as often as they say.

    Of m past errors and a new one every order is equally likely, so that the new one lies below
    the i-th smallest with probability ``i / (m + 1)``: level q is at position ``q (m + 1)``, on a
    straight line between two of them (split conformal prediction with its finite-sample
    correction). Levels beyond the smallest and largest get these.

    Parameters
    ----------
    paths : array, shape (m, ...)
        Equally likely values.
    levels : array_like
        Levels between 0 and 1.

    Examples
    --------
    >>> nine = np.arange(1.0, 10.0)
    >>> [float(q) for q in quantiles(nine, [0.1, 0.5, 0.95])]
    [1.0, 5.0, 9.0]
    """
    return np.asarray(np.quantile(paths, np.asarray(levels, dtype=float), axis=0, method="weibull"))


def middle(paths: Floats) -> Floats:
    """Means of the items over the paths, scaled to the median of their total: (M, W, n) to (W, n).

    >>> float(middle(np.array([[[1.0, 1.0]], [[2.0, 2.0]], [[6.0, 0.0]]])).sum())
    4.0
    """
    mean = paths.mean(axis=0)
    total = np.nansum(mean, axis=1)
    median = np.nanmedian(np.nansum(paths, axis=2), axis=0)
    factor = np.divide(median, total, out=np.ones_like(total), where=total > 0.0)
    return np.asarray(mean * factor[:, np.newaxis])
