"""Notes on the reduction of a net: sentences that name the elements left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.core.units import mw_to_kw
from vppres.feeders.closeness import causes_of
from vppres.feeders.feeder import Generators
from vppres.feeders.net.branches import LEAST_PU, Stub
from vppres.feeders.net.elements import NetCase, in_service, label, supplied
from vppres.feeders.net.ratings import without_rating
from vppres.scenario.network import BusId

TABLES_OF_BUSES = ("load", "sgen", "gen", "storage")
TAP_TOLERANCE = 1e-9
FLEXIBLE = {
    # Words of any source, and the profiles of SimBench: air and soil, APLS and HLS.
    "Heat pumps": r"heat.?pump|w(?:ä|ae)rmepumpe|^(?:Air|Soil)_",
    "Charging points": r"\bev\b|e-?mobil|charging.?(?:point|station)|wallbox|^(?:APLS|HLS)_",
}


def told_left_out(net: Any, case: NetCase, bus_ids: Mapping[int, BusId] | None) -> Iterator[str]:
    """Buses without supply, and what is left out with them."""
    lost = net.bus.index.difference([*case.bus_at])
    if not len(lost):
        return
    buses = [bus_ids[bus] for bus in lost] if bus_ids else lost
    yield f"Without supply or out of service, and left out: bus {named(buses)}."
    for table in TABLES_OF_BUSES:
        frame = in_service(net, table)
        left = frame[frame["bus"].isin(lost)]
        if not len(left):
            continue
        names = [label(net, table, i) for i in left.index]
        p_mw = float((left["p_mw"] * left["scaling"]).abs().sum())
        yield f"Left out with their buses: {named(names)}, {mw_to_kw(p_mw):.4g} kW."


def notes_of(
    net: Any, case: NetCase, stubs: list[Stub], closed: list[str], condensers: Generators
) -> Iterator[str]:
    """Sentences on the simplifications.

    ``case`` has the branches before any are merged; ``stubs`` are open at one end, ``closed``
    became closed switches, and ``condensers`` only have reactive power.
    """
    yield from _notes_on_topology(net, case, stubs, closed)
    yield from _notes_on_branches(net, case)
    yield from _notes_on_elements(net, case, condensers)
    yield from _notes_on_control(net, case)


def _notes_on_topology(
    net: Any, case: NetCase, stubs: list[Stub], closed: list[str]
) -> Iterator[str]:
    joined: dict[int, list[int]] = {}
    for bus, row in case.bus_at.items():
        joined.setdefault(row, []).append(bus)
    for buses in joined.values():
        if len(buses) > 1:
            yield f"Closed switches make one bus of the buses {named(buses)}."
    if closed:
        yield (
            f"Branches of less than {LEAST_PU:g} pu (on 1 MVA) count as closed switches, and their "
            f"ends as one bus: {named(closed)}."
        )
    if stubs:
        kvar = float(mw_to_kw(sum(stub.y.imag for stub in stubs) * case.base_mva))
        ends = named(stub.label for stub in stubs)
        yield f"Open at one end, and kept as shunts of {kvar:.4g} kvar: {ends}."


def _notes_on_branches(net: Any, case: NetCase) -> Iterator[str]:
    branches = case.branches  # those that are open at one end too
    kv = np.unique(case.bus_kv)
    if len(kv) > 1:
        yield (
            f"The voltage levels {', '.join(f'{level:g}' for level in kv)} kV are referred to "
            "one by the square of the nominal ratio; phase shifts have no effect in a radial "
            "feeder and are left out."
        )
    off = branches[(branches["tap"] - 1).abs() > TAP_TOLERANCE]
    if len(off):
        ratios = [f"{n} ({tap:.4f})" for n, tap in zip(off["label"], off["tap"], strict=True)]
        yield f"Taps stay as they are, with the ratio {named(ratios)}."
    yield from _set_points(net)
    unrated = [*without_rating(net)]
    if unrated:
        yield f"Without a rating in the source, and here: {named(unrated)}."
    negative = branches[branches["r"] < 0]
    if len(negative):
        sizes = [f"{n} ({r:.3g} pu)" for n, r in zip(negative["label"], negative["r"], strict=True)]
        yield f"Negative resistances count as none: {named(sizes)}."


def _set_points(net: Any) -> Iterator[str]:
    """Voltages that controllers of taps hold in the source."""
    found = []
    for control in net["controller"]["object"] if "controller" in net else ():
        table = str(getattr(control, "element", getattr(control, "trafotable", "")))
        index = getattr(control, "element_index", getattr(control, "tid", None))
        band = [getattr(control, name, None) for name in ("vm_lower_pu", "vm_upper_pu")]
        target = getattr(control, "vm_set_pu", None)
        if not table.startswith("trafo") or (target is None and None in band):
            continue
        held = f"{target:g} pu" if target is not None else f"{band[0]:g} to {band[1]:g} pu"
        found.append(f"{table} {named(np.ravel([index]))} ({held})")
    if found:
        yield f"Tap changers are controlled in the source, and fixed here: {named(found)}."


def _notes_on_elements(net: Any, case: NetCase, condensers: Generators) -> Iterator[str]:
    for cause in causes_of(net, case):
        yield f"Taken as constant power: {cause}."
    if len(condensers):
        sizes = [
            f"{n} ({q:.4g} kvar)" for n, q in zip(condensers.id, condensers.q_kvar, strict=True)
        ]
        yield f"Generators with reactive power only are fixed: {named(sizes)}."


def _notes_on_control(net: Any, case: NetCase) -> Iterator[str]:
    """Flags and controllers of the source that have no counterpart."""
    loads = supplied(net, "load", case)
    if "controllable" in loads:
        flags = loads["controllable"].fillna(False).astype(bool)
        if flags.any() and not flags.all():
            names = [label(net, "load", i) for i in loads.index[~flags]]
            yield f"Not controllable in the source, and customers like any other: {named(names)}."
    yield from _flexible_loads(net, loads)
    acting = [row for row in _controllers(net) if row[1]]
    if acting:
        yield f"Controllers of the source do not act: {named(name for name, _ in acting)}."


def _flexible_loads(net: Any, loads: pd.DataFrame) -> Iterator[str]:
    """Loads that could shift their demand, by the words of the source: plans do not shift it."""
    words = loads.reindex(columns=["name", "type", "profile"]).fillna("").astype(str)
    for what, pattern in FLEXIBLE.items():
        found = words.apply(
            lambda column, p=pattern: column.str.contains(p, case=False, regex=True)
        )
        chosen = loads[found.any(axis=1)]
        if len(chosen):
            p_kw = float(mw_to_kw((chosen["p_mw"] * chosen["scaling"].fillna(1.0)).sum()))
            names = named(label(net, "load", i) for i in chosen.index)
            yield (
                f"{what} of {p_kw:.4g} kW: plans do not shift their demand in time, and switch "
                f"them off with their customers: {names}."
            )


def _controllers(net: Any) -> Iterator[tuple[str, bool]]:
    """Class and element of every controller, and whether it is in service."""
    table = net.get("controller")
    if table is None or "object" not in table:
        return
    for index, row in table.iterrows():
        kind = type(row["object"]).__name__
        element = getattr(row["object"], "element", None)
        name = f"{kind} {index}" + (f" ({element})" if isinstance(element, str) else "")
        yield name, bool(row.get("in_service", True))
