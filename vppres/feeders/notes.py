"""What the reduction of a net leaves out, in sentences that name the elements."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vppres.core.units import mw_to_kw
from vppres.feeders.elements import NetCase, few, in_service, label, supplied

TABLES_OF_BUSES = ("load", "sgen", "gen")
TAP_TOLERANCE = 1e-9


def notes_of(net: Any, case: NetCase, stubs: list[str]) -> Iterator[str]:
    """What was simplified, in sentences."""
    yield from _notes_on_topology(net, case, stubs)
    yield from _notes_on_branches(net, case)
    yield from _notes_on_elements(net, case)
    yield from _notes_on_control(net, case)


def _notes_on_topology(net: Any, case: NetCase, stubs: list[str]) -> Iterator[str]:
    joined: dict[int, list[int]] = {}
    for bus, row in case.bus_at.items():
        joined.setdefault(row, []).append(bus)
    for buses in joined.values():
        if len(buses) > 1:
            yield f"Closed switches make one bus of the buses {few(buses)}."
    lost = net.bus.index.difference([*case.bus_at])
    if len(lost):
        yield f"Without supply or out of service, and left out: bus {few(lost)}."
        for table in TABLES_OF_BUSES:
            frame = in_service(net, table)
            names = [label(net, table, i) for i in frame.index[frame["bus"].isin(lost)]]
            if names:
                yield f"Left out with their buses: {few(names)}."
    if stubs:
        yield f"Open at one end, and left out: {few(stubs)}."


def _notes_on_branches(net: Any, case: NetCase) -> Iterator[str]:
    branches = case.branches  # those that are open at one end charge too
    kv = np.unique(case.bus_kv)
    if len(kv) > 1:
        yield (
            f"The voltage levels {', '.join(f'{level:g}' for level in kv)} kV are referred to "
            "one by the square of the nominal ratio; phase shifts have no effect in a radial "
            "feeder and are left out."
        )
    charging = branches["b"] > 0
    if charging.any():
        kvar = float(mw_to_kw(branches.loc[charging, "b"].sum() * case.base_mva))
        yield f"The charging of {charging.sum()} lines, {kvar:.4g} kvar in all, is left out."
    leaking = _labels_where(net, ["line"], ["g_us_per_km"])
    if leaking:
        yield f"The leakage conductance of {few(leaking)} is left out."
    losses = _labels_where(net, ["trafo", "trafo3w"], ["pfe_kw", "i0_percent"])
    if losses:
        yield f"The no-load losses and the magnetising current are left out of {few(losses)}."
    shunted = _labels_where(net, ["impedance"], ["gf_pu", "bf_pu", "gt_pu", "bt_pu"])
    if shunted:
        yield f"The shunt admittance of {few(shunted)} is left out."
    off = branches[(branches["tap"] - 1).abs() > TAP_TOLERANCE]
    if len(off):
        ratios = [f"{n} ({tap:.4f})" for n, tap in zip(off["label"], off["tap"], strict=True)]
        yield f"Ratios that are not nominal are taken as nominal (tap at neutral): {few(ratios)}."


def _notes_on_elements(net: Any, case: NetCase) -> Iterator[str]:
    for table, words in (
        ("shunt", "Shunts are left out"),
        ("gen", "Generators keep their active power and lose their voltage control"),
    ):
        names = [label(net, table, i) for i in supplied(net, table, case).index]
        if names:
            yield f"{words}: {few(names)}."
    loads = supplied(net, "load", case)
    shares = loads[[c for c in loads if str(c).startswith(("const_z", "const_i"))]]
    varying = [label(net, "load", i) for i in loads.index[shares.fillna(0.0).any(axis=1)]]
    if varying:
        yield f"Loads that follow the voltage are taken as constant power: {few(varying)}."


def _labels_where(net: Any, tables: list[str], columns: list[str]) -> list[str]:
    """Elements in service that are not zero in one of the columns."""
    found = []
    for table in tables:
        frame = in_service(net, table)
        values = frame.reindex(columns=columns).fillna(0.0)
        found += [label(net, table, i) for i in frame.index[(values != 0).any(axis=1)]]
    return found


def _notes_on_control(net: Any, case: NetCase) -> Iterator[str]:
    """Flags and controllers of the source that have no counterpart."""
    loads = supplied(net, "load", case)
    if "controllable" in loads:
        flags = loads["controllable"].fillna(False).astype(bool)
        if flags.any() and not flags.all():
            names = [label(net, "load", i) for i in loads.index[~flags]]
            yield f"Not controllable in the source, and customers like any other: {few(names)}."
    acting = [row for row in _controllers(net) if row[1]]
    if acting:
        yield f"Controllers of the source do not act: {few(name for name, _ in acting)}."


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
