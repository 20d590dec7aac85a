"""A scenario folder written, such that it reads back equal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import tomli_w
from numpy.typing import ArrayLike
from pydantic import ValidationError

from vppres.core.arrays import Floats
from vppres.core.errors import InputError
from vppres.core.text import iso
from vppres.io import schema
from vppres.io.atomic import atomic_folder
from vppres.io.messages import problems_of
from vppres.io.phase_files import phase_frames
from vppres.io.python_door import check_scenario
from vppres.io.rows import frame_of
from vppres.io.series import TIME
from vppres.io.settings import SCENARIO_FILE, outage_intervals
from vppres.io.tables import too_many_rows
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.table import KINDS, units_of
from vppres.scenario.fairness import Fairness, Interruption
from vppres.scenario.faults import LineFault
from vppres.scenario.history import History
from vppres.scenario.network import BUS_DRAWS, LINE_DEFAULTS
from vppres.scenario.outage_warnings import OutageStatistics
from vppres.scenario.scenario import DEFAULT_VOLL_GBP_PER_KWH, ControllerDefaults, Scenario
from vppres.scenario.switches import SWITCH_DEFAULTS
from vppres.scenario.timegrid import UTC, TimeGrid


def write_scenario(scenario: Scenario, folder: str | Path) -> None:
    """Write a scenario folder that :func:`vppres.io.read_scenario` reads back equal.

    Numbers are written in the shortest form that reads back to the same value. Runs of steps with
    a grid limit of zero become outages.

    Parameters
    ----------
    scenario : Scenario
        What to write.
    folder : str or Path
        A folder that does not exist yet, or is empty.

    Raises
    ------
    InputError
        If the folder holds something, scenario.toml could not say what the scenario says, a table
        would be too long to be read, or a name or a number is one that reading refuses.
    """
    check_scenario(scenario)
    document_of(scenario)  # refused before anything is touched
    with atomic_folder(folder) as aside:
        fill_scenario_folder(scenario, aside)


def fill_scenario_folder(scenario: Scenario, folder: Path) -> None:
    """Write the files of a scenario into an existing folder."""
    document = document_of(scenario)
    frames = frames_of(scenario, document["tiers"])
    long = [
        problem
        for name, frame in frames.items()
        if TIME not in frame
        for problem in too_many_rows(f"{name}.csv", len(frame))
    ]
    if long:
        raise InputError(long)
    (folder / SCENARIO_FILE).write_text(tomli_w.dumps(document), encoding="utf-8")
    for name, frame in frames.items():
        frame.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")


def document_of(scenario: Scenario) -> dict[str, Any]:
    """scenario.toml as nested dictionaries, checked like one that was read."""
    objective = scenario.objective
    document: dict[str, Any] = {
        "name": scenario.name,
        "title": scenario.title,
        "time": _time(scenario.grid),
        "network": _network(scenario),
        "tiers": {tier: scenario.customers.tier_weight(tier) for tier in scenario.tiers},
        "priority": asdict(scenario.priority),
        "headroom": asdict(scenario.headroom),
        "objective": {f.name: float(getattr(objective, f.name)) for f in fields(objective)},
        "outages": outage_intervals(scenario),
        "controller": _controller(scenario.controller),
        **_unusual(scenario),
    }
    try:
        schema.ScenarioFile.model_validate(document)
    except ValidationError as error:
        raise InputError(problems_of(error, schema.ScenarioFile, SCENARIO_FILE)) from None
    return document


def _network(scenario: Scenario) -> dict[str, Any]:
    """The slack bus, limits of voltages, and a limit of the export that holds in all steps."""
    network = scenario.network
    of_network = {f.name for f in fields(network)} - {"slack_bus"}
    limits = [name for name in schema.NetworkSection.model_fields if name in of_network]
    slack = network.slack_bus
    section = {
        "slack_bus": slack if isinstance(slack, str) else int(str(slack)),
        **{name: float(getattr(network, name)) for name in limits},
    }
    if scenario.export_limit_kw.ndim == 0 and np.isfinite(scenario.export_limit_kw):
        section["export_limit_kw"] = float(scenario.export_limit_kw)
    return section


def _controller(defaults: ControllerDefaults) -> dict[str, Any]:
    """Options of a run that the scenario asks for."""
    section: dict[str, Any] = {
        "kind": defaults.kind,
        "horizon_h": float(defaults.horizon_h),
        "mode": defaults.mode,
        "voltage_limits": defaults.voltage_limits,
        "ratings": defaults.ratings,
    }
    if defaults.outages != ControllerDefaults.outages:
        section["outages"] = defaults.outages
    if defaults.soc_end is not None:
        section["soc_end"] = float(defaults.soc_end)
    return section


def _unusual(scenario: Scenario) -> dict[str, Any]:
    """Sections that stand only where they say something else than the defaults."""
    sections: dict[str, Any] = {}
    if scenario.switching != SwitchingRules():
        sections["switching"] = _given(scenario.switching)
    if scenario.fairness != Fairness():
        sections["fairness"] = asdict(scenario.fairness)
    if scenario.voll_gbp_per_kwh != DEFAULT_VOLL_GBP_PER_KWH:
        sections["reliability"] = {"voll_gbp_per_kwh": float(scenario.voll_gbp_per_kwh)}
    if scenario.outage_statistics != OutageStatistics():
        sections["outage_statistics"] = _given(scenario.outage_statistics)
    if scenario.source:
        source = scenario.source
        deviation = {
            name: float(value)
            for name, value in asdict(source.deviation).items()
            if value is not None
        }
        sections["source"] = {
            "name": source.name,
            "kind": source.kind,
            **({"unbalanced": source.unbalanced} if source.unbalanced else {}),
            "notes": list(source.notes),
            **({"deviation": deviation} if deviation else {}),
        }
    return sections


def _given(section: SwitchingRules | OutageStatistics) -> dict[str, Any]:
    """Keys of a section that have a value."""
    return {name: value for name, value in asdict(section).items() if value is not None}


def _time(grid: TimeGrid) -> dict[str, Any]:
    """The time grid; the zone of the clocks only where it is not UTC."""
    return {
        "start": grid.start.to_pydatetime(),
        "step_minutes": float(grid.step_minutes),
        "steps": int(grid.n_steps),
        **({"zone": grid.zone} if grid.zone != UTC else {}),
    }


def frames_of(scenario: Scenario, tier_weights: dict[str, float]) -> dict[str, pd.DataFrame]:
    """The tables by name of their file."""
    network = scenario.network
    customers = scenario.customers
    frames = {
        "lines": frame_of(network, schema.LineRow, LINE_DEFAULTS),
        "customers": frame_of(customers, schema.CustomerRow, ("shed_steps", "homes")),
        "pv": frame_of(scenario.pv, schema.PVRow, ("kind", "bus")),
        "batteries": frame_of(scenario.batteries, schema.BatteryRow, ("grid_forming",)),
        "load_kw": _timed_frame(scenario.grid.times, customers.id, scenario.load_kw),
        "pv_kw": _timed_frame(scenario.grid.times, scenario.pv.id, scenario.pv_kw),
        "system": _system_frame(scenario),
    }
    if all(w == tier_weights[t] for w, t in zip(customers.weight, customers.tier, strict=True)):
        frames["customers"] = frames["customers"].drop(columns="weight")
    if network.has_draws:
        drawing = np.any([getattr(network, name) != 0 for name in BUS_DRAWS], axis=0)
        columns = {name: getattr(network, name)[drawing] for name in (*BUS_DRAWS, "island")}
        buses = SimpleNamespace(bus=network.buses[drawing], **columns)
        frames["buses"] = frame_of(buses, schema.BusRow, columns)
    if len(scenario.switches):
        frames["switches"] = frame_of(scenario.switches, schema.SwitchRow, SWITCH_DEFAULTS)
    for kind in map(KINDS.__getitem__, units_of(scenario)):
        for name, table in kind.tables.items():
            rows: Any = getattr(scenario, name)
            frames[table.key] = frame_of(rows, schema.row_of(table.key)).drop(
                columns=[*rows.unsaid]
            )
            for series in table.series:
                values = getattr(scenario, series)
                frames[series] = _timed_frame(scenario.grid.times, rows.id, values)
    if scenario.warnings:
        unsaid = ("outage", "preset")
        frames["warnings"] = frame_of(scenario.warnings, schema.WarningRow, unsaid)
    if scenario.interruptions:
        frames["outages"] = outage_frame(scenario.interruptions)
    if scenario.faults:
        frames["faults"] = _fault_frame(scenario.faults)
    if scenario.history is not None:
        frames |= _history_frames(scenario, scenario.history)
    frames |= phase_frames(scenario.phases)
    return frames


def outage_frame(interruptions: Sequence[Interruption]) -> pd.DataFrame:
    """Outages that were as rows of ``outages.csv``."""
    return frame_of(tuple(interruptions), schema.OutageRow)


def _fault_frame(faults: Sequence[LineFault]) -> pd.DataFrame:
    """Faults as rows of ``faults.csv``; a column of numbers with empty cells would have points."""
    frame = frame_of(tuple(faults), schema.FaultRow, ("known",))
    for name in frame.columns.intersection(["line", "bus"]):
        frame[name] = ["" if bus is None else str(bus) for bus in frame[name]]
    return frame


def _history_frames(scenario: Scenario, history: History) -> dict[str, pd.DataFrame]:
    """Tables of the measurements before the scenario, with empty cells where none was made."""
    values = {
        "history_load_kw": (scenario.customers.id, history.load_kw),
        "history_pv_kw": (scenario.pv.id, history.pv_kw),
    }
    return {
        name: _timed_frame(history.times, ids, kw) for name, (ids, kw) in values.items() if kw.size
    }


def _timed_frame(times: pd.DatetimeIndex, ids: ArrayLike, values: Floats) -> pd.DataFrame:
    frame = pd.DataFrame(values, columns=np.asarray(ids, dtype=object))
    frame.insert(0, TIME, [iso(time) for time in times])
    return frame


def _system_frame(scenario: Scenario) -> pd.DataFrame:
    """Outages are in scenario.toml, so that the limit is a column only where it limits."""
    limit_kw = scenario.grid_limit_kw
    columns = {
        TIME: [iso(time) for time in scenario.grid.times],
        "price_gbp_per_kwh": scenario.price_gbp_per_kwh,
        "temperature_c": scenario.temperature_c,
    }
    if np.any(np.isfinite(limit_kw) & (limit_kw > 0)):
        columns["grid_limit_kw"] = limit_kw
    if scenario.export_limit_kw.ndim:
        columns["export_limit_kw"] = scenario.export_limit_kw
    if scenario.export_price_gbp_per_kwh.any():
        columns["export_price_gbp_per_kwh"] = scenario.export_price
    return pd.DataFrame(columns)
