"""The tables of a phased feeder, read from a scenario folder and written into one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes, Floats
from vppres.core.errors import InputError, Problem
from vppres.io import schema
from vppres.io.tables import Table, leads_out, no_table, read_rows, read_table, unread
from vppres.scenario.network import BusId
from vppres.scenario.phases import (
    PHASES,
    TRIANGLE,
    PhaseBus,
    PhaseConnection,
    PhaseLine,
    Phases,
    PhaseShunt,
    PhaseTransformer,
)

MODELS = {
    "buses": schema.PhaseBusRow,
    "lines": schema.PhaseLineRow,
    "transformers": schema.PhaseTransformerRow,
    "shunts": schema.PhaseShuntRow,
    "connections": schema.PhaseConnectionRow,
}
"""Tables by the last word of their file's name."""

PHASE_FILES = tuple(f"phase_{name}.csv" for name in MODELS)
"""Their names."""

MUST = ("buses", "lines", "connections")
LARGEST_CONDITION = 1e12
"""Condition of a line's impedance beyond which rounding decides its currents."""

BUSES_FIRST = "Give all tables of a phased feeder, or remove them all for a balanced one."


def read_phases(
    folder: Path, read_bus: Callable[[str], BusId]
) -> tuple[Phases | None, list[Problem]]:
    """The phases of a folder, None for a balanced one, and what is wrong with their tables."""
    present = [name for name in MODELS if (folder / _file(name)).exists()]
    if not present:
        return None, []
    rows: dict[str, dict[int, Any]] = {}
    problems: list[Problem] = []
    for name, model in MODELS.items():
        if name not in present and name not in MUST:
            rows[name] = read_rows(no_table(_file(name), model), model)[0]
            continue
        found = leads_out(folder, _file(name))
        path = folder / _file(name)
        table, found = (unread(path.name), found) if found else read_table(path, BUSES_FIRST)
        rows[name], wrong = read_rows(table, model)
        problems += found + wrong
        problems += _lines_wrong(table, rows[name]) if name == "lines" else []
    if problems:
        return None, problems
    try:
        return _phases(rows, read_bus), []
    except InputError as error:
        return None, [each for each in error.problems if isinstance(each, Problem)]


def _file(name: str) -> str:
    return f"phase_{name}.csv"


def _phases(rows: dict[str, dict[int, Any]], read_bus: Callable[[str], BusId]) -> Phases:
    buses = [{**row.model_dump(), "at": read_bus(row.at)} for row in rows["buses"].values()]
    return Phases(
        tuple(PhaseBus(**row) for row in buses),
        tuple(_line(row) for row in rows["lines"].values()),
        tuple(PhaseTransformer(**row.model_dump()) for row in rows["transformers"].values()),
        tuple(PhaseShunt(**row.model_dump()) for row in rows["shunts"].values()),
        tuple(PhaseConnection(**row.model_dump()) for row in rows["connections"].values()),
        rows={name: tuple(found) for name, found in rows.items()},
    )


def _names(row: int, column: int) -> tuple[str, str, str]:
    """Columns of an entry: resistance, reactance, charging."""
    pair = PHASES[column] + PHASES[row]
    return f"r_{pair}_ohm", f"x_{pair}_ohm", f"b_{pair}_us"


def _line(row: Any) -> PhaseLine:
    """A line of its triangles; what is empty between phases that it has is 0."""
    z: Complexes = np.full((3, 3), np.nan, dtype=complex)
    b: Floats = np.full((3, 3), np.nan)
    own = [i for i in range(3) if getattr(row, _names(i, i)[0]) is not None]
    for i, j in TRIANGLE:
        if i in own and j in own:
            r, x, charging = (getattr(row, name) or 0.0 for name in _names(i, j))
            z[i, j] = z[j, i] = r + 1j * x
            b[i, j] = b[j, i] = charging
    i_max_a = np.nan if row.i_max_a is None else row.i_max_a
    return PhaseLine(row.from_bus, row.to_bus, z, b, i_max_a)


def _lines_wrong(table: Table, rows: dict[int, Any]) -> list[Problem]:
    """Faults of each line: lacking entries of phases, or else an impedance without currents."""
    problems = []
    for place, row in rows.items():
        own = [i for i in range(3) if getattr(row, _names(i, i)[0]) is not None]
        problems += _lacking(table, place, row, own) or _without_current(table, place, row, own)
    return problems


def _lacking(table: Table, place: int, row: Any, own: list[int]) -> list[Problem]:
    """Entries of phases that a line lacks."""
    problems = []
    for phases, name in [(pair, name) for pair in TRIANGLE for name in _names(*pair)]:
        lacking = [phase for phase in phases if phase not in own]
        value = getattr(row, name)
        if lacking and value is not None:
            message = f"is given, and phase {PHASES[lacking[0]]} has no resistance"
            cure = f"Give {_names(lacking[0], lacking[0])[0]} too, or leave both empty."
            problems.append(table.problem(place, name, message, cure, value))
    return problems


def _without_current(table: Table, place: int, row: Any, own: list[int]) -> list[Problem]:
    """An impedance that cannot be inverted."""
    z = _line(row).z_ohm[np.ix_(own, own)]
    if not own or np.linalg.cond(z) <= LARGEST_CONDITION:
        return []
    first = _names(own[0], own[0])[0]
    message = "has an impedance that no current can be found for"
    cure = "Give a resistance above 0 on each phase, and mutual ones below it."
    return [table.problem(place, first, message, cure, getattr(row, first))]


def phase_frames(phases: Phases) -> dict[str, pd.DataFrame]:
    """The tables as they are written, by name of their file; empty ones are left out."""
    tables: dict[str, list[dict[str, Any]]] = {
        "phase_buses": [asdict(row) for row in phases.buses],
        "phase_lines": [_line_row(line) for line in phases.lines],
        "phase_transformers": [asdict(row) for row in phases.transformers],
        "phase_shunts": [asdict(row) for row in phases.shunts],
        "phase_connections": [asdict(row) for row in phases.connections],
    }
    return {name: pd.DataFrame(rows) for name, rows in tables.items() if rows}


def _line_row(line: PhaseLine) -> dict[str, Any]:
    row: dict[str, Any] = {"from_bus": line.from_bus, "to_bus": line.to_bus}
    own = {*line.phases}
    parts = (line.z_ohm.real, line.z_ohm.imag, line.b_us)
    for part, values in enumerate(parts):
        for i, j in TRIANGLE:
            row[_names(i, j)[part]] = float(values[i, j]) if {i, j} <= own else None
    row["i_max_a"] = None if np.isnan(line.i_max_a) else line.i_max_a
    return row
