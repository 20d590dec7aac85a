"""Forecasts of another provider: quantiles by time, behind the same interface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.forecasts.interface import Basis, LoadAndPV
from vppres.scenario.history import History

TOTALS = ("load", "pv")
N_PATHS = 19
NO_TIME = pd.Timedelta(0)


@dataclass(frozen=True, eq=False)
class GivenQuantiles:
    """Quantiles of a file; of several issues the last one counts that was out in time.

    Nothing is known of how the errors of two steps or series belong together: path ``i`` is at the
    same level everywhere, so that sums are as uncertain as they can be. What a file does not cover
    is NaN.
    """

    #: When each row was issued, and the beginning of its step, n.
    issued: pd.DatetimeIndex
    times: pd.DatetimeIndex
    #: ``load`` or ``pv`` for a total, which is shared out like the history's means, or an
    #: identifier, (n,).
    series: Names
    levels: Floats  #: ascending levels between 0 and 1, (Q,)
    values: Floats  #: quantiles in kW, (n, Q)
    #: Identifiers in the order of the forecast.
    customers: Names
    pv: Names
    lag: pd.Timedelta = NO_TIME  #: by how much a row must be older than the forecast that uses it

    def forecast(self, history: History, issued_at: pd.Timestamp, steps: int) -> LoadAndPV:
        """The quantiles as paths; the history's means share totals out."""
        past = history.before(issued_at)
        times = pd.date_range(issued_at, periods=steps, freq=history.step)
        out = self.issued <= issued_at - self.lag
        latest = self.issued == self.issued[out].max() if out.any() else out
        load_kw = self._paths("load", self.customers, past.load_kw, times, latest)
        pv_kw = self._paths("pv", self.pv, past.pv_kw, times, latest)
        known = np.isfinite(load_kw).any() or np.isfinite(pv_kw).any()
        basis: Basis = "model" if known else "nothing"
        return LoadAndPV(issued_at, history.step_minutes, load_kw, pv_kw, basis)

    def _paths(
        self,
        total: str,
        ids: Names,
        measured: Floats,
        times: pd.DatetimeIndex,
        rows: Flags,
    ) -> Floats:
        """Paths of all items, (M, W, items): of the total, and of those that are named."""
        paths = self._of_series(total, times, rows)[:, :, np.newaxis] * _shares(measured)
        for position, name in enumerate(ids):
            found = self._of_series(str(name), times, rows)
            paths[:, :, position] = np.where(np.isnan(found), paths[:, :, position], found)
        return paths

    def _of_series(
        self,
        name: str,
        times: pd.DatetimeIndex,
        rows: Flags,
    ) -> Floats:
        """Values of a series at the paths' levels, (M, W); NaN where the file has none."""
        at = (np.arange(N_PATHS) + 0.5) / N_PATHS
        paths = np.full((N_PATHS, len(times)), np.nan)
        chosen = np.flatnonzero(rows & (self.series == name))
        step = times.get_indexer(self.times[chosen])
        for row, w in zip(chosen[step >= 0], step[step >= 0], strict=True):
            paths[:, w] = np.interp(at, self.levels, self.values[row])
        return paths


def _shares(measured: Floats) -> Floats:
    """Share of each item in what was measured; equal ones where nothing was."""
    known = ~np.isnan(measured)
    mean = np.where(known, measured, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    if not mean.sum() > 0.0:
        mean = np.ones(measured.shape[1])
    return np.asarray(mean / mean.sum()) if len(mean) else mean
