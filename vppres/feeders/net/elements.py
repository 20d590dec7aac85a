"""Elements of a pandapower net by table: which are in service, and their names in messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pandas as pd

from vppres.core.arrays import Complexes, Floats

JOINT = "joint"
"""Type of switches that stand for something else: no one can open them."""

TIER_COLUMNS = ("tier", "priority")
"""Columns of loads that may name their tiers, in any case of letters; the first that is there."""


@dataclass(frozen=True, eq=False)
class NetCase:
    """pandapower's internal case: supplied buses and branches in service, in pu.

    ``bus_at`` gives the row of ``bus_kv`` for each supplied bus of the source; ``branches`` has the
    columns of :mod:`vppres.feeders.net.branches`, and ``table`` and ``element`` of the source;
    ``shunts`` are the admittances of the rows.
    """

    base_mva: float
    bus_kv: Floats
    bus_at: dict[int, int]
    branches: pd.DataFrame
    slack: int
    v_slack_pu: float
    shunts: Complexes


def in_service(net: Any, table: str) -> pd.DataFrame:
    """Elements of a table that are in service."""
    frame: pd.DataFrame = net[table]
    return frame[frame["in_service"].astype(bool)] if "in_service" in frame else frame


def supplied(net: Any, table: str, case: NetCase) -> pd.DataFrame:
    """Elements in service at supplied buses, with the row of their bus as ``row``."""
    frame = in_service(net, table)
    frame = frame[frame["bus"].isin([*case.bus_at])]
    return frame.assign(row=frame["bus"].map(case.bus_at).astype(int))


def label(net: Any, table: str, index: Any) -> str:
    """An element by table and index, with its name if it has one."""
    name = net[table]["name"].at[index] if "name" in net[table] else None
    return f"{table} {index}" + (f" ({name})" if isinstance(name, str) and name else "")


def tier_column(loads: pd.DataFrame) -> Any:
    """The column that names tiers; None if there is none."""
    names = {str(name).strip().lower(): name for name in reversed(loads.columns)}
    return next((names[word] for word in TIER_COLUMNS if word in names), None)


def tiers_of(loads: pd.DataFrame) -> list[str]:
    """The tier that each load names; empty for none."""
    column = tier_column(loads)
    given = [None] * len(loads) if column is None else loads[column]
    return ["" if pd.isna(value) else str(value).strip() for value in given]
