"""Rows of ``warnings.csv`` as messages, and what is wrong with them."""

from __future__ import annotations

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few
from vppres.io.tables import Table, read_rows
from vppres.scenario.outage_warnings import OutageWarning


def read_warnings(table: Table | None) -> tuple[dict[int, OutageWarning], list[Problem]]:
    """The sound messages of a table by line, and the problems of the others."""
    rows, problems = read_rows(table, schema.WarningRow)
    found: dict[int, OutageWarning] = {}
    wrong: list[Problem] = []
    for line, row in rows.items():
        assert table is not None  # it has rows
        try:
            found[line] = OutageWarning(**dict(row))
        except InputError as error:
            told = [problem for problem in error.problems if isinstance(problem, Problem)]
            wrong += [_located(problem, table.file, line) for problem in told]
    return found, problems + few(range(len(wrong)), lambda i: wrong[i])


def _located(problem: Problem, file: str, line: int) -> Problem:
    """A problem of a message as one of its row."""
    value = problem.value
    text = value.isoformat() if isinstance(value, pd.Timestamp) else value
    return Problem(file, problem.message, problem.cure, row=line, field=problem.field, value=text)
