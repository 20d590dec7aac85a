"""A scenario folder read: every problem of every file at once, never a traceback."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.io import checks, schema
from vppres.io.genset_rows import check_gensets, gensets_of, refuels_of
from vppres.io.history import Columns, history_of
from vppres.io.messages import in_order
from vppres.io.outage_log import read_interruptions
from vppres.io.phase_files import PHASE_FILES, read_phases
from vppres.io.series import TIME, check_times, read_values
from vppres.io.settings import SCENARIO_FILE, Settings, read_settings
from vppres.io.tables import NAME_ANOTHER, Table, check_columns, no_table, read_rows, read_table
from vppres.io.thermal_rows import check_thermal_loads, thermal_loads_of
from vppres.io.vehicle_rows import chargers_of, check_vehicles, sessions_of
from vppres.io.warning_rows import read_warnings
from vppres.scenario.assets import OF_TIME_OFF, Batteries, Customers, PVSystems
from vppres.scenario.fairness import Fairness, Interruption
from vppres.scenario.history import History
from vppres.scenario.network import BusId, Network, check_radial
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.phases import Phases
from vppres.scenario.rules import SwitchingRules
from vppres.scenario.scenario import (
    ControllerDefaults,
    Headroom,
    ObjectiveWeights,
    Priority,
    Scenario,
)
from vppres.scenario.source import Source, SourceDeviation

# Tables that a folder may lack, with the model of their rows.
_OPTIONAL: dict[str, type[BaseModel]] = {
    "buses": schema.BusRow,
    "pv": schema.PVRow,
    "batteries": schema.BatteryRow,
    "ev_chargers": schema.ChargerRow,
    "ev_sessions": schema.SessionRow,
    "thermal_loads": schema.ThermalLoadRow,
    "gensets": schema.GensetRow,
    "refuel": schema.RefuelRow,
    "warnings": schema.WarningRow,
    "outages": schema.OutageRow,
}
_HISTORY = ("history_load_kw", "history_pv_kw")


@dataclass(frozen=True, eq=False)
class _Folder:
    """The files of a folder; None stands for a file that is missing or broken."""

    settings: Settings
    lines: Table | None
    buses: Table | None
    customers: Table | None
    pv: Table | None
    batteries: Table | None
    ev_chargers: Table | None
    ev_sessions: Table | None
    thermal_loads: Table | None
    gensets: Table | None
    refuel: Table | None
    load_kw: Table | None
    pv_kw: Table | None
    system: Table | None
    warnings: Table | None
    outages: Table | None
    history_load_kw: Table | None
    history_pv_kw: Table | None


@dataclass(frozen=True, eq=False)
class _Rows:
    """The sound rows of each table, by line of the file."""

    lines: dict[int, schema.Row]
    buses: dict[int, schema.Row]
    customers: dict[int, schema.Row]
    pv: dict[int, schema.Row]
    batteries: dict[int, schema.Row]
    chargers: dict[int, schema.Row]
    sessions: dict[int, schema.Row]
    thermal_loads: dict[int, schema.Row]
    gensets: dict[int, schema.Row]
    refuels: dict[int, schema.Row]
    warnings: dict[int, OutageWarning]
    outages: dict[int, Interruption]


@dataclass(frozen=True, eq=False)
class _Series:
    """The series, shapes (T, C), (T, P) and (T,)."""

    load_kw: Floats
    pv_kw: Floats
    price_gbp_per_kwh: Floats
    temperature_c: Floats
    grid_limit_kw: Floats
    export_limit_kw: Floats
    export_price_gbp_per_kwh: Floats


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
    content, problems = _read_files(folder)
    rows, row_problems = _read_all_rows(content)
    series, series_problems = _read_series(content, rows)
    history, history_problems = _read_history(content, rows)
    series_problems += history_problems
    problems += row_problems + _check_across(content, rows) + series_problems
    phases, phase_problems = _read_phases(folder, content)
    problems += phase_problems
    if problems or content.lines is None or content.settings.grid is None:
        files = [SCENARIO_FILE, *content.settings.files.model_dump().values()]
        raise InputError(in_order(problems, files))
    day = _assemble(content.settings, rows, series, checks.bus_reader(content.lines), phases)
    return day if history is None else replace(day, history=history)


def _read_phases(folder: Path, content: _Folder) -> tuple[Phases | None, list[Problem]]:
    """The three phases of a folder that has them."""
    if content.lines is None:
        return None, []
    return read_phases(folder, checks.bus_reader(content.lines))


def _read_files(folder: Path) -> tuple[_Folder, list[Problem]]:
    """All files of the folder. PV systems and batteries may be absent, unless they are listed."""
    settings, problems = read_settings(folder)
    names: dict[str, str] = settings.files.model_dump()
    tables: dict[str, Table | None] = {}
    for key, file in names.items():
        without_pv = key == "pv_kw" and (pv := tables["pv"]) is not None and pv.frame.empty
        optional = key in _OPTIONAL or key in _HISTORY or without_pv
        if optional and key not in settings.files.model_fields_set and not (folder / file).exists():
            absent = no_table(file, _OPTIONAL.get(key, schema.PVSeries))
            tables[key] = None if key in _HISTORY else absent
            continue
        tables[key], found = read_table(folder / file)
        problems += found
    problems += _misspelt_files(folder, {SCENARIO_FILE, *names.values(), *PHASE_FILES})
    series = tables["pv_kw"]
    if series is not None and tables["pv"] is not None and not (folder / names["pv"]).exists():
        systems = [name for name in series.names if name != TIME]
        if systems:
            message = f"the file is missing, and {series.file} has series of {named(systems)}"
            problems.append(Problem(names["pv"], message, NAME_ANOTHER))
            tables["pv"] = None
    return _Folder(settings, **tables), problems


def _misspelt_files(folder: Path, known: set[str]) -> list[Problem]:
    """Tables that are not read, and have nearly the name of one that is not there."""
    present = {entry.name for entry in folder.iterdir()}
    absent = {Path(name).stem: name for name in sorted(known - present)}
    problems = []
    for file in sorted(present - known):
        near = get_close_matches(Path(file).stem.lower(), absent, n=1, cutoff=0.75)
        if near and file.endswith((".csv", ".parquet")):
            cure = f"Did you mean {absent[near[0]]}? Rename it, or name it under [files]."
            problems.append(Problem(file, "is not read: it is no file of a scenario", cure))
    return problems


def _read_all_rows(content: _Folder) -> tuple[_Rows, list[Problem]]:
    lines, line_problems = read_rows(content.lines, schema.LineRow)
    buses, bus_problems = read_rows(content.buses, schema.BusRow)
    customers, customer_problems = read_rows(content.customers, schema.CustomerRow)
    pv, pv_problems = read_rows(content.pv, schema.PVRow)
    batteries, battery_problems = read_rows(content.batteries, schema.BatteryRow)
    chargers, charger_problems = read_rows(content.ev_chargers, schema.ChargerRow)
    sessions, session_problems = read_rows(content.ev_sessions, schema.SessionRow)
    thermal, thermal_problems = read_rows(content.thermal_loads, schema.ThermalLoadRow)
    gensets, genset_problems = read_rows(content.gensets, schema.GensetRow)
    refuels, refuel_problems = read_rows(content.refuel, schema.RefuelRow)
    warnings, warning_problems = read_warnings(content.warnings)
    outages, outage_problems = read_interruptions(content.outages)
    return (
        _Rows(
            lines,
            buses,
            customers,
            pv,
            batteries,
            chargers,
            sessions,
            thermal,
            gensets,
            refuels,
            warnings,
            outages,
        ),
        line_problems
        + bus_problems
        + customer_problems
        + pv_problems
        + battery_problems
        + charger_problems
        + session_problems
        + thermal_problems
        + genset_problems
        + refuel_problems
        + warning_problems
        + outage_problems,
    )


def _check_across(content: _Folder, rows: _Rows) -> list[Problem]:
    """Every check that needs more than one row or more than one file."""
    lines = content.lines
    buses = content.buses
    customers = content.customers
    pv = content.pv
    batteries = content.batteries
    chargers = content.ev_chargers
    thermal = content.thermal_loads
    gensets = content.gensets
    with_ids = (customers, pv, batteries, chargers, thermal, gensets)
    problems = [p for table in with_ids if table for p in checks.check_ids(table)]
    if buses:
        problems += checks.check_once(buses, "bus", "Give each bus one row.")
    if lines:
        problems += _check_network(lines, content.settings.slack_bus)
        problems += [
            p
            for table in (buses, customers, pv, batteries, chargers, gensets)
            if table
            for p in checks.check_buses(table, lines)
        ]
    if customers:
        problems += checks.check_any(customers)
    if customers and content.settings.tiers:
        problems += checks.check_known(
            customers, "tier", content.settings.tiers, f"is not a tier of {SCENARIO_FILE}"
        )
    if customers:
        known = customers.column("id").values()
        message = f"is not a customer of {customers.file}"
        for table in (pv, chargers, thermal, content.outages):
            if table:
                problems += checks.check_known(table, "customer", known, message)
    for table in (customers, pv):
        if customers and table:
            problems += checks.check_parts(table, rows.customers)
    if pv:
        problems += checks.check_places(pv) + checks.check_one_pv_each(pv)
        problems += checks.check_pv_ratings(pv.file, rows.pv)
    if chargers and content.ev_sessions:
        tables = (chargers, content.ev_sessions)
        tiers = content.settings.tiers or {}
        problems += check_vehicles(*tables, rows.chargers, rows.sessions, tiers)
    if thermal:
        problems += check_thermal_loads(thermal.file, rows.thermal_loads)
    if gensets:
        problems += check_gensets(gensets.file, rows.gensets)
    if content.refuel:
        sets = gensets.column("id").values() if gensets else []
        message = f"is not a set of {content.settings.files.gensets}"
        problems += checks.check_known(content.refuel, "genset", sets, message)
    if batteries:
        problems += checks.check_batteries(batteries.file, rows.batteries)
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


def _read_series(content: _Folder, rows: _Rows) -> tuple[_Series, list[Problem]]:
    """Times, columns and numbers of the three series; empty arrays where they are not sound."""
    load, load_problems = _read_columns(
        content.load_kw,
        content.customers,
        schema.LoadSeries.model_fields["load_kw"],
        f"Add one column per customer of {content.settings.files.customers}.",
    )
    pv, pv_problems = _read_columns(
        content.pv_kw,
        content.pv,
        schema.PVSeries.model_fields["pv_kw"],
        f"Add one column per PV system of {content.settings.files.pv}.",
    )
    system, system_problems = _read_system(content.system)
    problems = load_problems + pv_problems + system_problems
    problems += checks.check_one_export_limit(content.settings.file, content.system)
    if content.pv_kw:
        rating_kw = {row.id: row.p_max_kw for row in reversed(rows.pv.values())}
        for name in rating_kw.keys() & pv.keys():
            problems += checks.check_pv_series(content.pv_kw, name, pv[name], rating_kw[name])
    grid = content.settings.grid
    if grid:
        unused = content.pv_kw if content.pv and content.pv.frame.empty else None
        for table in (content.load_kw, content.pv_kw, content.system):
            if table and not (table is unused and table.frame.empty):
                problems += check_times(table, grid)
    n_steps = grid.n_steps if grid else 0
    return _Series(_stack(load, n_steps), _stack(pv, n_steps), **system), problems


def _read_history(content: _Folder, rows: _Rows) -> tuple[History | None, list[Problem]]:
    """What was measured before the first step, if there is anything."""
    grid = content.settings.grid
    if grid is None or (content.history_load_kw is None and content.history_pv_kw is None):
        return None, []
    columns = Columns(
        [row.id for row in rows.customers.values()], [row.id for row in rows.pv.values()]
    )
    history, problems = history_of(
        content.history_load_kw, content.history_pv_kw, columns, grid.zone
    )
    return (None if history is None else history.before(grid.start)), problems


def _read_columns(
    table: Table | None, items: Table | None, field: FieldInfo, cure: str
) -> tuple[dict[str, Floats], list[Problem]]:
    """One column of numbers per item, in the order of the items' table."""
    if table is None:
        return {}, []
    known = [*items.column("id").values()] if items and "id" in items.names else table.names
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


