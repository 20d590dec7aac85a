"""Normally open points of a pandapower net: lines and bus switches that could close a loop."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from vppres.core.units import kva_to_a, mw_to_kw
from vppres.feeders.net.elements import NetCase
from vppres.feeders.net.names import identifiers
from vppres.feeders.net.ratings import rating_mva
from vppres.feeders.ties import Ties
from vppres.io.schema import MIN_OHM
from vppres.scenario.network import BusId, Network


def ties_of(net: Any, case: NetCase, ids: Mapping[int, BusId], network: Network) -> Ties:
    """Lines and bus switches between two supplied buses that are open or out of service.

    Impedances refer to the network's voltage. Charging of an open line is left out, and stays so
    if it is closed.
    """
    found = [*_lines(net, network), *_bus_switches(net)]
    rows = []
    for name, buses, r_ohm, x_ohm, i_max_a in found:
        start, end = (ids.get(case.bus_at.get(int(bus), -1)) for bus in buses)
        if start is not None and end is not None and start != end:
            rows.append((name or f"{start}-{end}", start, end, r_ohm, x_ohm, i_max_a))
    if not rows:
        return Ties.none()
    names, starts, ends, r, x, i_max = zip(*rows, strict=True)
    return Ties(
        id=np.array(identifiers(names, range(1, len(rows) + 1)), dtype=object),
        from_bus=np.array(starts, dtype=object),
        to_bus=np.array(ends, dtype=object),
        r_ohm=np.maximum(r, MIN_OHM),
        x_ohm=np.array(x),
        i_max_a=np.array(i_max),
    )


Found = tuple[str, tuple[Any, Any], float, float, float]
"""Name, buses, impedance in ohm and rating in A."""


def _lines(net: Any, network: Network) -> Iterator[Found]:
    """Lines that are out of service, or open at an end."""
    switches = net.switch[(net.switch["et"] == "l") & ~net.switch["closed"].astype(bool)]
    off = ~net.line["in_service"].astype(bool) | net.line.index.isin(switches["element"])
    for i, line in net.line[off].iterrows():
        kv = float(net.bus.at[line["from_bus"], "vn_kv"])
        length = float(line["length_km"]) / float(line.get("parallel", 1.0))
        length *= (network.base_kv / kv) ** 2
        rating_kva = float(mw_to_kw(rating_mva(net, "line", i)))
        yield (
            _name(line),
            (line["from_bus"], line["to_bus"]),
            float(line["r_ohm_per_km"]) * length,
            float(line["x_ohm_per_km"]) * length,
            float(kva_to_a(rating_kva, network.base_kv)),
        )


def _bus_switches(net: Any) -> Iterator[Found]:
    """Open switches between two buses, which have next to no impedance."""
    between = net.switch[(net.switch["et"] == "b") & ~net.switch["closed"].astype(bool)]
    for _, switch in between.iterrows():
        yield _name(switch), (switch["bus"], switch["element"]), 0.0, 0.0, np.inf


def _name(element: Any) -> str:
    """The source's name of an element; empty if it has none."""
    return element["name"] if isinstance(element["name"], str) else ""
