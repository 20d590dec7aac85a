"""Rows of ``gensets.csv`` and ``refuel.csv``: what is wrong with them; both tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import Problem
from vppres.io import schema
from vppres.io.times import iso
from vppres.scenario.gensets import Gensets, Refuels
from vppres.scenario.network import BusId

Rows = Mapping[int, schema.Row]

LIMITS = (("p_min_kw", "p_max_kw"), ("fuel_level_litres", "tank_litres"))
"""Columns that must not exceed another one."""

FLAGS = ("only_in_outage", "grid_forming")

RAMPS = ("ramp_up_kw_per_h", "ramp_down_kw_per_h")


def check_gensets(file: str, rows: Rows) -> list[Problem]:
    """Sets with a value above its limit."""
    return [
        Problem(
            file,
            f"must not exceed {most} ({getattr(genset, most):g})",
            "Correct one of the two.",
            row=row,
            field=name,
            value=getattr(genset, name),
        )
        for row, genset in rows.items()
        for name, most in LIMITS
        if getattr(genset, name) is not None and getattr(genset, name) > getattr(genset, most)
    ]


def gensets_of(rows: Rows, read_bus: Callable[[str], BusId]) -> Gensets:
    """The sets of sound rows: a full tank, no ramps, and off for long, where nothing is said."""
    columns: dict[str, Any] = {
        name: [getattr(row, name) for row in rows.values()]
        for name in schema.GensetRow.model_fields
    }
    columns["bus"] = [read_bus(bus) for bus in columns["bus"]]
    for name in FLAGS:
        columns[name] = [value == "yes" for value in columns[name]]
    unsaid = {
        **{name: np.full(len(rows), np.inf) for name in RAMPS},
        "fuel_level_litres": columns["tank_litres"],
        "on_before_h": [-hours for hours in columns["min_off_h"]],
    }
    for name, values in unsaid.items():
        columns[name] = [
            other if value is None else value
            for value, other in zip(columns[name], values, strict=True)
        ]
    return Gensets(**columns)


def refuels_of(rows: Rows) -> Refuels:
    """The deliveries of sound rows."""
    columns: dict[str, Any] = {
        name: [getattr(row, name) for row in rows.values()]
        for name in schema.RefuelRow.model_fields
    }
    columns["time"] = [pd.Timestamp(time) for time in columns["time"]]
    return Refuels(**columns)


def genset_frames(sets: Gensets, refuels: Refuels) -> dict[str, pd.DataFrame]:
    """Both tables as they are written; none without a set, or a delivery."""
    if not len(sets):
        return {}
    told = {name: getattr(sets, name) for name in schema.GensetRow.model_fields}
    told |= {name: np.where(np.isinf(told[name]), np.nan, told[name]) for name in RAMPS}
    told |= {name: np.where(told[name], "yes", "no") for name in FLAGS}
    if not sets.grid_forming.any():  # a folder without the duty stays what it was
        del told["grid_forming"], told["power_factor"]
    frames = {"gensets": pd.DataFrame(told).dropna(axis="columns", how="all")}
    if len(refuels):
        times = [iso(time) for time in refuels.time]
        columns = {"genset": refuels.genset, "time": times, "litres": refuels.litres}
        frames["refuel"] = pd.DataFrame(columns)
    return frames