def _read_system(table: Table | None) -> tuple[dict[str, Floats], list[Problem]]:
    """Prices, temperature and limits; an absent limit is infinite, an absent export worthless."""
    model = schema.SystemSeries.model_fields
    values = {name: np.empty(0) for name in model if name != TIME}
    if table is None:
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


def _stack(columns: dict[str, Floats], n_steps: int) -> Floats:
    """Columns side by side, shape (T, number of columns)."""
    return np.column_stack(list(columns.values())) if columns else np.empty((n_steps, 0))


def _assemble(
    settings: Settings,
    rows: _Rows,
    series: _Series,
    read_bus: Callable[[str], BusId],
    phases: Phases | None,
) -> Scenario:
    """The scenario, from files in which no problem was found."""
    file = settings.file
    grid = settings.grid
    assert file is not None
    assert grid is not None
    limit_kw = series.grid_limit_kw.copy()
    one_limit_kw = file.network.export_limit_kw
    step = grid.step
    for outage in file.outages:
        begins = round((pd.Timestamp(outage.start) - grid.start) / step)
        ends = round((pd.Timestamp(outage.end) - grid.start) / step)
        limit_kw[begins:ends] = 0.0
    return Scenario(
        name=file.name,
        title=file.title or file.name,
        grid=grid,
        network=_network(file.network, rows.lines, rows.buses, read_bus),
        customers=_customers(rows.customers, file.tiers, read_bus),
        pv=_pv(rows.pv, read_bus),
        batteries=_batteries(rows.batteries, read_bus),
        load_kw=series.load_kw,
        pv_kw=series.pv_kw,
        grid_limit_kw=limit_kw,
        price_gbp_per_kwh=series.price_gbp_per_kwh,
        temperature_c=series.temperature_c,
        tiers=tuple(file.tiers),
        objective=ObjectiveWeights(**file.objective.model_dump()),
        controller=ControllerDefaults(**file.controller.model_dump()),
        priority=Priority(**file.priority.model_dump()),
        headroom=Headroom(**file.headroom.model_dump()),
        fairness=Fairness(**file.fairness.model_dump()),
        switching=SwitchingRules(**file.switching.model_dump()),
        export_limit_kw=series.export_limit_kw if one_limit_kw is None else np.array(one_limit_kw),
        export_price_gbp_per_kwh=series.export_price_gbp_per_kwh,
        source=_source(file.source),
        voll_gbp_per_kwh=file.reliability.voll_gbp_per_kwh,
        warnings=tuple(rows.warnings.values()),
        interruptions=tuple(rows.outages.values()),
        outage_statistics=OutageStatistics(**file.outage_statistics.model_dump()),
        phases=phases,
        chargers=chargers_of(rows.chargers, read_bus),
        sessions=sessions_of(rows.sessions, file.tiers),
        thermal_loads=thermal_loads_of(rows.thermal_loads),
        gensets=gensets_of(rows.gensets, read_bus),
        refuels=refuels_of(rows.refuels),
    )


