"""A file of past outages: a row each, with ``start``, ``end`` and, if known, ``customer``."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few
from vppres.io.tables import CHECK_PATH, Table, read_rows, read_table
from vppres.io.warning_rows import read_warnings
from vppres.scenario.fairness import Interruption
from vppres.scenario.outage_warnings import OutageWarning

Interval = tuple[pd.Timestamp, pd.Timestamp]


def read_outage_log(file: str | Path) -> list[Interval]:
    """Outages of the feeder by their beginning: times between which there was no grid."""
    table, problems = read_table(Path(file), CHECK_PATH)
    rows, found = read_interruptions(table)
    if problems + found:
        raise InputError(problems + found)
    return sorted((one.start, one.end) for one in rows.values() if not one.customer)


def read_interruptions(table: Table) -> tuple[dict[int, Interruption], list[Problem]]:
    """The sound rows of a table by line, and all its problems."""
    rows, problems = read_rows(table, schema.OutageRow)
    found = {
        line: Interruption(pd.Timestamp(row.start), pd.Timestamp(row.end), row.customer)
        for line, row in rows.items()
    }
    of_each: dict[str, list[tuple[int, Interval]]] = {}
    for line, one in sorted(found.items(), key=lambda item: (item[1].start, item[1].end)):
        of_each.setdefault(one.customer, []).append((line, (one.start, one.end)))
    for in_order in of_each.values():
        problems += _empty(table, dict(in_order)) + _overlaps(table, in_order)
    return found, problems


def read_warning_file(file: str | Path) -> list[OutageWarning]:
    """Messages of a file like ``warnings.csv`` of a scenario."""
    table, problems = read_table(Path(file), CHECK_PATH)
    messages, found = read_warnings(table)
    if problems + found:
        raise InputError(problems + found)
    return list(messages.values())


def _empty(table: Table, outages: dict[int, Interval]) -> list[Problem]:
    """Outages that end before they begin."""
    wrong = [line for line, (start, end) in outages.items() if end <= start]
    message, cure = "does not come after start", "Give the time at which the grid came back."
    return few(
        range(len(wrong)),
        lambda i: table.problem(wrong[i], "end", message, cure, outages[wrong[i]][1].isoformat()),
    )


def _overlaps(table: Table, outages: list[tuple[int, Interval]]) -> list[Problem]:
    """Outages that begin before the one before is over; ``outages`` with their lines, in order."""
    early = [
        (line, start) for (_, (_, end)), (line, (start, _)) in pairwise(outages) if start < end
    ]
    message = "begins before the outage before it is over"
    cure = "Join the two rows, or correct one of them."
    return few(
        range(len(early)),
        lambda i: table.problem(early[i][0], "start", message, cure, early[i][1].isoformat()),
    )
