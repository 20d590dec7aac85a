"""Rows of a table as columns of assets, and columns of assets as the table that is written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
import pandas as pd
from pydantic import BaseModel

from vppres.core.text import iso
from vppres.io import schema
from vppres.scenario.network import BusId

Rows = Mapping[int, schema.Row]
"""Sound rows by line of the file."""

BUSES = ("bus", "from_bus", "to_bus")
ALWAYS = ("soc_initial", "t_initial_c")
"""Columns that are written though every cell of them is empty."""


def columns_of(
    rows: Rows, model: type[BaseModel], read_bus: Callable[[str], BusId] = str
) -> dict[str, Any]:
    """One list for each attribute of some rows.

    Yes and no are flags, buses are read and None where there is none; numbers that are not given
    are NaN.
    """
    columns: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        cells = [getattr(row, name) for row in rows.values()]
        if field.annotation == schema.YES_OR_NO:
            cells = [cell == "yes" for cell in cells]
        elif name in BUSES:
            cells = [read_bus(cell) if cell else None for cell in cells]
        columns[name] = [np.nan if cell is None and name not in BUSES else cell for cell in cells]
    return columns


def frame_of(assets: Any, model: type[BaseModel], unsaid: Collection[str] = ()) -> pd.DataFrame:
    """A table as it is written: of arrays by attribute, or of objects with the attributes of a row.

    Columns are left out that are empty, and those of ``unsaid`` where every row has the default.
    """
    fields = model.model_fields
    if isinstance(assets, tuple):
        told = {name: [getattr(each, name) for each in assets] for name in fields}
    else:
        told = {name: getattr(assets, name) for name in fields}
    first = next(iter(told.values()))
    columns = {name: _cells(each) for name, each in told.items() if len(each) == len(first)}
    frame = pd.DataFrame(columns)
    for name in columns:
        default = fields[name].default
        empty = default is None and name not in ALWAYS
        cells = frame[name]
        by_default = (cells.isna() | (cells == default) | (cells == "")).all()
        if (empty or name in unsaid) and by_default:
            frame = frame.drop(columns=name)
    return frame


def _cells(values: Any) -> Any:
    """Values as files have them: yes and no, times with their offset, no limit empty."""
    array = np.asarray(values)
    if array.dtype == bool:
        return np.where(array, "yes", "no")
    if array.dtype.kind == "f":
        return np.where(np.isinf(array), np.nan, array)
    cells = [iso(each) if isinstance(each, pd.Timestamp) else each for each in values]
    return pd.Series(cells, dtype=array.dtype)
