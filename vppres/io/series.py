"""Series of a scenario folder: the time column against the grid, and every number."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
from pydantic.fields import FieldInfo

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.io import schema
from vppres.io.messages import shown
from vppres.io.settings import iso
from vppres.io.tables import Table
from vppres.scenario.timegrid import TimeGrid

TIME = "time"
_OFFSET = re.compile(r"\d[T ]?.*(Z|[+-]\d{2}:?\d{2})$", re.IGNORECASE)


def check_times(table: Table, grid: TimeGrid) -> list[Problem]:
    """Problems of the time column: unreadable, missing, duplicate, strange or unsorted steps."""
    times, problems = _read_times(table)
    if problems or TIME not in table.names:
        return problems
    if times.empty:
        return [Problem(table.file, "has no row", _grid_cure(grid))]
    return (_check_step(table.file, times, grid) or _check_members(table.file, times, grid)
            or _check_sorted(table.file, times))


def read_values(table: Table, name: str, field: FieldInfo,
                infinite: bool = False) -> tuple[Floats, list[Problem]]:
    """Numbers of one column and the cells that are none, or out of bounds.

    Parameters
    ----------
    table : Table
        A table that has the column.
    name : str
        Column.
    field : FieldInfo
        Its bounds and unit.
    infinite : bool
        Whether ``inf`` is a value.

    Returns
    -------
    array, shape (rows,)
        NaN in cells that are no number.
    list of Problem
    """
    column = table.frame[name]
    values = _as_floats(column)
    low, high = schema.limits(field)
    faults = [
        (np.isnan(values), "is not a number"),
        (np.isinf(values) & ~(infinite & (values > 0)), "is not a finite number"),
        (np.isfinite(values) & (values < low), f"must be at least {low:g}"),
        (np.isfinite(values) & (values > high), f"must be at most {high:g}"),
    ]
    problems = []
    for bad, message in faults:
        for i in np.flatnonzero(bad):
            text = shown(table.texts[name].iloc[i])
            problems.append(Problem(table.file, message if text else "is empty",
                                    schema.cure(field), row=int(column.index[int(i)]), field=name,
                                    value=text))
    return values, problems


def _as_floats(column: pd.Series[float]) -> Floats:
    """Cells as numbers; Python's own parser, so that written numbers come back equal."""
    try:
        return np.asarray(column.to_numpy(), dtype=float)
    except (TypeError, ValueError):
        return np.array([_as_float(cell) for cell in column])


def _as_float(cell: object) -> float:
    try:
        return float(str(cell))
    except ValueError:
        return float("nan")


def _read_times(table: Table) -> tuple[pd.Series[pd.Timestamp], list[Problem]]:
    """Times in UTC by line of the file."""
    texts = table.texts[TIME] if TIME in table.names else pd.Series([], dtype=object)
    times = pd.to_datetime(texts, utc=True, format="ISO8601", errors="coerce")
    problems = []
    for line, text, time in zip(texts.index, texts, times, strict=True):
        if pd.isna(time) or not text[:4].isdigit():
            message = "is not an ISO 8601 time"
            cure = "Write it like 2022-07-19T12:00:00Z."
        elif not _OFFSET.search(text):
            message = "has no time zone"
            cure = f"Add the offset, for example {text}Z."
        else:
            continue
        problems.append(Problem(table.file, message if text else "is empty", cure,
                                row=int(str(line)), field=TIME, value=shown(text)))
    return times, problems


def _grid_cure(grid: TimeGrid) -> str:
    return (f"The scenario's steps begin at {iso(grid.start)} and last {grid.step_minutes:g} min; "
            f"there are {grid.n_steps}.")


def _check_step(file: str, times: pd.Series[pd.Timestamp], grid: TimeGrid) -> list[Problem]:
    """A series in another step length, which would otherwise be hundreds of problems."""
    if len(times) < 3:
        return []
    gaps = np.diff(times.to_numpy(dtype="datetime64[ns]"))
    apart = float(np.median(np.abs(gaps / np.timedelta64(1, "m"))))
    if np.isclose(apart, grid.step_minutes) or apart == 0:
        return []
    return [Problem(file, f"the rows are {apart:g} min apart", _grid_cure(grid), field=TIME)]


def _check_members(file: str, times: pd.Series[pd.Timestamp], grid: TimeGrid) -> list[Problem]:
    """Steps that are missing, given twice, or not of the grid."""
    expected = grid.times.tz_convert("UTC")
    first: dict[pd.Timestamp, int] = {}
    problems = []
    for line, time in times.items():
        row = int(str(line))
        if time not in expected:
            problems.append(Problem(file, "is not a step of the scenario", _grid_cure(grid),
                                    row=row, field=TIME, value=iso(time)))
        elif time in first:
            problems.append(Problem(file, f"is a duplicate of row {first[time]}",
                                    "Remove one of the two rows.", row=row, field=TIME,
                                    value=iso(time)))
        first.setdefault(time, row)
    return problems + [
        Problem(file, "this step is missing", "Add its row.", field=TIME, value=iso(time))
        for time in expected if time not in first]


def _check_sorted(file: str, times: pd.Series[pd.Timestamp]) -> list[Problem]:
    """The first row that goes back in time."""
    back = np.flatnonzero(np.diff(times.to_numpy(dtype="datetime64[ns]")) < np.timedelta64(0))
    if len(back) == 0:
        return []
    i = int(back[0]) + 1
    return [Problem(file, "is out of order", "Sort the rows by time.",
                    row=int(times.index[i]), field=TIME, value=iso(times.iloc[i]))]
