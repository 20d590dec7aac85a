"""Series of others on the steps of a scenario: means are kept, gaps are filled or refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from pandas.tseries.frequencies import to_offset

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.core.text import iso
from vppres.io.times import usual_step
from vppres.scenario.timegrid import TimeGrid

_MINUTE = pd.Timedelta(minutes=1)


@dataclass(frozen=True, eq=False)
class OnGrid:
    """A series on a grid, (T,), and how many of its own values were missing and filled."""

    values: Floats
    filled: int = 0
    longest_gap_min: float = 0.0


def on_grid(
    series: pd.Series[float], grid: TimeGrid, most_gap_min: float, where: str, name: str
) -> OnGrid | Problem:
    """Means of a series over the steps of a grid, or what is wrong with the series.

    Each value holds from its time (UTC) to the next, at the regular distance of the times. A step's
    value is the mean over the step, so that sums times step lengths, energies, are those of the
    series: longer steps average, shorter ones repeat. Missing values within the grid, no more than
    ``most_gap_min`` in a row, lie on a straight line between their neighbours, or are the nearest
    at the ends of the series.

    Examples
    --------
    >>> times = pd.date_range("2025-01-01", periods=4, freq="30min", tz="UTC")
    >>> hours = TimeGrid(times[0], 60, 2)
    >>> on_grid(pd.Series([1.0, 3.0, 5.0, 5.0], times), hours, 60, "a.csv", "a").values
    array([2., 5.])
    """
    times = pd.DatetimeIndex(series.index)
    for message, cure, value in _faults(times, grid):
        return Problem(where, message, cure, field=name, value=value)
    step = usual_step(times)
    # As much beyond the grid as a gap may have, so that lines have both their ends.
    margin = pd.Timedelta(minutes=most_gap_min) + 2 * step
    own = series.asfreq(to_offset(step)).loc[grid.start - margin : grid.end + margin]
    missing = own.isna()
    begins = pd.DatetimeIndex(own.index)
    lost = missing & (begins + step > grid.start) & (begins < grid.end)
    run = missing.groupby((missing != missing.shift()).cumsum()).transform("sum")
    longest_min = float(run[lost].max() * (step / _MINUTE)) if lost.any() else 0.0
    if longest_min > most_gap_min or missing.all():
        at = f" at {iso(begins[lost][0])}" if lost.any() else ""
        words = f"has a gap of {longest_min:g} min{at}, and {most_gap_min:g} min are filled at most"
        cure = "Complete the series, choose other days, or allow longer gaps with --max-gap."
        return Problem(where, words, cure, field=name)
    filled = own.interpolate(limit_direction="both")
    return OnGrid(_means(filled, step, grid), int(lost.sum()), longest_min)


def _means(own: pd.Series[float], step: pd.Timedelta, grid: TimeGrid) -> Floats:
    """Mean over every step of the grid of values that hold for a step of their own."""
    values = own.to_numpy(dtype=float)
    begins_min = ((pd.DatetimeIndex(own.index) - grid.start) / _MINUTE).to_numpy(dtype=float)
    step_min = step / _MINUTE
    at = np.flatnonzero(begins_min == 0)
    if step_min == grid.step_minutes and len(at):
        return np.asarray(values[at[0] : at[0] + grid.n_steps])  # to the last digit
    edges_min = np.append(begins_min, begins_min[-1] + step_min)
    energy = np.append(0.0, np.cumsum(values)) * step_min
    wanted_min = grid.step_minutes * np.arange(grid.n_steps + 1)
    means: Floats = np.diff(np.interp(wanted_min, edges_min, energy)) / grid.step_minutes
    return means


def _faults(times: pd.DatetimeIndex, grid: TimeGrid) -> Iterator[tuple[str, str, str | None]]:
    """Errors of the times of a series, the gravest first: message, cure and time."""
    if len(times) == 0:
        yield "has no value", "Give a value for every step.", None
    for i in np.flatnonzero(times[1:] <= times[:-1]).tolist():
        if times[i + 1] == times[i]:
            yield "has a time twice", "Remove one of the two rows.", iso(times[i])
        yield "has times that are out of order", "Sort the rows by time.", iso(times[i + 1])
    step = usual_step(times)
    end = times[-1] + step
    if times[0] > grid.start or end < grid.end:
        covered = f"{iso(times[0])} to {iso(end)}"
        yield (
            f"covers {covered}, and the scenario is {iso(grid.start)} to {iso(grid.end)}",
            "Choose days that it covers with --date or --start, and --days.",
            None,
        )
    for i in np.flatnonzero((times - times[0]) % step != pd.Timedelta(0)).tolist():
        words = f"has a time that is not a multiple of {step / _MINUTE:g} min after the first"
        yield words, "Give equal steps; steps that are missing are filled.", iso(times[i])
