"""Tables and options of a run as files, written and read back."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.core.plain import json_safe
from vppres.day.trajectory import OPTIONAL_TABLES, TABLES, Trajectory
from vppres.io.scenario_folder import read_scenario

OPTIONS_FILE = "options.json"


def write_tables(trajectory: Trajectory, folder: Path) -> None:
    """Write the tables as Parquet, options and plan as JSON, into an existing folder."""
    for name, table in trajectory.tables.items():
        table.to_parquet(_table_file(folder, name), index=False)
    record = {"options": trajectory.options, "planned": trajectory.planned}
    (folder / OPTIONS_FILE).write_text(
        json.dumps(json_safe(record), indent=2) + "\n", encoding="utf-8"
    )


def read_run(folder: Path | str) -> Trajectory:
    """Read a run folder back.

    Raises
    ------
    InputError
        If the folder is not a whole run folder, with every missing file, or its scenario is wrong.
    """
    folder = Path(folder)
    files = [folder / OPTIONS_FILE, *(_table_file(folder, name) for name in TABLES)]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        message = f"has no {', no '.join(missing)}"
        raise InputError([Problem(str(folder), message, "Give a folder written by a run.")])
    record = json.loads((folder / OPTIONS_FILE).read_text(encoding="utf-8"))
    explained = [name for name in OPTIONAL_TABLES if _table_file(folder, name).is_file()]
    tables = {name: pd.read_parquet(_table_file(folder, name)) for name in (*TABLES, *explained)}
    return Trajectory(
        scenario=read_scenario(folder / "scenario"),
        **tables,
        options=record["options"],
        planned=record["planned"],
    )


def _table_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.parquet"
