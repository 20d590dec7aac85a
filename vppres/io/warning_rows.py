"""Rows of ``warnings.csv`` as messages, and what is wrong with them."""

from __future__ import annotations

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few, shown
from vppres.io.series import time_of
from vppres.io.tables import Table, read_rows
from vppres.scenario.outage_warnings import OutageWarning

TIMES = ("issued_at", "onset_earliest", "onset_likely", "onset_latest")


def read_warnings(table: Table | None) -> tuple[dict[int, OutageWarning], list[Problem]]:
    """The sound messages of a table by line, and the problems of the others."""
    rows, problems = read_rows(table, schema.WarningRow)
    found: dict[int, OutageWarning] = {}
    wrong: list[Problem] = []
    for line, row in rows.items():
        assert table is not None  # it has rows
        times, unreadable = _times(table.file, line, row)
        wrong += unreadable
        if unreadable:
            continue
        try:
            found[line] = OutageWarning(**(row.model_dump(exclude=set(TIMES)) | times))
        except InputError as error:
            told = [problem for problem in error.problems if isinstance(problem, Problem)]
            wrong += [_located(problem, table.file, line) for problem in told]
    return found, problems + few(range(len(wrong)), lambda i: wrong[i])


def _times(file: str, line: int, row: schema.Row) -> tuple[dict[str, pd.Timestamp], list[Problem]]:
    """The times of a row by their columns; an empty cell is none."""
    found = {}
    problems = []
    for name in TIMES:
        text = getattr(row, name)
        if not text:
            continue
        time, message, cure = time_of(text)
        if time is not None:
            found[name] = time
        else:
            problems.append(Problem(file, message, cure, row=line, field=name, value=shown(text)))
    return found, problems


def _located(problem: Problem, file: str, line: int) -> Problem:
    """A problem of a message as one of its row."""
    value = problem.value
    text = value.isoformat() if isinstance(value, pd.Timestamp) else value
    return Problem(file, problem.message, problem.cure, row=line, field=problem.field, value=text)
