"""scenario.toml: what of it is sound, and the problems of the rest."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd
from pydantic import BaseModel, ValidationError

from vppres.core.arrays import spans_of
from vppres.core.errors import Problem
from vppres.core.text import iso
from vppres.core.units import minutes_to_h
from vppres.io import schema
from vppres.io.messages import problems_of
from vppres.io.tables import leads_out, no_file, read_text
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

M = TypeVar("M", bound=BaseModel)

SCENARIO_FILE = "scenario.toml"
# Ten thousand outages; its parser is written in Python.
MAX_SETTINGS_BYTES = 1_000_000


@dataclass(frozen=True)
class Settings:
    """The sound parts of scenario.toml; None stands for a part that is wrong or missing.

    The other files are checked against what is there, so that one reading finds all problems.
    """

    file: schema.TomlSection | None
    grid: TimeGrid | None
    slack_bus: str | None
    tiers: dict[str, float] | None
    files: schema.TomlSection


def read_settings(folder: Path) -> tuple[Settings, list[Problem]]:
    """Read and check scenario.toml."""
    document, problems = _read_toml(folder / SCENARIO_FILE)
    if problems:
        return Settings(None, None, None, None, schema.FilesSection()), problems
    file: schema.TomlSection | None = None
    try:
        file = schema.ScenarioFile.model_validate(document)
    except ValidationError as error:
        problems = problems_of(error, schema.ScenarioFile, SCENARIO_FILE)
    time = file.time if file else _sound(document, "time", schema.TimeSection)
    network = file.network if file else _sound(document, "network", schema.NetworkSection)
    outages = file.outages if file else []
    files = file.files if file else _sound(document, "files", schema.FilesSection)
    too_long = check_length(time) if time else []
    problems += too_long
    problems += check_voltages(network) if network else []
    grid = None
    if time and not too_long:
        grid = TimeGrid(pd.Timestamp(time.start), time.step_minutes, time.steps, time.zone)
    problems += check_outages(outages, grid) if grid else []
    return Settings(
        file=file,
        grid=grid,
        slack_bus=network.slack_bus if network else None,
        tiers=file.tiers if file else _sound_tiers(document),
        files=files or schema.FilesSection(),
    ), problems


def _wrong(field: str, message: str, cure: str, value: object) -> Problem:
    """Problem of a key of scenario.toml."""
    return Problem(SCENARIO_FILE, message, cure, field=field, value=value)


def check_length(time: schema.TomlSection) -> list[Problem]:
    """A time grid too long, or too far away, to be meant."""
    if not 1970 <= time.start.year < 2200:
        message = "must lie in the years 1970 to 2199"
        return [_wrong("time.start", message, "Correct the year.", iso(time.start))]
    if minutes_to_h(time.step_minutes) * time.steps / 24 > schema.MAX_GRID_DAYS:
        message = f"the scenario is longer than {schema.MAX_GRID_DAYS} days"
        return [_wrong("time.steps", message, "Reduce steps or step_minutes.", time.steps)]
    return []


def check_voltages(network: schema.TomlSection) -> list[Problem]:
    """Voltage limits that contradict each other or exclude the slack bus."""
    problems = []
    v_slack_pu = network.v_slack_pu
    for low, high in (("v_min_pu", "v_max_pu"), ("v_min_ac_pu", "v_max_ac_pu")):
        lower, upper = getattr(network, low), getattr(network, high)
        if not lower < upper:
            message = f"must be less than {high} ({upper:g})"
            cure = "Correct one of the limits."
            problems.append(_wrong(f"network.{low}", message, cure, lower))
        elif not lower <= v_slack_pu <= upper:
            message = f"must lie between {low} ({lower:g}) and {high} ({upper:g})"
            cure = "Correct the voltage of the slack bus or the limits."
            problems.append(_wrong("network.v_slack_pu", message, cure, v_slack_pu))
    return problems


def check_outages(outages: list[schema.TomlSection], grid: TimeGrid) -> list[Problem]:
    """Outages that end before they begin, leave the day, or cut a step."""
    problems = []
    day = f"The day is {iso(grid.start)} to {iso(grid.end)}, in steps of {grid.step_minutes:g} min."
    for i, outage in enumerate(outages, start=1):
        if outage.end <= outage.start:
            message = f"must be after the outage's start ({iso(outage.start)})"
            cure = "Correct start or end."
            problems.append(_wrong(f"outages[{i}].end", message, cure, iso(outage.end)))
            continue
        for name, time in (("start", outage.start), ("end", outage.end)):
            if not grid.start <= time <= grid.end:
                message = "lies outside the scenario's day"
            elif (time - grid.start) % grid.step != pd.Timedelta(0):
                message = "lies inside a step"
            else:
                continue
            problems.append(_wrong(f"outages[{i}].{name}", message, day, iso(time)))
    return problems or _check_apart(outages)


def _check_apart(outages: list[schema.TomlSection]) -> list[Problem]:
    """Outages that begin before the one before them is over."""
    order = sorted(range(len(outages)), key=lambda i: outages[i].start)
    return [
        _wrong(
            f"outages[{after + 1}].start",
            f"begins before outages[{before + 1}] is over ({iso(outages[before].end)})",
            "Join the two outages, or correct one of them.",
            iso(outages[after].start),
        )
        for before, after in pairwise(order)
        if outages[after].start < outages[before].end
    ]


def _read_toml(path: Path) -> tuple[dict[str, Any], list[Problem]]:
    if not path.is_file():
        copy = path.parent / "scenario"
        cure = (
            f"This is a run folder: give its copy of the scenario, {path.parent.name}/{copy.name}."
            if (copy / path.name).is_file()
            else "A scenario folder needs it: see the page on the scenario format."
        )
        return {}, [no_file(path, cure)]
    if out := leads_out(path.parent, path.name):
        return {}, out
    text, problems = read_text(path, MAX_SETTINGS_BYTES)
    if problems:
        return {}, problems
    try:
        document = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        found = re.search(r"\(at line (\d+), column (\d+)\)", str(error))
        line = int(found[1]) if found else text.count("\n") + 1
        reason = str(error).split(" (at ")[0]
        return {}, [
            Problem(path.name, f"is not valid TOML: {reason}", "Correct this line.", row=line)
        ]
    if isinstance(source := document.get("source"), dict):
        source.pop("ties", None)  # of folders before switches.csv
    return document, []


def _sound(document: dict[str, Any], name: str, model: type[M]) -> M | None:
    """One section of a file whose other sections are wrong."""
    try:
        return model.model_validate(document.get(name, {}))
    except ValidationError:
        return None


def _sound_tiers(document: dict[str, Any]) -> dict[str, float] | None:
    """The names of the tiers, if there are any; their weights do not matter any more."""
    tiers = document.get("tiers")
    return dict.fromkeys(tiers, 1.0) if isinstance(tiers, dict) and tiers else None


def outage_intervals(scenario: Scenario) -> list[dict[str, Any]]:
    """Runs of outage steps as half-open intervals."""
    grid = scenario.grid
    times = [*grid.times, grid.end]
    return [
        {"start": times[a].to_pydatetime(), "end": times[b].to_pydatetime()}
        for a, b in spans_of(scenario.outage)
    ]
