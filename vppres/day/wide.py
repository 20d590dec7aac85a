"""Tables of a run by time: a row for each step, a column for each item."""

from __future__ import annotations

from typing import Any, NoReturn

import numpy as np
import pandas as pd

from vppres.core.errors import InputError
from vppres.core.text import named
from vppres.kinds.table import KINDS

NAMED_BY = {
    "buses": ["bus"],
    "lines": ["from_bus", "to_bus"],
    "nodes": ["bus", "phase"],
    **{kind.table: [kind.item] for kind in KINDS.values()},
}
"""Columns that name the items of a table, where it is not ``id``."""

SOC = "soc"
"""The state of charge: ``soc_start`` and, at the end of the last step, ``soc_end``."""


class Wide:
    """Columns of a run's tables by time: ``run.t.served``, ``run.t.v_ac_pu``, ``run.t.soc``.

    Rows are the beginnings of steps; ``soc`` has one more, the end of the last step. A column that
    several tables have is asked for with its table: ``run.t.of("gensets", "p_kw")``.
    """

    def __init__(self, tables: dict[str, pd.DataFrame], end: pd.Timestamp) -> None:
        known = {"customers", "pv", "batteries", *NAMED_BY}
        self._tables = {name: table for name, table in tables.items() if name in known}
        self._end = end

    def of(self, table: str, column: str) -> pd.DataFrame:
        """A column of a table by time."""
        if column not in self._columns(table):
            self._refuse(f"{table}.{column}")
        frame = self._tables[table]
        times = pd.DatetimeIndex(frame["time"].unique(), name="time")
        names = frame[_names(table)].iloc[: len(frame) // max(len(times), 1)]
        if names.shape[1] == 1:
            columns = pd.Index(names.iloc[:, 0], name=names.columns[0])
        else:
            columns = pd.MultiIndex.from_frame(names)
        values = frame[column].to_numpy().reshape(len(times), -1)
        return pd.DataFrame(values, index=times, columns=columns)

    def _soc(self) -> pd.DataFrame:
        start, end = (self.of("batteries", name) for name in ("soc_start", "soc_end"))
        times = pd.DatetimeIndex([*start.index, self._end], name="time")
        values = np.vstack([start, end.tail(1)])
        return pd.DataFrame(values, index=times, columns=start.columns)

    def _columns(self, table: str) -> list[str]:
        """Columns of a table that have values of its items."""
        frame = self._tables.get(table, pd.DataFrame())
        return [str(name) for name in frame if name not in ("time", *_names(table))]

    def _homes(self) -> dict[str, list[str]]:
        """Every column, and which tables have it."""
        found: dict[str, list[str]] = {}
        for table in self._tables:
            for column in self._columns(table):
                found.setdefault(column, []).append(table)
        return found

    def __dir__(self) -> list[str]:
        alone = [column for column, homes in self._homes().items() if len(homes) == 1]
        return sorted({"of", SOC, *alone})

    def __getattr__(self, name: str) -> pd.DataFrame:
        if name.startswith("_"):
            raise AttributeError(name)
        if name == SOC:
            return self._soc()
        homes = self._homes().get(name, [])
        if len(homes) != 1:
            self._refuse(name, homes)
        return self.of(homes[0], name)

    def _refuse(self, name: str, homes: list[str] | None = None) -> NoReturn:
        cure = f'Write run.t.of("{homes[0]}", "{name}").' if homes else "dir(run.t) has all names."
        message = f"is a column of {named(homes)}" if homes else "is no column of this run"
        raise _Unknown.of("run.t", message, cure, field=name)


class _Unknown(InputError, AttributeError):
    """An attribute that is not there, as Python expects it."""


def _names(table: str) -> list[Any]:
    return NAMED_BY.get(table, ["id"])
