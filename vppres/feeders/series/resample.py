"""Series of others on the steps of a scenario: means are kept, gaps are filled or refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.core.errors import Problem
from vppres.io.times import iso
from vppres.scenario.timegrid import TimeGrid

_MINUTE_NS = 60 * 10**9


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
    t = series.index.as_unit("ns").asi8  # type: ignore[attr-defined]
    values = series.to_numpy(dtype=float)
    problem = _check_order(t, where, name)
    if problem is not None:
        return OnGrid(np.empty(0)), [problem]
    step = _step_of(t)
    begin = grid.start.as_unit("ns").value
    end = grid.end.as_unit("ns").value
    last = int(t[-1]) + step
    if t[0] > begin or last < end:
        return OnGrid(np.empty(0)), [_outside(t[0], last, grid, where, name)]
    problem = _check_regular(t, step, where, name)
    if problem is not None:
        return OnGrid(np.empty(0)), [problem]
    # As many values beyond the grid as a gap may have, so that lines have both their ends.
    margin = int(most_gap_min * _MINUTE_NS // step) + 1
    first = max((begin - int(t[0])) // step - margin, 0)
    count = min(-((int(t[0]) - end) // step) + margin, (last - int(t[0])) // step) - first
    own = np.full(count, np.nan)
    place = (t - t[0]) // step - first
    inside = (place >= 0) & (place < count)
    own[place[inside]] = values[inside]
    starts = t[0] + (first + np.arange(count)) * step
    needed = (starts + step > begin) & (starts < end)
    missing = np.isnan(own)
    longest = _longest_run(missing, needed) * step / _MINUTE_NS
    if longest > most_gap_min or missing.all():
        at = starts[missing & needed]
        return OnGrid(np.empty(0)), [_gap(at, longest, most_gap_min, where, name)]
    if missing.any():
        own = np.interp(starts, starts[~missing], own[~missing])
    return OnGrid(_means(own, starts, step, grid), int((missing & needed).sum()), longest), []


def _means(own: Floats, starts: Wholes, step: int, grid: TimeGrid) -> Floats:
    """Mean over every step of the grid of values that hold for a step of their own."""
    begin = grid.start.as_unit("ns").value
    length = round(grid.step_minutes * _MINUTE_NS)
    edges = begin + np.arange(grid.n_steps + 1) * length
    if step == length and (begin - int(starts[0])) % step == 0:
        at = (begin - int(starts[0])) // step
        return np.asarray(own[at : at + grid.n_steps])  # to the last digit
    energy = np.concatenate([[0.0], np.cumsum(own)]) * step
    own_edges = np.append(starts, starts[-1] + step) - begin
    return np.asarray(np.diff(np.interp(edges - begin, own_edges, energy)) / length)


def _step_of(t: Wholes) -> int:
    """The most frequent distance of times; a single one is taken as an hour."""
    if len(t) < 2:
        return 60 * _MINUTE_NS
    apart, count = np.unique(np.diff(t), return_counts=True)
    return int(apart[np.argmax(count)])


def _longest_run(missing: Flags, needed: Flags) -> int:
    """Length of the longest run of missing values that touches what is needed."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]]).astype(int)))
    runs = [
        end - start
        for start, end in zip(edges[::2], edges[1::2], strict=True)
        if needed[start:end].any()
    ]
    return max(runs, default=0)


def _check_order(t: Wholes, where: str, name: str) -> Problem | None:
    """A series without values, or with times that do not rise."""
    if len(t) == 0:
        return Problem(where, "has no value", "Give a value for every step.", field=name)
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back) == 0:
        return None
    again = t[back[0] + 1] == t[back[0]]
    return Problem(
        where,
        "has a time twice" if again else "has times that are out of order",
        "Remove one of the two rows." if again else "Sort the rows by time.",
        field=name,
        value=_text(t[back[0] + 1]),
    )


def _check_regular(t: Wholes, step: int, where: str, name: str) -> Problem | None:
    """Times that are not all on the same steps."""
    off = np.flatnonzero((t - t[0]) % step != 0)
    if len(off) == 0:
        return None
    return Problem(
        where,
        f"has a time that is not a multiple of {step / _MINUTE_NS:g} min after the first",
        "Give equal steps; steps that are missing are filled.",
        field=name,
        value=_text(t[off[0]]),
    )


def _outside(first: int, last: int, grid: TimeGrid, where: str, name: str) -> Problem:
    return Problem(
        where,
        f"covers {_text(first)} to {_text(last)}, and the scenario is {iso(grid.start)} to "
        f"{iso(grid.end)}",
        "Choose days that it covers with --date or --start, and --days.",
        field=name,
    )


def _gap(missing: Wholes, longest: float, most: float, where: str, name: str) -> Problem:
    at = f" at {_text(missing[0])}" if len(missing) else ""
    return Problem(
        where,
        f"has a gap of {longest:g} min{at}, and {most:g} min are filled at most",
        "Complete the series, choose other days, or allow longer gaps with --max-gap.",
        field=name,
    )


def _text(ns: int) -> str:
    return iso(pd.Timestamp(int(ns), tz="UTC"))
