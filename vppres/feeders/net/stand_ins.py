"""Elements of a pandapower net that stand for others with the same equations, and which they are.

A generator that draws power is a load, so that a customer owns its demand. A branch without
impedance is a closed switch, as no power flow can divide by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.core.units import kw_to_mw, mw_to_kw, us_to_kw_at_1_pu
from vppres.feeders.net.balance import PHASES
from vppres.feeders.net.elements import JOINT, in_service, label

NS_TO_US = 1e-3
"""Capacitances are in nF; times an angular frequency they are nS."""


def stand_ins(net: Any) -> Iterator[str]:
    """Replace elements in place, and say which."""
    drawing = [*_drawing(net, "sgen"), *_drawing(net, "gen"), *_drawing_by_phase(net)]
    if drawing:
        yield f"Generators that draw power are loads: {named(drawing)}."
    joined = [*_without_impedance(net)]
    if joined:
        yield (
            "Branches without impedance are closed switches, also in the power flow of the source, "
            f"which cannot divide by them: {named(joined)}."
        )


def _drawing(net: Any, table: str) -> Iterator[str]:
    """Generators with a negative power, and none that they could give."""
    import pandapower as pp

    rows = in_service(net, table)
    most_mw = pd.to_numeric(rows.get("max_p_mw", pd.Series(np.nan, rows.index)), errors="coerce")
    drawing = (rows["p_mw"] * rows["scaling"] < 0) & ~(most_mw > 0)
    for i, row in rows[drawing].iterrows():
        words = label(net, table, i)
        # One that holds its voltage goes on to do so, with reactive power only.
        q_mvar = 0.0 if table == "gen" else -float(row["q_mvar"])
        p_mw, scaling = -float(row["p_mw"]), float(row["scaling"])
        bus, name = int(row["bus"]), _name(row, words)
        pp.create_load(net, bus, p_mw, q_mvar, scaling=scaling, name=name)
        if table == "gen":
            net.gen.loc[i, "p_mw"] = 0.0
        else:
            net.sgen.loc[i, "in_service"] = False
        yield f"{words}, {mw_to_kw(p_mw * scaling):,.6g} kW"


def _drawing_by_phase(net: Any) -> Iterator[str]:
    """Phases of generators that draw power; others of the same generator go on to give."""
    import pandapower as pp

    table = "asymmetric_sgen"
    rows = in_service(net, table) if table in net else pd.DataFrame()
    for i, row in rows.iterrows():
        drawn = [phase for phase in PHASES if row[f"p_{phase}_mw"] * row["scaling"] < 0]
        if not drawn:
            continue
        words = label(net, table, i)
        columns = [f"{power}_{phase}_{unit}" for phase in drawn for power, unit in _POWERS]
        pp.create_asymmetric_load(
            net,
            int(row["bus"]),
            **{column: -float(row[column]) for column in columns},
            scaling=float(row["scaling"]),
            type=row["type"] if row["type"] == "delta" else "wye",
            name=_name(row, words),
        )
        net[table].loc[i, columns] = 0.0
        p_mw = sum(-float(row[f"p_{phase}_mw"]) for phase in drawn) * float(row["scaling"])
        yield f"{words}, {mw_to_kw(p_mw):,.6g} kW"


_POWERS = (("p", "mw"), ("q", "mvar"))


def _name(row: pd.Series[Any], words: str) -> str:
    """The element's own name, or what stands for it."""
    return row["name"] if isinstance(row["name"], str) and row["name"] else words


def _without_impedance(net: Any) -> Iterator[str]:
    """Lines of no impedance between buses in service; what they charge becomes a shunt."""
    import pandapower as pp

    lines = in_service(net, "line")
    z_ohm = np.hypot(lines["r_ohm_per_km"], lines["x_ohm_per_km"]) * lines["length_km"]
    switches = net.switch
    opened = set(switches["element"][(switches["et"] == "l") & ~switches["closed"].astype(bool)])
    for i, row in lines[z_ohm == 0].iterrows():
        yield label(net, "line", i)
        net.line.loc[i, "in_service"] = False
        start, end = int(row["from_bus"]), int(row["to_bus"])
        if i not in opened:
            pp.create_switch(net, start, end, et="b", closed=True, type=JOINT)
        kv, size = float(net.bus.at[start, "vn_kv"]), float(row["length_km"] * row["parallel"])
        b_us = NS_TO_US * 2 * np.pi * float(net.f_hz) * float(row["c_nf_per_km"]) * size
        g_us = np.nan_to_num(float(row.get("g_us_per_km", 0.0))) * size
        if b_us or g_us:
            q_mvar, p_mw = (float(kw_to_mw(us_to_kw_at_1_pu(y, kv))) for y in (-b_us, g_us))
            pp.create_shunt(net, start, q_mvar=q_mvar, p_mw=p_mw, name=f"charging of line {i}")
