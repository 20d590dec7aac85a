"""A file of outages that were: one row each, with ``start`` and ``end``."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pandas as pd
from pydantic import Field

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few, shown
from vppres.io.series import time_of
from vppres.io.tables import CHECK_PATH, Table, read_rows, read_table
from vppres.io.warning_rows import read_warnings
from vppres.scenario.outage_warnings import OutageWarning


class OutageRow(schema.Row):
    """An outage that was, over the half-open interval from `start` to `end`."""

    start: str = Field(description="beginning of the outage, ISO 8601 with time zone")
    end: str = Field(description="end of the outage, ISO 8601 with time zone")


Interval = tuple[pd.Timestamp, pd.Timestamp]


def read_outage_log(file: str | Path) -> list[Interval]:
    """Outages of a file by their beginning, each as the times between which there was no grid.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    table, problems = read_table(Path(file), CHECK_PATH)
    rows, found = read_rows(table, OutageRow)
    problems += found
    outages: dict[int, Interval] = {}
    for line, row in rows.items():
        assert table is not None  # it has rows
        times, unreadable = _times(table, line, row)
        problems += unreadable
        if not unreadable:
            outages[line] = times[0], times[1]
    in_order = sorted(outages.items(), key=lambda item: item[1])
    problems += [] if table is None else _overlaps(table, in_order)
    if problems:
        raise InputError(problems)
    return [interval for _, interval in in_order]


def read_warning_file(file: str | Path) -> list[OutageWarning]:
    """Messages of a file like ``warnings.csv`` of a scenario.

    Raises
    ------
    InputError
        With every problem of the file.
    """
    table, problems = read_table(Path(file), CHECK_PATH)
    messages, found = read_warnings(table)
    if problems + found:
        raise InputError(problems + found)
    return list(messages.values())


def _times(table: Table, line: int, row: OutageRow) -> tuple[list[pd.Timestamp], list[Problem]]:
    """Beginning and end of a row."""
    times = []
    problems = []
    for name in ("start", "end"):
        text = getattr(row, name)
        time, message, cure = time_of(text)
        if time is None:
            problems.append(
                Problem(table.file, message, cure, row=line, field=name, value=shown(text))
            )
        else:
            times.append(time)
    if not problems and times[1] <= times[0]:
        cure = "Give the time at which the grid came back."
        message = "does not come after start"
        problems.append(
            Problem(table.file, message, cure, row=line, field="end", value=shown(row.end))
        )
    return times, problems


def _overlaps(table: Table, outages: list[tuple[int, Interval]]) -> list[Problem]:
    """Outages that begin before the one before is over; ``outages`` with their lines, in order."""
    early = [
        (line, start) for (_, (_, end)), (line, (start, _)) in pairwise(outages) if start < end
    ]
    cure = "Join the two rows, or correct one of them."
    return few(
        range(len(early)),
        lambda i: Problem(
            table.file,
            "begins before the outage before it is over",
            cure,
            row=early[i][0],
            field="start",
            value=early[i][1].isoformat(),
        ),
    )
