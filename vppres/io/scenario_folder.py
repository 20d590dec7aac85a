"""A scenario folder read: every problem of every file at once, never a traceback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vppres.core.arrays import Floats, given_or
from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.io import checks, schema
from vppres.io.fault_rows import check_faults, faults_of
from vppres.io.history import Columns as HistoryColumns
from vppres.io.history import history_of
from vppres.io.messages import in_order
from vppres.io.outage_log import read_interruptions
from vppres.io.phase_files import PHASE_FILES, read_phases
from vppres.io.rows import columns_of
from vppres.io.series import TIME, check_times, read_values
from vppres.io.settings import SCENARIO_FILE, Settings, read_settings
from vppres.io.tables import (
    NAME_ANOTHER,
    Table,
    check_columns,
    leads_out,
    no_table,
    read_rows,
    read_table,
    unread,
)
from vppres.io.warning_rows import read_warnings
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.table import SERIES as KIND_SERIES
from vppres.kinds.table import TABLES as KIND_TABLES
from vppres.scenario.assets import Batteries, Customers, PVSystems
from vppres.scenario.fairness import Fairness
from vppres.scenario.history import History
from vppres.scenario.network import BusId, Network, check_radial
from vppres.scenario.outage_warnings import OutageStatistics
from vppres.scenario.phases import BALANCED, Phases
from vppres.scenario.scenario import (
    ControllerDefaults,
    Headroom,
    ObjectiveWeights,
    Priority,
    Scenario,
)
from vppres.scenario.source import Source, SourceDeviation
from vppres.scenario.switches import Switches, switch_problems

MODELS: dict[str, type[BaseModel]] = {
    "lines": schema.LineRow,
    "buses": schema.BusRow,
    "switches": schema.SwitchRow,
    "customers": schema.CustomerRow,
    "pv": schema.PVRow,
    "batteries": schema.BatteryRow,
    **{table.key: schema.row_of(table.key) for table in KIND_TABLES.values()},
    "warnings": schema.WarningRow,
    "outages": schema.OutageRow,
    "faults": schema.FaultRow,
}
"""Rows of each table, by its key under [files]."""

READ_SUFFIXES = (".csv", ".parquet")
TABLE_SUFFIXES = (*READ_SUFFIXES, ".xlsx", ".xls", ".ods")
"""Endings of tables that are read, and of all that are taken for tables."""

NAMES_SHOWN = 5
"""Files named in one sentence."""

_NEEDED = ("lines", "customers", "load_kw", "system")
"""Files without which there is no scenario."""

_SERIES_OF = {
    "pv_kw": "pv",
    **{name: KIND_TABLES[of].key for name, of in KIND_SERIES.items()},
}
"""Files of series that are needed where the file beside them has rows."""

_HISTORY = ("history_load_kw", "history_pv_kw")

Tables = dict[str, Table]
"""The files of a folder by their keys; one that is missing or broken counts as false."""

AllRows = dict[str, dict[int, Any]]
"""The sound rows of each table, by line of the file."""

Columns = dict[str, Any]

_SECTIONS: dict[str, type[Any]] = {
    "objective": ObjectiveWeights,
    "controller": ControllerDefaults,
    "priority": Priority,
    "headroom": Headroom,
    "fairness": Fairness,
    "switching": SwitchingRules,
    "outage_statistics": OutageStatistics,
}
"""Sections of scenario.toml that are fields of a scenario, key by key."""

_REFERENCES = (
    ("pv", "customer", "customers", "customer"),
    ("outages", "customer", "customers", "customer"),
    *((table.key, *each) for table in KIND_TABLES.values() for each in table.references),
)
"""Columns with identifiers of another table, and what that one holds."""


def read_scenario(folder: str | Path) -> Scenario:
    """Read and check a scenario folder.

    Parameters
    ----------
    folder : str or Path
        See :func:`vppres.io.find_scenario` for packaged names.

    Raises
    ------
    InputError
        With every problem of every file, by file and row.
    """
    folder = Path(folder)
    if not folder.is_dir():
        message = "is not a folder" if folder.exists() else "there is no such folder"
        raise InputError.of(str(folder), message, "Give the path of a scenario folder.")
    settings, problems = read_settings(folder)
    if not (folder / SCENARIO_FILE).exists():
        raise InputError(problems)
    tables, table_problems = _read_files(folder, settings)
    rows, row_problems = _read_all_rows(tables)
    series, series_problems = _read_series(settings, tables, rows)
    history, history_problems = _read_history(settings, tables, rows)
    problems += table_problems + row_problems + _check_across(settings, tables, rows)
    problems += series_problems + history_problems
    lines = tables["lines"]
    read_bus = checks.bus_reader(lines) if lines else str
    phases = BALANCED
    if lines:
        phases, phase_problems = read_phases(folder, read_bus)
        problems += phase_problems
    if problems:
        files = [SCENARIO_FILE, *settings.files.model_dump().values()]
        raise InputError(in_order(problems, files))
    day = _assemble(settings, rows, series, read_bus, phases)
    return day if history is None else replace(day, history=history)


def _read_files(folder: Path, settings: Settings) -> tuple[Tables, list[Problem]]:
    """All files of the folder. PV systems and batteries may be absent, unless they are listed."""
    names: dict[str, str] = settings.files.model_dump()
    tables: Tables = {}
    problems: list[Problem] = []
    for key, file in names.items():
        of = tables.get(_SERIES_OF.get(key, ""))
        needed = not of or not of.frame.empty if key in _SERIES_OF else key in _NEEDED
        if not (needed or key in settings.files.model_fields_set or (folder / file).exists()):
            absent = no_table(file, MODELS.get(key, schema.PVSeries))
            tables[key] = unread(file) if key in _HISTORY else absent
            continue
        found = leads_out(folder, file)
        tables[key], found = (unread(file), found) if found else read_table(folder / file)
        problems += found
    problems += _misspelt_files(folder, _known_files(settings))
    series = tables["pv_kw"]
    if series and tables["pv"] and not (folder / names["pv"]).exists():
        systems = [name for name in series.names if name != TIME]
        if systems:
            message = f"the file is missing, and {series.file} has series of {named(systems)}"
            problems.append(Problem(names["pv"], message, NAME_ANOTHER))
            tables["pv"] = unread(names["pv"])
    return tables, problems


def _known_files(settings: Settings) -> set[str]:
    """Names of all files that a scenario with these settings may have."""
    return {SCENARIO_FILE, *settings.files.model_dump().values(), *PHASE_FILES}


def _unread_tables(folder: Path, known: set[str]) -> list[Path]:
    """Tables in a folder that are no files of its scenario, by name."""
    return sorted(
        entry
        for entry in folder.iterdir()
        if entry.name not in known and entry.suffix.lower() in TABLE_SUFFIXES
    )


def unread_words(folder: Path) -> list[str]:
    """A sentence on tables in the folder of a sound scenario that are no files of it."""
    unread_files = _unread_tables(folder, _known_files(read_settings(folder)[0]))
    if not unread_files:
        return []
    names = named([entry.name for entry in unread_files], NAMES_SHOWN)
    one = len(unread_files) == 1
    reads = "is not read: no file" if one else "are not read: no files"
    return [f"{names} {reads} of a scenario {'has this name' if one else 'have these names'}."]


def _misspelt_files(folder: Path, known: set[str]) -> list[Problem]:
    """Tables that are not read, and have nearly the name of one that is not there."""
    absent = {Path(name).stem: name for name in sorted(known) if not (folder / name).exists()}
    problems = []
    for file in _unread_tables(folder, known):
        near = get_close_matches(file.stem.lower(), absent, n=1, cutoff=0.75)
        if near:
            meant = absent[near[0]]
            cure = f"Did you mean {meant}? {_rename(file, meant)}"
            problems.append(Problem(file.name, "is not read: it is no file of a scenario", cure))
    return problems


def _rename(file: Path, meant: str) -> str:
    """How a table becomes the file that was meant; CSV and Parquet may have other names too."""
    suffix = file.suffix.lower()
    if suffix not in READ_SUFFIXES:
        return f"Save its sheet as {meant}: CSV, in UTF-8."
    same = suffix == Path(meant).suffix
    return f"{'Rename it, or name' if same else 'Name'} it under [files]."


def _read_all_rows(tables: Tables) -> tuple[AllRows, list[Problem]]:
    """The sound rows of each table by line of the file, and the problems of the others."""
    readers: dict[str, Callable[[Table], tuple[dict[int, Any], list[Problem]]]] = {
        "warnings": read_warnings,
        "outages": read_interruptions,
    }
    rows: AllRows = {}
    problems: list[Problem] = []
    for key, model in MODELS.items():
        read = readers.get(key)
        rows[key], found = read(tables[key]) if read else read_rows(tables[key], model)
        problems += found
    return rows, problems


def _check_across(settings: Settings, tables: Tables, rows: AllRows) -> list[Problem]:
    """Every check that needs more than one row or more than one file."""
    there = {key: table for key, table in tables.items() if table}
    lines = there.get("lines")
    problems = _check_network(lines, settings.slack_bus) if lines else []
    for key, table in there.items():
        problems += checks.check_ids(table)
        problems += checks.check_limits(table, key, rows.get(key, {}))
        if lines and key != "lines":
            problems += checks.check_buses(table, lines)
        if settings.tiers:
            message = f"is not a tier of {SCENARIO_FILE}"
            problems += checks.check_known(table, "tier", settings.tiers, message)
    if lines and settings.slack_bus and (faults := there.get("faults")):
        problems += check_faults(faults, rows["faults"], lines, settings.slack_bus)
    for key, column, other, what in _REFERENCES:
        if key in there and other in there:
            known = there[other].column("id").values()
            message = f"is not a {what} of {there[other].file}"
            problems += checks.check_known(there[key], column, known, message)
    if customers := there.get("customers"):
        problems += checks.check_any(customers)
        for table in filter(None, (customers, there.get("pv"))):
            problems += checks.check_parts(table, rows["customers"])
    if buses := there.get("buses"):
        problems += checks.check_once(buses, "bus", "Give each bus one row.")
    if lines and (switches := there.get("switches")):
        problems += _check_switches(switches, rows["switches"], lines)
    if pv := there.get("pv"):
        problems += checks.check_places(pv) + checks.check_one_pv_each(pv)
    if batteries := there.get("batteries"):
        problems += checks.check_soc_initial(batteries, rows["batteries"])
    for of_kind in KIND_TABLES.values():
        if found := there.get(of_kind.key):
            columns = schema.row_of(of_kind.key).model_fields
            problems += checks.check_places(found) if {"bus", "customer"} <= {*columns} else []
            problems += of_kind.problems(found, rows[of_kind.key])
    return problems


def _check_network(lines: Table, slack_bus: str | None) -> list[Problem]:
    """Whether the lines form a tree; only asked if every line has both ends."""
    if slack_bus is None or not {"from_bus", "to_bus"} <= set(lines.names):
        return []
    texts = [lines.texts(name).tolist() for name in ("from_bus", "to_bus")]
    if any("" in end for end in texts) or len(lines.frame) > schema.MAX_ITEMS:
        return []
    read_bus = checks.bus_reader(lines)
    from_bus, to_bus = (np.array([read_bus(text) for text in end], dtype=object) for end in texts)
    located = []
    for problem in check_radial(from_bus, to_bus, read_bus(slack_bus)):
        if problem.field == "slack_bus":
            located.append(replace(problem, where=SCENARIO_FILE, field="network.slack_bus"))
            continue
        # Blank lines of a file count as lines, so that positions differ from line numbers.
        row = None if problem.row is None else int(lines.frame.index[problem.row])
        located.append(replace(problem, where=lines.file, row=row))
    return located


def _check_switches(table: Table, rows: dict[int, Any], lines: Table) -> list[Problem]:
    """Whether the switches fit the lines; only asked if each of both has its ends."""
    if len(rows) < len(table.frame) or not {"from_bus", "to_bus"} <= set(lines.names):
        return []
    read_bus = checks.bus_reader(lines)
    switches = _switches(columns_of(rows, schema.SwitchRow, read_bus))
    from_bus, to_bus = (
        np.array([read_bus(text) for text in lines.column(name).values()], dtype=object)
        for name in ("from_bus", "to_bus")
    )
    if len(from_bus) != len(to_bus):
        return []
    numbers = [*rows]
    return [
        replace(
            problem, where=table.file, row=None if problem.row is None else numbers[problem.row]
        )
        for problem in switch_problems(switches, from_bus, to_bus)
    ]


def _switches(columns: Columns) -> Switches:
    """Switches of their columns; what has no limit is infinite."""
    unlimited = ("i_max_a", "max_operations_per_day")
    return Switches(**columns | {name: given_or(columns[name], np.inf) for name in unlimited})


def _read_series(
    settings: Settings, tables: Tables, rows: AllRows
) -> tuple[dict[str, Floats], list[Problem]]:
    """The series by name, (T, C), (T, P) and (T,); empty arrays where they are not sound."""
    load, load_problems = _read_columns(
        tables["load_kw"],
        tables["customers"],
        schema.LoadSeries.model_fields["load_kw"],
        f"Add one column per customer of {settings.files.customers}.",
    )
    pv_series, systems = tables["pv_kw"], tables["pv"]
    pv, pv_problems = _read_columns(
        pv_series,
        systems,
        schema.PVSeries.model_fields["pv_kw"],
        f"Add one column per PV system of {settings.files.pv}.",
    )
    system, system_problems = _read_system(tables["system"])
    problems = load_problems + pv_problems + system_problems
    problems += checks.check_one_export_limit(settings.file, tables["system"])
    if pv_series:
        rating_kw = {row.id: row.p_max_kw for row in reversed(rows["pv"].values())}
        for name in rating_kw.keys() & pv.keys():
            problems += checks.check_pv_series(pv_series, name, pv[name], rating_kw[name])
    columns = {"load_kw": load, "pv_kw": pv}
    for name, key in _SERIES_OF.items():
        if name not in columns:
            field = schema.row_of(name).model_fields[name]
            file = getattr(settings.files, key)
            cure = f"Add one column per row of {file}."
            columns[name], found = _read_columns(tables[name], tables[key], field, cure)
            problems += found
    grid = settings.grid
    if grid:
        for name in (*columns, "system"):
            table, of = tables[name], tables.get(_SERIES_OF.get(name, ""))
            unused = of and of.frame.empty
            if table and not (unused and table.frame.empty):
                problems += check_times(table, grid)
    n_steps = grid.n_steps if grid else 0
    # A site without units of a kind has the series of one that does not know the kind.
    stacked = {
        name: np.column_stack(list(each.values()))
        if each
        else np.empty((0 if name in KIND_SERIES else n_steps, 0))
        for name, each in columns.items()
    }
    return stacked | system, problems


def _read_history(
    settings: Settings, tables: Tables, rows: AllRows
) -> tuple[History | None, list[Problem]]:
    """Measurements before the first step, if there are any, and their problems."""
    grid = settings.grid
    load, pv = (tables[key] for key in _HISTORY)
    if not (grid and (load or pv)):
        return None, []
    columns = HistoryColumns(
        *([row.id for row in rows[key].values()] for key in ("customers", "pv"))
    )
    history, problems = history_of(load, pv, columns, grid.zone)
    return (None if history is None else history.before(grid.start)), problems


def _read_columns(
    table: Table, items: Table, field: FieldInfo, cure: str
) -> tuple[dict[str, Floats], list[Problem]]:
    """One column of numbers per item, in the order of the items' table."""
    if not table:
        return {}, []
    known = [*items.column("id").values()] if "id" in items.names else table.names
    if len({*known}) < len(known):
        known = table.names  # an identifier that was meant to be another is one mistake, not two
    ids = [name for name in dict.fromkeys(known) if name != TIME]
    time_cure = schema.cure(schema.SystemSeries.model_fields[TIME])
    problems = check_columns(
        table, [TIME, *ids], [TIME, *ids], {**dict.fromkeys(ids, cure), TIME: time_cure}
    )
    columns = {}
    given = set(table.names)
    for name in ids[: schema.MAX_ITEMS]:
        if name in given:
            columns[name], found = read_values(table, name, field)
            problems += found
    return columns, problems


