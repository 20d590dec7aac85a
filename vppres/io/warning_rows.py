"""Rows of ``warnings.csv`` as messages, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from pydantic import ValidationError

from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.messages import few
from vppres.io.tables import Table, read_rows
from vppres.scenario.outage_warnings import OutageWarning


def read_warnings(table: Table) -> tuple[dict[int, OutageWarning], list[Problem]]:
    """The sound messages of a table by line, and all problems of the others."""
    rows, problems = read_rows(table, schema.WarningRow)
    found: dict[int, OutageWarning] = {}
    wrong: list[Problem] = []
    for line, row in rows.items():
        try:
            found[line] = OutageWarning(**dict(row))
        except InputError as error:
            wrong += _located(error, table, line)
    wrong += _beside(table, rows, problems)
    return found, problems + few(range(len(wrong)), lambda i: wrong[i])


def _beside(table: Table, rows: Mapping[int, Any], problems: list[Problem]) -> list[Problem]:
    """Further problems of rows with a cell that cannot be read."""
    wrong: list[Problem] = []
    fields: dict[int | None, set[str | None]] = {}
    for problem in problems:
        fields.setdefault(problem.row, set()).add(problem.field)
    names = [name for name in table.names if name in schema.WarningRow.model_fields]
    cells = {name: table.column(name) for name in names}
    for line in map(int, table.frame.index):
        unread = fields.get(line, set())
        given = {
            name: texts[line]
            for name, texts in cells.items()
            if name not in unread and line in texts
        }
        if line in rows or "issued_at" not in given:
            continue
        try:
            OutageWarning(**dict(schema.WarningRow.model_validate(given)))
        except InputError as error:
            # That a cell is missing is no mistake of its own if it could not be read.
            found = _located(error, table, line)
            wrong += [problem for problem in found if problem.field not in unread]
        except ValidationError:  # beyond the first problems of a table
            continue
    return wrong


def _located(error: InputError, table: Table, line: int) -> list[Problem]:
    """The problems of a message as those of its row."""
    return [
        table.problem(
            line, problem.field or "", problem.message, problem.cure, _text(problem.value)
        )
        for problem in error.problems
        if isinstance(problem, Problem)
    ]


def _text(value: Any) -> Any:
    """A value as its cell has it."""
    return value.isoformat() if isinstance(value, pd.Timestamp) else value
