"""Thermal ratings of the branches of a pandapower net, and of what a reduction makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from vppres.feeders.net.elements import in_service, label

# Sources without ratings write a current or a power that nothing carries.
NO_LIMIT_KA = 9999.0
NO_LIMIT_MVA = 99999.0


def rating_mva(net: Any, table: str, index: Any) -> float:
    """Largest apparent power of a branch at nominal voltage; infinite where none is known.

    Lines by ``max_i_ka`` and transformers with two windings by ``sn_mva``, both with their
    derating ``df``; a rating of zero is none. Windings of larger transformers and impedances count
    as unlimited.
    """
    if table not in ("line", "trafo"):
        return np.inf
    row = net[table].loc[index]
    units = float(row.get("parallel", 1.0)) * float(row.get("df", 1.0))
    if not units > 0:
        return np.inf
    if table == "trafo":
        return float(row["sn_mva"]) * units if row["sn_mva"] < NO_LIMIT_MVA else np.inf
    if not 0 < float(row["max_i_ka"]) < NO_LIMIT_KA:
        return np.inf
    return float(np.sqrt(3.0) * net.bus.at[row["from_bus"], "vn_kv"] * row["max_i_ka"]) * units


def without_rating(net: Any) -> Iterator[str]:
    """Lines and transformers with a rating of zero, or of none: nothing would ever carry power."""
    for table, column in (("line", "max_i_ka"), ("trafo", "df")):
        rows = in_service(net, table)
        rated = pd.Series(True, rows.index)
        for name in {column, "df"} & {*rows.columns}:
            rated &= pd.to_numeric(rows[name], errors="coerce") > 0
        yield from (label(net, table, i) for i in rows.index[~rated])
