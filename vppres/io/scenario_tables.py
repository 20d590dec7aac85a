"""Scenarios from tables in memory, with the checks and messages of a folder.

The tables are those of the files, by their names without the ending; ``scenario`` is what
``scenario.toml`` says.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import tomli_w

from vppres.core.errors import InputError, Problem
from vppres.core.text import iso
from vppres.io import schema
from vppres.io.messages import did_you_mean
from vppres.io.phase_files import PHASE_FILES
from vppres.io.scenario_folder import read_scenario
from vppres.io.scenario_writer import document_of, frames_of
from vppres.io.series import TIME
from vppres.io.settings import SCENARIO_FILE
from vppres.scenario.scenario import Scenario

SETTINGS = "scenario"
TABLES = (*schema.FilesSection.model_fields, *(Path(name).stem for name in PHASE_FILES))
"""Names of all tables of a scenario."""

_NAMED_BY = {"buses": "bus", "lines": "to_bus"}
"""Column that names the rows of a table, where it is not ``id``."""


def tables_of(scenario: Scenario) -> dict[str, Any]:
    """Tables of a scenario, and its settings as a dictionary, as they would be written."""
    settings = document_of(scenario)
    return {SETTINGS: settings, **frames_of(scenario, settings["tiers"])}


def scenario_of(tables: Mapping[str, Any]) -> Scenario:
    """The scenario of some tables, read and checked like a folder of them."""
    problems = [
        Problem(
            "tables",
            "is no table of a scenario",
            did_you_mean(str(name), (SETTINGS, *TABLES), "Remove it."),
            field=str(name),
        )
        for name in tables
        if name not in (SETTINGS, *TABLES)
    ]
    if problems:
        raise InputError(problems)
    with TemporaryDirectory(prefix="vppres-") as place:
        folder = Path(place)
        settings = {k: v for k, v in tables.get(SETTINGS, {}).items() if k != "files"}
        (folder / SCENARIO_FILE).write_text(tomli_w.dumps(_plain(settings)), encoding="utf-8")
        for name in TABLES:
            if name in tables:
                cells = _as_written(tables[name])
                cells.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")
        return read_scenario(folder)


def replaced(scenario: Scenario, table: str, name: object, values: Mapping[str, Any]) -> Scenario:
    """Scenario with other values in one row of a table."""
    tables = tables_of(scenario)
    key = _NAMED_BY.get(table, "id")
    frame = tables.get(table)
    if table == SETTINGS or frame is None or key not in frame:
        rows = [t for t, f in tables.items() if t != SETTINGS and _NAMED_BY.get(t, "id") in f]
        raise _unknown("table", table, "is no table of this scenario with names", rows)
    names = frame[key].astype(str).tolist()
    if str(name) not in names:
        raise _unknown(table, name, "is not in the table", names, key)
    row = names.index(str(name))
    cells = frame.astype(object)
    if table == "customers" and "tier" in values and "weight" in cells:
        weights = tables[SETTINGS]["tiers"]
        if cells["weight"].iloc[row] == weights[cells["tier"].iloc[row]]:
            cells.loc[row, "weight"] = None  # the weight of the new tier
    for column, value in values.items():
        if column not in cells:
            cells[column] = None
        cells.loc[row, column] = value
    return scenario_of({**tables, table: cells})


def _unknown(
    where: str, name: object, message: str, known: list[str], field: str = "name"
) -> InputError:
    cure = did_you_mean(str(name), known, "Give one that is there.")
    return InputError.of(where, message, cure, field=field, value=name)


def _as_written(table: Any) -> pd.DataFrame:
    """A table with its times in front, and with cells as files have them."""
    frame = pd.DataFrame(table)
    if TIME not in frame and isinstance(frame.index, pd.DatetimeIndex):
        frame = frame.rename_axis(TIME).reset_index()
    return pd.DataFrame({name: column.map(_cell) for name, column in frame.items()})


def _cell(value: Any) -> Any:
    if isinstance(value, datetime):
        return iso(pd.Timestamp(value)) if value.tzinfo else value.isoformat()
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return value


def _plain(value: Any) -> Any:
    """Settings without the types of pandas and NumPy, which TOML does not know."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items() if each is not None}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, pd.Timestamp):
        return value.to_pydatetime()
    return value.item() if isinstance(value, np.generic) else value
