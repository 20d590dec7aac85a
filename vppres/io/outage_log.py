"""A file of outages that were: one row each, with ``start`` and ``end``."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pandas as pd
from pydantic import Field

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few
from vppres.io.tables import CHECK_PATH, Table, read_rows, read_table
from vppres.io.warning_rows import read_warnings
from vppres.scenario.outage_warnings import OutageWarning


class OutageRow(schema.Row):
    """An outage that was, over the half-open interval from `start` to `end`."""

    start: schema.Time = Field(description="beginning of the outage, ISO 8601 with time zone")
    end: schema.Time = Field(description="end of the outage, ISO 8601 with time zone")


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
    outages = {line: (pd.Timestamp(row.start), pd.Timestamp(row.end)) for line, row in rows.items()}
    in_order = sorted(outages.items(), key=lambda item: item[1])
    problems += [] if table is None else _empty(table, outages) + _overlaps(table, in_order)
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


def _empty(table: Table, outages: dict[int, Interval]) -> list[Problem]:
    """Outages that end before they begin."""
    wrong = [line for line, (start, end) in outages.items() if end <= start]
    cure = "Give the time at which the grid came back."
    return few(
        wrong,
        lambda i: Problem(
            table.file,
            "does not come after start",
            cure,
            row=i,
            field="end",
            value=outages[i][1].isoformat(),
        ),
    )


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
