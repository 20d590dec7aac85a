"""Series of others on the steps of a scenario: means are kept, gaps are filled or refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from pandas.tseries.frequencies import to_offset

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.io.times import iso, usual_step
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
) -> tuple[OnGrid, list[Problem]]:
    """Means of a series over the steps of a grid.

    Each value holds from its time to the next, at the regular distance of the times. A step's value
    is the mean over the step, so that sums times step lengths, energies, are those of the series:
    longer steps average, shorter ones repeat. Missing values within the grid lie on a straight line
    between their neighbours, or are the nearest at the ends of the series.

    Parameters
    ----------
    series : Series
        Indexed by times in UTC in rising order; NaN counts as missing.
    grid : TimeGrid
        The steps.
    most_gap_min : float
        Longest gap that is filled.
    where, name : str
        Source and name of the series, for messages.

    Returns
    -------
    OnGrid
        Empty where there are problems.
    list of Problem

    Examples
    --------
    >>> times = pd.date_range("2025-01-01", periods=4, freq="30min", tz="UTC")
    >>> hours = TimeGrid(times[0], 60, 2)
    >>> on_grid(pd.Series([1.0, 3.0, 5.0, 5.0], times), hours, 60, "a.csv", "a")[0].values
    array([2., 5.])
    """
    times = pd.DatetimeIndex(series.index)
    problem = _check_order(times, where, name)
    if problem is not None:
        return OnGrid(np.empty(0)), [problem]
    step = usual_step(times)
    problem = _check_cover(times, step, grid, where, name) or _check_regular(
        times, step, where, name
    )
    if problem is not None:
        return OnGrid(np.empty(0)), [problem]
    # As much beyond the grid as a gap may have, so that lines have both their ends.
    margin = pd.Timedelta(minutes=most_gap_min) + 2 * step
    own = series.asfreq(to_offset(step)).loc[grid.start - margin : grid.end + margin]
    missing = own.isna()
    begins = pd.DatetimeIndex(own.index)
    lost = missing & (begins + step > grid.start) & (begins < grid.end)
    run = missing.groupby((missing != missing.shift()).cumsum()).transform("sum")
    longest_min = float(run[lost].max() * (step / _MINUTE)) if lost.any() else 0.0
    if longest_min > most_gap_min or missing.all():
        return OnGrid(np.empty(0)), [_gap(begins[lost], longest_min, most_gap_min, where, name)]
    filled = own.interpolate(limit_direction="both")
    return OnGrid(_means(filled, step, grid), int(lost.sum()), longest_min), []


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


def _check_order(times: pd.DatetimeIndex, where: str, name: str) -> Problem | None:
    """A series without values, or with times that do not rise."""
    if len(times) == 0:
        return Problem(where, "has no value", "Give a value for every step.", field=name)
    back = np.flatnonzero(times[1:] <= times[:-1])
    if len(back) == 0:
        return None
    again = times[back[0] + 1] == times[back[0]]
    return Problem(
        where,
        "has a time twice" if again else "has times that are out of order",
        "Remove one of the two rows." if again else "Sort the rows by time.",
        field=name,
        value=iso(times[back[0] + 1]),
    )


def _check_cover(
    times: pd.DatetimeIndex, step: pd.Timedelta, grid: TimeGrid, where: str, name: str
) -> Problem | None:
    """A series that does not cover the grid."""
    end = times[-1] + step
    if times[0] <= grid.start and end >= grid.end:
        return None
    return Problem(
        where,
        f"covers {iso(times[0])} to {iso(end)}, and the scenario is {iso(grid.start)} to "
        f"{iso(grid.end)}",
        "Choose days that it covers with --date or --start, and --days.",
        field=name,
    )


def _check_regular(
    times: pd.DatetimeIndex, step: pd.Timedelta, where: str, name: str
) -> Problem | None:
    """Times that are not all on the same steps."""
    off = np.flatnonzero((times - times[0]) % step != pd.Timedelta(0))
    if len(off) == 0:
        return None
    return Problem(
        where,
        f"has a time that is not a multiple of {step / _MINUTE:g} min after the first",
        "Give equal steps; steps that are missing are filled.",
        field=name,
        value=iso(times[off[0]]),
    )


def _gap(lost: pd.DatetimeIndex, longest: float, most: float, where: str, name: str) -> Problem:
    at = f" at {iso(lost[0])}" if len(lost) else ""
    return Problem(
        where,
        f"has a gap of {longest:g} min{at}, and {most:g} min are filled at most",
        "Complete the series, choose other days, or allow longer gaps with --max-gap.",
        field=name,
    )
