"""Published feeders as pandapower nets; each file of data names its source."""

from __future__ import annotations

from importlib import resources
from typing import Any

import pandas as pd

from vppres.core.units import kw_to_mw

NO_LIMIT_KA = 99999.0  # the sources have no ratings


def case16() -> Any:
    """The 16 buses with three sources of Civanlar, Grainger, Yin and Lee, numbered from 1."""
    kv, base_mva = 23.0, 100.0
    table = _table("case16")
    table["r_ohm"], table["x_ohm"] = (table[part] * kv**2 / base_mva for part in ("r_pu", "x_pu"))
    return _net("case16", kv, 16, (1, 2, 3), table)


def case69() -> Any:
    """The 69 buses of Baran and Wu, numbered from 1, with the ties of later studies."""
    lines = [_table("case69").assign(closed=1), _table("case69_ties")]
    return _net("case69", 12.66, 69, (1,), pd.concat(lines, ignore_index=True))


def _table(name: str) -> pd.DataFrame:
    """Lines, with the load at the end of each."""
    file = resources.files("vppres").joinpath(f"feeders/data/{name}.csv")
    return pd.read_csv(str(file), comment="#")


def _net(name: str, kv: float, n_buses: int, sources: tuple[int, ...], table: pd.DataFrame) -> Any:
    """The net of a table of lines."""
    import pandapower as pp

    net = pp.create_empty_network(name=name)
    pp.create_buses(net, n_buses, vn_kv=kv, index=range(1, n_buses + 1))
    for bus in sources:
        pp.create_ext_grid(net, bus)
    pp.create_lines_from_parameters(
        net,
        table["from_bus"],
        table["to_bus"],
        length_km=1.0,
        r_ohm_per_km=table["r_ohm"],
        x_ohm_per_km=table["x_ohm"],
        c_nf_per_km=0.0,
        max_i_ka=NO_LIMIT_KA,
        in_service=table["closed"] > 0,
    )
    loaded = table[table["p_kw"] > 0]
    pp.create_loads(
        net, loaded["to_bus"], p_mw=kw_to_mw(loaded["p_kw"]), q_mvar=kw_to_mw(loaded["q_kvar"])
    )
    return net
