"""Series of a scenario folder: the time column against the grid, and every number."""

from __future__ import annotations

import numpy as np
import pandas as pd
from pydantic.fields import FieldInfo

from vppres.core.arrays import Floats
from vppres.core.errors import Problem
from vppres.core.text import iso
from vppres.io import schema
from vppres.io.messages import few, shown
from vppres.io.tables import Table, cell_text
from vppres.io.times import parsed_times, time_fault
from vppres.scenario.timegrid import TimeGrid

TIME = "time"


def check_times(table: Table, grid: TimeGrid) -> list[Problem]:
    """Problems of the time column: unreadable, missing, duplicate, strange or unsorted steps."""
    times, problems = read_times(table)
    if problems or TIME not in table.names:
        return problems
    if times.empty:
        return [Problem(table.file, "has no row", _grid_cure(grid))]
    return (
        _check_step(table, times, grid)
        or _check_members(table, times, grid)
        or _check_sorted(table, times)
    )


def read_values(
    table: Table, name: str, field: FieldInfo, infinite: bool = False, gaps: bool = False
) -> tuple[Floats, list[Problem]]:
    """Numbers of one column and the cells that are none, or out of bounds.

    Cells that are no number are NaN; ``infinite`` allows ``inf``, ``gaps`` empty cells.
    """
    column = table.frame[name]
    values = _as_floats(column)
    low, high = schema.limits(field)
    unread = np.isnan(values)
    if gaps and unread.any():
        unread[unread] = column[unread].map(cell_text).to_numpy() != ""
    faults = [
        (unread, "is not a number"),
        (np.isinf(values) & ~(infinite & (values > 0)), "is not a finite number"),
        (np.isfinite(values) & (values < low), f"must be at least {low:g}"),
        (np.isfinite(values) & (values > high), f"must be at most {high:g}"),
    ]
    problems = []
    for bad, message in faults:
        problems += table.problems(np.flatnonzero(bad), name, message, schema.cure(field))
    return values, problems


def _as_floats(column: pd.Series[float]) -> Floats:
    """Cells as numbers; Python's own parser, so that written numbers come back equal."""
    if column.dtype.kind not in "iufO":  # dates and complex numbers of Parquet files are none
        return np.array([_as_float(cell) for cell in column])
    try:
        return np.asarray(column.to_numpy(), dtype=float)
    except (TypeError, ValueError):
        return np.array([_as_float(cell) for cell in column])


def _as_float(cell: object) -> float:
    try:
        return float(str(cell))
    except ValueError:
        return float("nan")


def read_times(table: Table) -> tuple[pd.Series[pd.Timestamp], list[Problem]]:
    """Times in UTC by line of the file."""
    texts = table.texts(TIME) if TIME in table.names else pd.Series([], dtype=object)
    times, unreadable, has_offset = parsed_times(texts)

    def problem(i: int) -> Problem:
        text = texts.iloc[i]
        message, cure = time_fault(text, bool(unreadable[i]))
        line = int(texts.index[i])
        return table.problem(line, TIME, message if text else "is empty", cure, shown(text))

    return times, (
        few(np.flatnonzero(unreadable), problem)
        + few(np.flatnonzero(~unreadable & ~has_offset), problem)
    )


def _grid_cure(grid: TimeGrid) -> str:
    return (
        f"The scenario's steps begin at {iso(grid.start)} and last {grid.step_minutes:g} min; "
        f"there are {grid.n_steps}."
    )


def _check_step(table: Table, times: pd.Series[pd.Timestamp], grid: TimeGrid) -> list[Problem]:
    """A series in another step length, which would otherwise be hundreds of problems."""
    if len(times) < 3:
        return []
    gaps = np.diff(times.to_numpy(dtype="datetime64[ns]"))
    apart = float(np.median(np.abs(gaps / np.timedelta64(1, "m"))))
    if np.isclose(apart, grid.step_minutes) or apart == 0:
        return []
    return [Problem(table.file, f"the rows are {apart:g} min apart", _grid_cure(grid), field=TIME)]


def _check_members(table: Table, times: pd.Series[pd.Timestamp], grid: TimeGrid) -> list[Problem]:
    """Steps that are missing, given twice, or not of the grid."""
    expected = grid.times.tz_convert("UTC")
    member = times.isin(expected).to_numpy(bool)
    again = times.duplicated().to_numpy(bool)
    missing = expected[~expected.isin(times)]

    def of_row(i: int, message: str, cure: str) -> Problem:
        return table.problem(int(times.index[i]), TIME, message, cure, iso(times.iloc[i]))

    def duplicate(i: int) -> Problem:
        first = times.index[int(np.argmax(times == times.iloc[i]))]
        return of_row(i, f"is a duplicate of row {first}", "Remove one of the two rows.")

    def lacking(i: int) -> Problem:
        step = iso(missing[i])
        return Problem(table.file, "this step is missing", "Add its row.", field=TIME, value=step)

    strange = "is not a step of the scenario"
    return (
        few(np.flatnonzero(~member), lambda i: of_row(i, strange, _grid_cure(grid)))
        + few(np.flatnonzero(member & again), duplicate)
        + few(range(len(missing)), lacking)
    )


def _check_sorted(table: Table, times: pd.Series[pd.Timestamp]) -> list[Problem]:
    """The first row that goes back in time."""
    back = np.flatnonzero(np.diff(times.to_numpy(dtype="datetime64[ns]")) < np.timedelta64(0))
    if len(back) == 0:
        return []
    row = int(times.index[back[0] + 1])
    value = iso(times.iloc[back[0] + 1])
    return [table.problem(row, TIME, "is out of order", "Sort the rows by time.", value)]
