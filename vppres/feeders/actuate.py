"""Set-points back into a pandapower net."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.core.units import kw_to_mw
from vppres.feeders.elements import in_service
from vppres.scenario.network import BusId


def write_set_points(
    net: Any,
    bus_of: Mapping[int, BusId],
    customers: pd.DataFrame,
    pv: pd.DataFrame,
    batteries: pd.DataFrame,
) -> None:
    """Write the set-points of a step into a net, in place; a second call replaces the first.

    Parameters
    ----------
    net : pandapowerNet
        The net.
    bus_of : mapping
        Bus of the scenario for every bus of the net.
    customers, pv, batteries : DataFrame
        By identifier, as :class:`vppres.live.controller.SetPoints` has them: powers in kW and
        kvar; the loads of a customer are scaled to its demand, and to 0 if it is off.

    Raises
    ------
    InputError
        If a bus of the set-points is not in the net, or a customer has no load there.
    """
    bus_in_net = {bus: source for source, bus in reversed([*bus_of.items()])}
    items = pd.concat([table["bus"] for table in (customers, pv, batteries)])
    problems = [
        Problem(
            "set-points",
            "is not a bus of the net",
            "Give the net and the feeder that the scenario was made from.",
            field=f"bus of {name}",
            value=bus,
        )
        for name, bus in items.items()
        if bus not in bus_in_net
    ]
    scaling, found = _load_scaling(net, bus_of, customers)
    problems += found
    if problems:
        raise InputError(problems)
    net.load.loc[scaling.index, "scaling"] = scaling
    _replace_own_pv(net, bus_of, pv)
    for name, row in pv.iterrows():
        _write(net, "sgen", str(name), bus_in_net[row["bus"]], row["p_kw"], row["q_kvar"])
    for name, row in batteries.iterrows():
        # A storage counts consumption as positive, reactive power too.
        _write(net, "storage", str(name), bus_in_net[row["bus"]], row["p_kw"], -row["q_kvar"])


def _load_scaling(
    net: Any, bus_of: Mapping[int, BusId], customers: pd.DataFrame
) -> tuple[pd.Series[float], list[Problem]]:
    """Scaling of the loads at the customers' buses, so that each bus has its demand."""
    loads = in_service(net, "load")
    bus = loads["bus"].map(bus_of)
    peak_mw = loads["p_mw"].groupby(bus).sum()
    without = customers[~customers["bus"].isin(peak_mw.index[peak_mw > 0])]
    problems = [
        Problem(
            "set-points",
            "the net has no load at this bus",
            "Give the net that the scenario was made from.",
            field=f"bus of {name}",
            value=bus,
        )
        for name, bus in without["bus"].items()
    ]
    demand_mw = (
        (kw_to_mw(customers["load_kw"]) * customers["served"]).groupby(customers["bus"]).sum()
    )
    ratio = demand_mw / peak_mw
    return bus[bus.isin(customers["bus"])].map(ratio).astype(float), problems


def _replace_own_pv(net: Any, bus_of: Mapping[int, BusId], pv: pd.DataFrame) -> None:
    """Take the source's PV out of service where the scenario has a PV system in its place."""
    own = net.sgen["type"].fillna("").astype(str).str.upper().str.startswith("PV")
    taken = net.sgen["bus"].map(bus_of).isin(pv["bus"]) & ~net.sgen["name"].isin(pv.index)
    net.sgen.loc[own & taken, "in_service"] = False


def _write(net: Any, table: str, name: str, bus: int, p_kw: float, q_kvar: float) -> None:
    """Power of the element of that name; it is made if there is none."""
    import pandapower as pp

    p_mw = float(kw_to_mw(p_kw))
    q_mvar = float(kw_to_mw(q_kvar))
    found = np.flatnonzero(net[table]["name"] == name)
    if len(found):
        net[table].loc[net[table].index[found[0]], ["p_mw", "q_mvar"]] = p_mw, q_mvar
    elif table == "sgen":
        pp.create_sgen(net, bus, p_mw=p_mw, q_mvar=q_mvar, name=name, type="PV")
    else:
        pp.create_storage(net, bus, p_mw=p_mw, q_mvar=q_mvar, max_e_mwh=np.nan, name=name)
