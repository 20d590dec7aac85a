"""Measured series from files: a history of demand and PV power, with or without gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic.fields import FieldInfo

from vppres.core.arrays import Floats, Names, Wholes
from vppres.core.errors import InputError, Problem
from vppres.core.text import iso
from vppres.io import schema
from vppres.io.messages import few
from vppres.io.series import TIME, read_times, read_values
from vppres.io.tables import Table, check_columns, read_table, unread
from vppres.io.times import usual_step
from vppres.scenario.history import History
from vppres.scenario.timegrid import UTC

LOAD_NAMES = ("history_load_kw", "load_kw")
PV_NAMES = ("history_pv_kw", "pv_kw")
SUFFIXES = (".csv", ".parquet")


@dataclass(frozen=True)
class Columns:
    """Identifiers of the columns that a history has; all of a file in their order if not given.

    One that a file lacks has no known value.
    """

    customers: Sequence[str] | Names | None = None
    pv: Sequence[str] | Names | None = None


def read_history(path: str | Path, columns: Columns | None = None, zone: str = UTC) -> History:
    """Measured series of a folder or file.

    A folder has ``history_load_kw`` or ``load_kw`` and may have ``history_pv_kw`` or ``pv_kw``, as
    CSV or Parquet; a file is demand. Each has a column ``time`` and one column in kW for each
    customer or PV system. Steps may be missing and cells empty.

    Parameters
    ----------
    path : str or Path
        Folder or file.
    columns : Columns, optional
        Identifiers in the order of the arrays.
    zone : str
        Time zone of the clocks on the feeder.

    Raises
    ------
    InputError
        With every problem of every file.
    """
    path = Path(path)
    load_file, pv_file = _files(path)
    load, problems = read_table(load_file)
    pv = unread(PV_NAMES[-1])
    if pv_file:
        pv, found = read_table(pv_file)
        problems += found
    if problems:
        raise InputError(problems)
    history, problems = history_of(load, pv, columns or Columns(), zone)
    if history is None:
        raise InputError(problems)
    return history


def _files(path: Path) -> tuple[Path, Path | None]:
    """The file of demand, and that of PV power if there is one."""
    if path.is_file():
        return path, None
    if not path.is_dir():
        raise InputError.of(
            str(path),
            "there is no such file or folder",
            "Give a file of measured demand, or a folder with load_kw.csv and pv_kw.csv.",
        )
    load = _first(path, LOAD_NAMES)
    if load is None:
        raise InputError.of(
            str(path),
            "has no measured demand",
            "Add load_kw.csv or load_kw.parquet: time, and a column for each customer.",
        )
    return load, _first(path, PV_NAMES)


def _first(folder: Path, names: Sequence[str]) -> Path | None:
    """The first file there is of some names."""
    files = (folder / f"{name}{suffix}" for name in names for suffix in SUFFIXES)
    return next((file for file in files if file.is_file()), None)


def history_of(
    load: Table, pv: Table, columns: Columns, zone: str
) -> tuple[History | None, list[Problem]]:
    """A history from tables as they were read, and what is wrong with them.

    ``zone`` is that of the clocks on the feeder.
    """
    given = [
        _Series.read(table, ids, field)
        for table, ids, field in (
            (load, columns.customers, schema.LoadSeries.model_fields["load_kw"]),
            (pv, columns.pv, schema.PVSeries.model_fields["pv_kw"]),
        )
    ]
    problems = [problem for series in given for problem in series.problems]
    timed = [series for series in given if len(series.times)]
    if not problems and not timed:
        files = [table for table in (load, pv) if table]
        problems = [Problem(t.file, "has no row", "Add what was measured.") for t in files]
    if problems or not timed:
        return None, problems
    step = min(usual_step(series.times) for series in timed)
    start = min(series.times[0] for series in timed)
    end = max(series.times[-1] for series in timed) + step
    for series in timed:
        problems += series.off_grid(start, step)
    if problems:
        return None, problems
    times = pd.date_range(start, end, freq=step, inclusive="left")
    load_kw, pv_kw = (series.on(times) for series in given)
    return History(start, step / pd.Timedelta(minutes=1), load_kw, pv_kw, zone), []


@dataclass(frozen=True, eq=False)
class _Series:
    """One table of measured values, (n, items), at times in UTC."""

    table: Table
    times: pd.DatetimeIndex
    lines: pd.Index
    values: Floats
    problems: list[Problem]

    @classmethod
    def read(cls, table: Table, ids: Sequence[str] | Names | None, field: FieldInfo) -> _Series:
        """Times and values of a table; no rows where there is none."""
        none = pd.DatetimeIndex([], tz=UTC)
        if not table:
            n_items = 0 if ids is None else len(ids)
            return cls(table, none, pd.Index([]), np.empty((0, n_items)), [])
        known = [name for name in table.names if name != TIME] if ids is None else list(ids)
        problems = check_columns(
            table, [TIME, *known], [TIME], {TIME: "Give the beginning of each step."}
        )
        times, found = read_times(table)
        problems += found
        values = np.full((len(table.frame), len(known)), np.nan)
        for i, name in enumerate(known):
            if name in table.names:
                values[:, i], found = read_values(table, name, field, gaps=True)
                problems += found
        if problems:
            return cls(table, none, pd.Index([]), values, problems)
        order = np.argsort(times.to_numpy(), kind="stable")
        index, lines = pd.DatetimeIndex(times.iloc[order]), table.frame.index[order]
        series = cls(table, index, lines, values[order], [])
        again = np.flatnonzero(index.duplicated())
        return replace(
            series, problems=series.at(again, "is given twice", "Remove one of the two rows.")
        )

    def at(self, rows: Wholes, message: str, cure: str) -> list[Problem]:
        """Problems of some of the times."""
        lines, times = self.lines, self.times
        return few(
            rows,
            lambda i: self.table.problem(int(lines[i]), TIME, message, cure, iso(times[i])),
        )

    def off_grid(self, start: pd.Timestamp, step: pd.Timedelta) -> list[Problem]:
        """Times that are no multiple of the step after the start."""
        off = np.flatnonzero((self.times - start) % step != pd.Timedelta(0))
        cure = f"Give steps of {step / pd.Timedelta(minutes=1):g} min from {iso(start)}."
        return self.at(off, "is not the beginning of a step", cure)

    def on(self, times: pd.DatetimeIndex) -> Floats:
        """Values at equal steps, NaN where there is none."""
        values = np.full((len(times), self.values.shape[1]), np.nan)
        values[times.get_indexer(self.times)] = self.values
        return values
