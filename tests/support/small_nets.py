"""Small pandapower nets. They are built once and copied: pandapower takes long to build one."""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from typing import Any

import pandapower as pp
import pandas as pd

LINE = {"r_ohm_per_km": 0.3, "x_ohm_per_km": 0.2, "c_nf_per_km": 0.0, "max_i_ka": 1.0}


@cache
def _built(count: int, vn_kv: float, length_km: float) -> Any:
    net = pp.create_empty_network()
    pp.create_buses(net, count, vn_kv=vn_kv)
    pp.create_ext_grid(net, 0)
    for bus in range(count - 1):
        pp.create_line_from_parameters(net, bus, bus + 1, length_km=length_km, **LINE)
    return net


def buses_in_a_row(count: int, vn_kv: float, length_km: float = 1.0) -> Any:
    """Buses one behind the other, the first with the grid; to be changed as one likes."""
    return deepcopy(_built(count, vn_kv, length_km))


def empty_tables_are_copied() -> None:
    """Let pandapower build the empty tables of a net once, which takes it 0.3 s, and copy them."""
    net = pp.pandapowerNet
    build = net.create_dataframes

    @cache
    def built(columns: tuple[tuple[str, Any], ...]) -> pd.DataFrame:
        found: pd.DataFrame = build({"": dict(columns)})[""]
        return found

    def create_dataframes(tables: dict[str, Any]) -> dict[str, Any]:
        for name, columns in tables.items():
            if isinstance(columns, dict):
                tables[name] = built(tuple(columns.items())).copy()
        return tables

    net.create_dataframes = staticmethod(create_dataframes)
