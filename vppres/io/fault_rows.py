"""Rows of ``faults.csv`` as faults, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pandas as pd

from vppres.core.errors import Problem
from vppres.io.checks import bus_reader, check_buses
from vppres.io.messages import few
from vppres.io.rows import Rows
from vppres.io.settings import SCENARIO_FILE
from vppres.io.tables import Table
from vppres.scenario.faults import LineFault
from vppres.scenario.network import BusId


def faults_of(rows: Rows, read_bus: Callable[[str], BusId]) -> tuple[LineFault, ...]:
    """The faults of rows in which nothing is wrong."""
    return tuple(
        LineFault(
            pd.Timestamp(row.start),
            pd.Timestamp(row.end),
            read_bus(row.line) if row.line else None,
            read_bus(row.bus) if row.bus else None,
            row.known == "yes",
        )
        for row in rows.values()
    )


def check_faults(table: Table, rows: Rows, lines: Table, slack_bus: str) -> list[Problem]:
    """Faults of no line or bus, or of two, of the grid's own bus, and such as end too early."""
    problems = check_buses(table, lines, "line")
    cure = "Give the bus that the line feeds, or the bus that is out itself."
    both = {line: row.line for line, row in rows.items() if row.line and row.bus}
    problems += _each(table, "line", both, "is given beside bus", cure)
    none = {line: "" for line, row in rows.items() if not (row.line or row.bus)}
    problems += _each(table, "line", none, "is empty, and so is bus", cure)
    read_bus = bus_reader(lines)
    for field in ("line", "bus"):
        named = {line: getattr(row, field) for line, row in rows.items() if getattr(row, field)}
        at_grid = {k: text for k, text in named.items() if read_bus(text) == read_bus(slack_bus)}
        message = "is the bus of the grid, which no line feeds"
        if field == "bus":
            message = "is the bus of the grid"
        cure = f"Give an outage under [[outages]] in {SCENARIO_FILE}, or another bus."
        problems += _each(table, field, at_grid, message, cure)
    early = {line: row.end.isoformat() for line, row in rows.items() if row.end <= row.start}
    cure = "Give the time at which it is repaired."
    return problems + _each(table, "end", early, "does not come after start", cure)


def _each(
    table: Table, field: str, cells: Mapping[int, str], message: str, cure: str
) -> list[Problem]:
    """Problems of a field in some lines of the file, with the same message."""
    wrong = [*cells.items()]

    def problem(i: int) -> Problem:
        line, text = wrong[i]
        return table.problem(line, field, message, cure, text or None)

    return few(range(len(wrong)), problem)
