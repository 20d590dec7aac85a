"""Positions of tap changers that pandapower does not regard, and what they would change.

pandapower 3 asks for the kind of a tap changer and its neutral position. Nets of before, and those
that other programs write, often have a position without them, which then has no effect.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.feeders.closeness import solve_source
from vppres.feeders.net.elements import in_service, label

TABLES = {"trafo": ("", "2"), "trafo3w": ("",)}
"""What the columns of the tap changers of each table have in their names."""


def told_idle_taps(net: Any, solved: bool) -> Iterator[str]:
    """Which positions off neutral have no effect, and by how much voltages move with them.

    ``net`` has the results of its power flow if it is ``solved``.
    """
    found = [
        (table, which, i, row)
        for table, changers in TABLES.items()
        for which in changers
        for i, row in _idle(net, table, which).iterrows()
    ]
    if not found:
        return
    names = [f"{label(net, table, i)} ({row['pos']:g})" for table, _, i, row in found]
    acting = copy.deepcopy(net)
    for table, which, i, row in found:
        for column in ("side", "neutral", "step_degree", "changer_type"):
            acting[table].loc[i, f"tap{which}_{column}"] = row[column]
    moved = ""
    if solved and solve_source(acting):
        apart = (acting.res_bus["vm_pu"] - net.res_bus["vm_pu"]).abs().max()
        moved = f" With them voltages move by up to {apart:.2g} pu."
    yield (
        "Tap positions have no effect in pandapower 3 without tap_side, tap_neutral and "
        "tap_changer_type (at a star point also tap_step_degree), and none here: "
        f"{named(names)}.{moved} Give these columns if the positions are real; tap_changer_type is "
        "Ratio for most transformers."
    )


def _idle(net: Any, table: str, which: str) -> pd.DataFrame:
    """Tap changers off neutral without effect, with what they need to have one."""
    rows = in_service(net, table)
    names = ("pos", "neutral", "min", "max", "step_percent", "step_degree")
    found = pd.DataFrame(
        {
            name: pd.to_numeric(rows.get(f"tap{which}_{name}", np.nan), errors="coerce")
            for name in names
        },
        rows.index,
        dtype=float,
    )
    sides = ("hv", "lv") if table == "trafo" else ("hv", "mv", "lv")
    side = _texts(rows, f"tap{which}_side")
    middle = (found["min"] + found["max"]) / 2.0
    neutral = found["neutral"].fillna(middle).fillna(0.0)
    by_percent, by_degree = (
        found[f"step_{unit}"].fillna(0.0) != 0 for unit in ("percent", "degree")
    )
    off = (by_percent | by_degree) & (found["pos"] - neutral).fillna(0.0).ne(0.0)
    known = side.isin(sides) & found["neutral"].notna()
    if f"tap{which}_changer_type" in rows or f"tap{which}_phase_shifter" not in rows:
        # Nets of pandapower 2 have the column of phase shifters instead.
        known &= _texts(rows, f"tap{which}_changer_type").isin(("Ratio", "Symmetrical", "Ideal"))
    known &= ~(_flags(rows, "tap_at_star_point") & found["step_degree"].isna())
    idle = off & ~known & ~_flags(rows, "tap_dependency_table")
    return found.assign(
        neutral=neutral,
        side=side.where(side.isin(sides), "hv"),
        step_degree=found["step_degree"].fillna(0.0),
        changer_type=np.where(by_degree & ~by_percent, "Ideal", "Ratio"),
    )[idle]


def _flags(rows: pd.DataFrame, column: str) -> pd.Series[bool]:
    return rows.get(column, pd.Series(False, rows.index)).fillna(False).astype(bool)


def _texts(rows: pd.DataFrame, column: str) -> pd.Series[str]:
    return rows.get(column, pd.Series("", rows.index)).fillna("").astype(str)
