"""The 69-bus feeder of Baran and Wu as a pandapower net."""

from __future__ import annotations

from importlib import resources
from typing import Any

import pandas as pd

from vppres.core.units import kw_to_mw

BASE_KV = 12.66
NO_LIMIT_KA = 99999.0  # the source has no ratings


def case69() -> Any:
    """The net, its buses numbered from 1 as published; the file names its source."""
    import pandapower as pp

    file = resources.files("vppres").joinpath("feeders/data/case69.csv")
    table = pd.read_csv(str(file), comment="#")
    net = pp.create_empty_network(name="case69")
    pp.create_buses(net, 69, vn_kv=BASE_KV, index=range(1, 70))
    pp.create_ext_grid(net, 1)
    pp.create_lines_from_parameters(
        net,
        table["from_bus"],
        table["to_bus"],
        length_km=1.0,
        r_ohm_per_km=table["r_ohm"],
        x_ohm_per_km=table["x_ohm"],
        c_nf_per_km=0.0,
        max_i_ka=NO_LIMIT_KA,
    )
    loaded = table[table["p_kw"] > 0]
    pp.create_loads(
        net, loaded["to_bus"], p_mw=kw_to_mw(loaded["p_kw"]), q_mvar=kw_to_mw(loaded["q_kvar"])
    )
    return net
