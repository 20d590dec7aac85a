"""Series that come with a source: SimBench's year, and pandapower's controllers of constants."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import InputError
from vppres.core.units import KW_PER_MW
from vppres.feeders.feeder import Profile
from vppres.feeders.net.elements import in_service, label
from vppres.feeders.series.clocks import in_utc

SIMBENCH_ZONE = "Europe/Berlin"
"""SimBench's times are those of clocks in Germany: an hour in March is missing, one comes twice."""

_SIMBENCH = (
    ("load", "load", "_pload"),
    ("sgen", "renewables", ""),
    ("sgen", "powerplants", ""),
    ("gen", "powerplants", ""),
    ("storage", "storage", ""),
)
"""Table of elements, table of profiles, and what follows the profile's name in a column."""

_TABLES = ("load", "sgen", "gen", "storage")
# Milliseconds since 1970 in JSON; a row's number is smaller by far.
_LEAST_EPOCH_MS = 10**11


@dataclass(frozen=True, eq=False)
class Control:
    """A ConstControl: which elements follow which columns of a table."""

    element: str
    variable: str
    elements: tuple[int, ...]
    columns: tuple[Any, ...]
    factor: float
    frame: pd.DataFrame


def profiles_of(net: Any) -> tuple[Profile, ...]:
    """Series of a net: SimBench's if it has them, else those of its controllers."""
    tables = net.get("profiles")
    if isinstance(tables, Mapping) and any("time" in table for table in tables.values()):
        return simbench_profiles(net)
    return control_profiles(net, controls_of(net))


def simbench_profiles(net: Any) -> tuple[Profile, ...]:
    """The year of every element that has a profile."""
    profiles: list[Profile] = []
    for table, kind, suffix in _SIMBENCH:
        year = net.profiles.get(kind)
        if year is None or year.shape[1] < 2 or "profile" not in net[table]:
            continue
        clock = pd.DatetimeIndex(pd.to_datetime(year["time"], format="%d.%m.%Y %H:%M"))
        times, problems = in_utc(clock, SIMBENCH_ZONE, f"SimBench {kind}")
        if problems:
            raise InputError(problems)
        shapes = {
            str(name): pd.Series(year[name].to_numpy(float), times) for name in year.columns[1:]
        }
        for i, row in in_service(net, table).iterrows():
            shape = shapes.get(f"{row['profile']}{suffix}")
            if shape is not None:
                factor = float(net[table]["p_mw"].at[i]) * _scaling(net, table, i) * KW_PER_MW
                profiles.append(Profile("SimBench", label(net, table, i), shape, "kw", factor))
    return tuple(profiles)


def controls_of(net: Any) -> Iterator[Control]:
    """Controllers of constants in a net, with the data that they follow."""
    table = net.get("controller")
    if table is None or "object" not in table:
        return
    for control, acting in zip(table["object"], table["in_service"], strict=True):
        frame = getattr(getattr(control, "data_source", None), "df", None)
        if acting and type(control).__name__ == "ConstControl" and frame is not None:
            yield Control(
                control.element,
                control.variable,
                tuple(int(i) for i in np.atleast_1d(control.element_index)),
                tuple(np.atleast_1d(np.array(control.profile_name, dtype=object))),
                float(control.scale_factor),
                pd.DataFrame(frame),
            )


def controls_in_json(objects: Iterable[Mapping[str, Any]]) -> Iterator[Control]:
    """Controls from the texts of a file, of which only numbers and names are built."""
    for value in objects:
        content = _parsed(value.get("_object"))
        source = _parsed(_parsed(content.get("data_source")).get("_object"))
        frame = _frame(_parsed(source.get("df")))
        try:
            yield Control(
                str(content["element"]),
                str(content["variable"]),
                tuple(int(i) for i in _several(content["element_index"])),
                tuple(_several(content["profile_name"])),
                float(content.get("scale_factor", 1.0)),
                frame,
            )
        except (KeyError, TypeError, ValueError):
            continue  # another program's controller: what it controls keeps its constant


def control_profiles(net: Any, controls: Iterable[Control]) -> tuple[Profile, ...]:
    """Active powers that controllers of constants write, and scalings of it."""
    profiles: list[Profile] = []
    for control in controls:
        if control.element not in _TABLES or len(control.elements) != len(control.columns):
            continue
        for i, column in zip(control.elements, control.columns, strict=True):
            if i not in in_service(net, control.element).index or column not in control.frame:
                continue
            values = pd.to_numeric(control.frame[column], errors="coerce")
            series = pd.Series(values.to_numpy(float), _index(control.frame.index))
            name = label(net, control.element, i)
            if control.variable == "p_mw":
                factor = control.factor * _scaling(net, control.element, i)
                profiles.append(Profile("ConstControl", name, series, "mw", factor))
            elif control.variable == "scaling":
                p_kw = float(net[control.element]["p_mw"].at[i]) * KW_PER_MW
                profiles.append(Profile("ConstControl", name, series, "kw", control.factor * p_kw))
    return tuple(profiles)


def _scaling(net: Any, table: str, index: Any) -> float:
    scaling = net[table]["scaling"].at[index] if "scaling" in net[table] else 1.0
    return 1.0 if pd.isna(scaling) else float(scaling)


def _index(index: pd.Index) -> pd.Index:
    """Times of a table; those that JSON turned into milliseconds are clock times again."""
    numbers = pd.api.types.is_integer_dtype(index.dtype)
    if numbers and len(index) and index.min() > _LEAST_EPOCH_MS:
        return pd.DatetimeIndex(pd.to_datetime(index, unit="ms"))
    return index


def _parsed(value: Any) -> dict[str, Any]:
    """An object of JSON, also if it is written as a text; empty if it is none."""
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except (ValueError, RecursionError):
            return {}
    return value if isinstance(value, dict) else {}


def _frame(value: Mapping[str, Any]) -> pd.DataFrame:
    """A table of numbers that is written as columns, index and data; empty if it is another."""
    content = _parsed(value.get("_object"))
    try:
        return pd.DataFrame(content["data"], index=content["index"], columns=content["columns"])
    except (KeyError, TypeError, ValueError):
        return pd.DataFrame()


def _several(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]