def _source(section: schema.Section) -> Source:
    deviation = SourceDeviation(**section.deviation.model_dump())
    return Source(section.name, section.kind, tuple(section.notes), deviation, section.unbalanced)


def _columns(rows: Mapping[int, BaseModel], model: type[BaseModel]) -> dict[str, Any]:
    """Rows turned into one list per attribute."""
    return {name: [getattr(row, name) for row in rows.values()] for name in model.model_fields}


def _network(
    section: schema.Section,
    rows: Mapping[int, schema.Row],
    buses: Mapping[int, schema.Row],
    read_bus: Callable[[str], BusId],
) -> Network:
    columns = _columns(rows, schema.LineRow)
    draws = _columns(buses, schema.BusRow)
    draws["island"] = [text == "yes" for text in draws["island"]]
    draws["drawing_bus"] = [read_bus(text) for text in draws.pop("bus")]
    for end in ("from_bus", "to_bus"):
        columns[end] = [read_bus(text) for text in columns[end]]
    columns["i_max_a"] = [np.inf if i_max_a is None else i_max_a for i_max_a in columns["i_max_a"]]
    scalars = section.model_dump(exclude={"export_limit_kw"})
    scalars["slack_bus"] = read_bus(section.slack_bus)
    return Network(**columns, **draws, **scalars)


