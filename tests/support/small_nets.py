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


def ring() -> pp.pandapowerNet:
    """The net of :func:`_ring`, to be changed as one likes."""
    return deepcopy(_ring())


@cache
def _ring() -> pp.pandapowerNet:
    """A substation at bus 0 and a ring of 1, 2 and 3, open between 2 and 3 at the end of a line."""
    net = pp.create_empty_network(name="ring")
    pp.create_buses(net, 4, vn_kv=10.0)
    pp.create_ext_grid(net, 0)
    for start, end, name in ((0, 1, "feeder"), (1, 2, "east"), (1, 3, "west"), (2, 3, "link")):
        pp.create_line_from_parameters(net, start, end, 2.0, 0.2, 0.1, 0.0, 0.3, name=name)
    for bus in (1, 2, 3):
        pp.create_load(net, bus, 0.3, 0.1)
    pp.create_switch(net, 0, 0, "l", True, "CB", name="CB 1")
    pp.create_switch(net, 1, 1, "l", True, "LBS")
    pp.create_switch(net, 2, 1, "l", True, "LBS")
    pp.create_switch(net, 3, 3, "l", False, "LBS", name="normally open")
    return net