def _read_system(table: Table) -> tuple[dict[str, Floats], list[Problem]]:
    """Prices, temperature and limits; an absent limit is infinite, an absent export worthless."""
    model = schema.SystemSeries.model_fields
    values = {name: np.empty(0) for name in model if name != TIME}
    if not table:
        return values, []
    problems = check_columns(
        table,
        list(model),
        [name for name, field in model.items() if field.is_required()],
        {name: schema.cure(field) for name, field in model.items()},
    )
    values["grid_limit_kw"] = np.full(len(table.frame), np.inf)
    values["export_limit_kw"] = np.asarray(np.inf)
    values["export_price_gbp_per_kwh"] = np.zeros(())
    for name in values:
        if name in table.names:
            values[name], found = read_values(
                table, name, model[name], infinite=name in ("grid_limit_kw", "export_limit_kw")
            )
            problems += found
    return values, problems


def _assemble(
    settings: Settings,
    rows: AllRows,
    series: dict[str, Floats],
    read_bus: Callable[[str], BusId],
    phases: Phases,
) -> Scenario:
    """The scenario, from files in which no problem was found."""
    file = settings.file
    grid = settings.grid
    assert file is not None
    assert grid is not None
    columns = {key: columns_of(rows[key], model, read_bus) for key, model in MODELS.items()}
    c, b = columns["customers"], columns["batteries"]
    of_tier = [file.tiers[tier] for tier in c["tier"]]
    limit_kw = series["grid_limit_kw"].copy()
    if file.network.export_limit_kw is not None:
        series["export_limit_kw"] = np.array(file.network.export_limit_kw)
    for outage in file.outages:
        begins = round((pd.Timestamp(outage.start) - grid.start) / grid.step)
        ends = round((pd.Timestamp(outage.end) - grid.start) / grid.step)
        limit_kw[begins:ends] = 0.0
    arrays: Columns = series | {"grid_limit_kw": limit_kw}
    of_kinds: Columns = {
        name: table.of_columns(columns[table.key], file.tiers)
        for name, table in KIND_TABLES.items()
    }
    return Scenario(
        name=file.name,
        title=file.title or file.name,
        grid=grid,
        network=_network(file.network, columns["lines"], columns["buses"], read_bus),
        customers=Customers(**c | {"weight": given_or(c["weight"], of_tier)}),
        pv=PVSystems(**columns["pv"]),
        batteries=Batteries(**b | {"soc_initial": given_or(b["soc_initial"], b["soc_min"])}),
        tiers=tuple(file.tiers),
        source=Source(
            file.source.name,
            file.source.kind,
            tuple(file.source.notes),
            SourceDeviation(**file.source.deviation.model_dump()),
            file.source.unbalanced,
        ),
        voll_gbp_per_kwh=file.reliability.voll_gbp_per_kwh,
        warnings=tuple(rows["warnings"].values()),
        interruptions=tuple(rows["outages"].values()),
        faults=faults_of(rows["faults"], read_bus),
        phases=phases,
        switches=_switches(columns["switches"]),
        **of_kinds,
        **arrays,
        **{key: kind(**getattr(file, key).model_dump()) for key, kind in _SECTIONS.items()},
    )


def _network(
    section: schema.TomlSection, lines: Columns, buses: Columns, read_bus: Callable[[str], BusId]
) -> Network:
    rating_a = given_or(lines.pop("i_max_a"), np.inf)
    drawing_bus = buses.pop("bus")
    scalars = section.model_dump(exclude={"export_limit_kw"})
    scalars["slack_bus"] = read_bus(section.slack_bus)
    return Network(**lines, i_max_a=rating_a, **buses, drawing_bus=drawing_bus, **scalars)
