"""Rows of ``thermal_loads.csv``: what is wrong with them; the table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import Problem
from vppres.io import schema
from vppres.scenario.thermal_loads import ThermalLoads

Rows = Mapping[int, schema.Row]


def check_thermal_loads(file: str, rows: Rows) -> list[Problem]:
    """Comfort bands of which the lower end is not below the upper."""
    return [
        Problem(
            file,
            f"is not below t_max_c ({load.t_max_c:g})",
            "Correct one end of the comfort band.",
            row=row,
            field="t_min_c",
            value=load.t_min_c,
        )
        for row, load in rows.items()
        if not load.t_min_c < load.t_max_c
    ]


def thermal_loads_of(rows: Rows) -> ThermalLoads:
    """The thermal loads of sound rows."""
    columns: dict[str, Any] = {
        name: [getattr(row, name) for row in rows.values()]
        for name in schema.ThermalLoadRow.model_fields
    }
    columns["heats"] = [heats == "yes" for heats in columns["heats"]]
    columns["around_c"] = [np.nan if c is None else c for c in columns["around_c"]]
    return ThermalLoads(**columns)


def thermal_load_frames(loads: ThermalLoads) -> dict[str, pd.DataFrame]:
    """The table as it is written; none without a load."""
    if not len(loads):
        return {}
    told = {name: getattr(loads, name) for name in schema.ThermalLoadRow.model_fields}
    told["heats"] = np.where(loads.heats, "yes", "no")
    return {"thermal_loads": pd.DataFrame(told).dropna(axis="columns", how="all")}
