"""Your own forecasts from a file: quantiles by time and series."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from vppres.core.arrays import Names
from vppres.core.errors import InputError, Problem
from vppres.forecasts.given import TOTALS, GivenQuantiles
from vppres.io import schema
from vppres.io.messages import did_you_mean, few
from vppres.io.series import TIME, read_times, read_values
from vppres.io.tables import CHECK_PATH, Table, read_table

ISSUED = "issued_at"
SERIES = "series"
_QUANTILE = re.compile(r"q(\d{1,2}(?:\.\d+)?)")
_FIRST = pd.Timestamp("1970-01-01", tz="UTC")


def read_quantiles(
    path: str | Path, customers: Names, pv: Names, lag: pd.Timedelta | None = None
) -> GivenQuantiles:
    """Quantiles of load and PV power from a CSV or Parquet file.

    A row has ``time`` (the beginning of a step), ``series`` (``load`` or ``pv`` for the feeder's
    total, or the identifier of a customer or PV system), a column for each quantile (``q10``,
    ``q50``, ``q90``: per cent) in kW, and may have ``issued_at``; without it, it is known always.

    Parameters
    ----------
    path : str or Path
        The file.
    customers, pv : array of str
        Identifiers in the order of the arrays.
    lag : Timedelta, optional
        By how much a row must be older than the forecast that uses it.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    table, problems = read_table(Path(path), CHECK_PATH)
    if problems:
        raise InputError(problems)
    levels = {
        name: float(match[1]) / 100.0
        for name in table.names
        if (match := _QUANTILE.fullmatch(name)) and float(match[1]) > 0.0
    }
    problems = _check_columns(table, levels)
    if problems:
        raise InputError(problems)
    ordered = sorted(levels, key=lambda name: levels[name])
    columns = []
    for name in ordered:
        values, found = read_values(table, name, schema.LoadSeries.model_fields["load_kw"])
        columns.append(values)
        problems += found
    values = np.column_stack(columns)
    times, found = read_times(table)
    issued = pd.Series(_FIRST, index=table.frame.index)
    problems += found
    if ISSUED in table.names:
        issued, found = read_times(
            Table(table.file, table.frame[[ISSUED]].rename(columns={ISSUED: TIME}))
        )
        problems += [Problem(p.where, p.message, p.cure, p.row, ISSUED, p.value) for p in found]
    series = table.texts(SERIES).to_numpy(dtype=object)
    problems += _check_rows(table, series, values, [*TOTALS, *customers, *pv])
    if problems:
        raise InputError(problems)
    return GivenQuantiles(
        pd.DatetimeIndex(issued),
        pd.DatetimeIndex(times),
        series,
        np.array([levels[name] for name in ordered]),
        values,
        customers,
        pv,
        lag or pd.Timedelta(0),
    )


def _check_columns(table: Table, levels: dict[str, float]) -> list[Problem]:
    """Columns that are missing, and those that are none of a forecast."""
    problems = [
        Problem(table.file, "the column is missing", cure, field=name)
        for name, cure in (
            (TIME, "Give the beginning of each step."),
            (SERIES, "Write load, pv, or an identifier."),
        )
        if name not in table.names
    ]
    if not levels:
        cure = "Add some such as q10, q50 and q90, in kW."
        problems.append(Problem(table.file, "has no column of a quantile", cure))
    unknown = [name for name in table.names if name not in (TIME, SERIES, ISSUED, *levels)]
    return problems + few(
        range(len(unknown)),
        lambda i: Problem(
            table.file,
            "is not a known column",
            "Quantiles are named q1 to q99, in per cent.",
            field=unknown[i],
        ),
    )


def _check_rows(table: Table, series: Names, values: np.ndarray, known: list[str]) -> list[Problem]:
    """Series that no asset has, and quantiles that fall."""

    def at(message: str, cure: str, field: str, i: int) -> Problem:
        row = int(table.frame.index[i])
        value = series[i] if field == SERIES else None
        return Problem(table.file, message, cure, row=row, field=field, value=value)

    foreign = np.flatnonzero(~np.isin(series.astype(str), known))
    falling = np.flatnonzero((np.diff(values, axis=1) < 0.0).any(axis=1))
    return few(
        foreign,
        lambda i: at(
            "is neither load nor pv nor an identifier of the scenario",
            did_you_mean(str(series[i]), known, "Correct it."),
            SERIES,
            i,
        ),
    ) + few(
        falling,
        partial(at, "falls from a lower quantile to a higher one", "Sort the row.", "quantiles"),
    )
