"""Tables and options of a run as files, written and read back."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.core.plain import json_safe
from vppres.core.text import counted
from vppres.day.trajectory import OPTIONAL_TABLES, OPTIONS, TABLES, Trajectory
from vppres.io.scenario_folder import read_scenario
from vppres.scenario.scenario import Scenario

OPTIONS_FILE = "options.json"
ANOTHER = "Run the scenario again, or give a folder as a run wrote it."
NEEDED = {
    "steps": "time outage price_gbp_per_kwh p_grid_kw q_grid_kvar losses_kw v_min_ac_pu "
    "v_max_ac_pu v_error_pu objective bound gap status solve_s corrected fallback estimated "
    "ac_failed phase",
    "customers": "time id bus tier weight p_load_kw served",
    "pv": "time available_kw curtailed_kw",
    "batteries": "time charge_kw discharge_kw soc_start soc_end eta_discharge",
    "buses": "time bus v_model_pu v_ac_pu",
    "lines": "time p_ac_kw q_ac_kvar",
}
"""Columns without which there are no figures; older versions lack others, which may be missing."""


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
        If the folder is not a whole run folder, with every missing file, column and row, or its
        scenario is wrong.
    """
    folder = Path(folder)
    files = [folder / OPTIONS_FILE, *(_table_file(folder, name) for name in TABLES)]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        message = f"has no {', no '.join(missing)}"
        raise InputError([Problem(str(folder), message, "Give a folder written by a run.")])
    record = json.loads((folder / OPTIONS_FILE).read_text(encoding="utf-8"))
    present = [name for name in OPTIONAL_TABLES if _table_file(folder, name).is_file()]
    tables = {name: pd.read_parquet(_table_file(folder, name)) for name in (*TABLES, *present)}
    scenario = read_scenario(folder / "scenario")
    problems = [
        *_missing_options(record["options"]),
        *_missing_columns(tables),
        *_missing_rows(tables, scenario),
    ]
    if problems:
        raise InputError([replace(one, where=str(folder / one.where)) for one in problems])
    return Trajectory(
        scenario=scenario,
        **tables,
        options=record["options"],
        planned=record["planned"],
    )


def _missing_options(options: Mapping[str, Any]) -> Iterator[Problem]:
    missing = [name for name in OPTIONS if name not in options]
    if missing:
        yield Problem(OPTIONS_FILE, f"has no {', no '.join(missing)}", ANOTHER)


def _missing_columns(tables: Mapping[str, pd.DataFrame]) -> Iterator[Problem]:
    for name, needed in NEEDED.items():
        missing = [column for column in needed.split() if column not in tables[name]]
        if missing:
            message = f"has no column {', no column '.join(missing)}"
            yield Problem(f"{name}.parquet", message, ANOTHER)


def _missing_rows(tables: Mapping[str, pd.DataFrame], scenario: Scenario) -> Iterator[Problem]:
    """Tables that do not have a row for each item of the scenario in each step."""
    steps = len(tables["steps"])
    if not 0 < steps <= scenario.grid.n_steps:
        message = f"has {counted(steps, 'row')} for {counted(scenario.grid.n_steps, 'step')}"
        yield Problem("steps.parquet", message, ANOTHER)
    for name in ("customers", "pv", "batteries"):
        items, rows = len(getattr(scenario, name)), len(tables[name])
        if rows != items * steps:
            message = f"has {counted(rows, 'row')}, and not {items} in each of the {steps} steps"
            yield Problem(f"{name}.parquet", message, ANOTHER)


def _table_file(folder: Path, name: str) -> Path:
    return folder / f"{name}.parquet"