def _customers(
    rows: Mapping[int, schema.Row],
    tiers: dict[str, float],
    read_bus: Callable[[str], BusId],
) -> Customers:
    columns = _columns(rows, schema.CustomerRow)
    columns["bus"] = [read_bus(text) for text in columns["bus"]]
    columns["weight"] = [
        tiers[row.tier] if row.weight is None else row.weight for row in rows.values()
    ]
    for name in OF_TIME_OFF:
        columns[name] = [np.nan if hours is None else hours for hours in columns[name]]
    return Customers(**columns)


def _pv(rows: Mapping[int, schema.Row], read_bus: Callable[[str], BusId]) -> PVSystems:
    columns = _columns(rows, schema.PVRow)
    columns["bus"] = [read_bus(row.bus) if row.bus else None for row in rows.values()]
    return PVSystems(**columns)


def _batteries(rows: Mapping[int, schema.Row], read_bus: Callable[[str], BusId]) -> Batteries:
    columns = _columns(rows, schema.BatteryRow)
    columns["bus"] = [read_bus(text) for text in columns["bus"]]
    columns["soc_initial"] = [
        row.soc_min if row.soc_initial is None else row.soc_initial for row in rows.values()
    ]
    columns["t_initial_c"] = [
        np.nan if row.t_initial_c is None else row.t_initial_c for row in rows.values()
    ]
    columns["grid_forming"] = [row.grid_forming == "yes" for row in rows.values()]
    return Batteries(**columns)
