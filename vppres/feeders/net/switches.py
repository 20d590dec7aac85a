"""Switches of a pandapower net: what is open and could close a loop, and what stands on a line.

Impedances refer to the network's voltage. Charging of an open line is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from vppres.core.text import flaw_of_name
from vppres.core.units import kva_to_a, mw_to_kw
from vppres.feeders.net.elements import JOINT, NetCase, in_service
from vppres.feeders.net.names import LONGEST, identifiers
from vppres.feeders.net.ratings import rating_mva
from vppres.io.schema import MAX_OHM, MIN_OHM
from vppres.scenario.network import BusId, Network
from vppres.scenario.switches import Switches

LOCKED = "locked"
"""Column of a net's switches with the reason why one must not move; only some readers have it."""

ENDS = {
    "line": ("from_bus", "to_bus"),
    "trafo": ("hv_bus", "lv_bus"),
    "impedance": ("from_bus", "to_bus"),
}
TABLE_OF = {"l": "line", "t": "trafo"}
"""Tables of what switches stand on, by pandapower's words."""

ASSETS = (
    "load",
    "sgen",
    "gen",
    "ext_grid",
    "storage",
    "shunt",
    "ward",
    "motor",
    "asymmetric_load",
    "asymmetric_sgen",
)
"""Tables of what a bus may have, so that it is more than the end of a line."""


class _Found(NamedTuple):
    """A switch: an open one with its buses and impedance, a closed one with those of its line."""

    name: str
    buses: tuple[int, int]
    breaker: bool
    locked: str
    z_ohm: complex | None = None
    i_max_a: float = np.inf
    element: tuple[str, Any] | None = None  #: of an open one, its table and row of the net


def switches_of(net: Any, joined: NetCase, ids: Mapping[int, BusId], network: Network) -> Switches:
    """Switches of a net between two buses of the network, one for each line that has any.

    The loops of the net are opened. ``joined`` is its case with one bus for the ends of closed
    switches, and ``ids`` has the bus of the network for each of its rows.
    """
    at = {bus: ids[row] for bus, row in joined.bus_at.items()}
    rows = [
        (found, at[found.buses[0]], at[found.buses[1]])
        for found in (*_open_branches(net, network.base_kv), *_open_bus_switches(net))
        if {*found.buses} <= at.keys() and at[found.buses[0]] != at[found.buses[1]]
    ]
    rows += [(found, ids[found.buses[0]], ids[found.buses[1]]) for found in _on_lines(net, joined)]
    if not rows:
        return Switches.none()
    is_open = np.array([found.z_ohm is not None for found, _, _ in rows], dtype=bool)
    z_ohm = np.array([found.z_ohm if found.z_ohm is not None else np.nan for found, _, _ in rows])
    breaker = np.array([found.breaker for found, _, _ in rows], dtype=bool)
    names = [
        found.name if found.name and not flaw_of_name(found.name, LONGEST) else f"{start}-{end}"
        for found, start, end in rows
    ]
    return Switches(
        id=np.array(identifiers(names, range(1, len(rows) + 1)), dtype=object),
        from_bus=np.array([start for _, start, _ in rows], dtype=object),
        to_bus=np.array([end for _, _, end in rows], dtype=object),
        kind=np.where(breaker, "breaker", np.where(is_open, "tie", "sectionaliser")),
        closed=~is_open,
        locked=np.array([found.locked for found, _, _ in rows], dtype=object),
        r_ohm=np.maximum(z_ohm.real, MIN_OHM),
        x_ohm=np.where(is_open, z_ohm.imag, np.nan),
        i_max_a=np.array([found.i_max_a for found, _, _ in rows]),
    )


def open_elements(
    net: Any, base_kv: float
) -> Iterator[tuple[tuple[str, Any], tuple[int, int], complex]]:
    """Open branches and switches that could be ties: table and row, buses of the net, impedance."""
    for found in (*_open_branches(net, base_kv), *_open_bus_switches(net)):
        assert found.element is not None and found.z_ohm is not None  # an open one has both
        yield found.element, found.buses, found.z_ohm


def told_open_transformers(net: Any, joined: NetCase) -> Iterator[str]:
    """Sentence on open transformers that are no switches, as these have no ratio."""
    names = [
        _name(row) or f"trafo {i}"
        for i, row in net.trafo[_off(net, "trafo")].iterrows()
        if {row["hv_bus"], row["lv_bus"]} <= joined.bus_at.keys() and not _is_nominal(net, row)
    ]
    if names:
        yield f"Open transformers with a ratio are no open switches here: {', '.join(names)}."


def _open_branches(net: Any, base_kv: float) -> Iterator[_Found]:
    """Branches that are out of service, or open at an end."""
    for table in ENDS:
        for i, row in net[table][_off(net, table)].iterrows():
            z_ohm = _z_ohm(net, table, row, base_kv)
            if z_ohm is None or not (z_ohm.real <= MAX_OHM and abs(z_ohm.imag) <= MAX_OHM):
                continue
            start, end = (int(row[side]) for side in ENDS[table])
            rating_a = float(kva_to_a(float(mw_to_kw(rating_mva(net, table, i))), base_kv))
            own = switches_on(net, table)
            own = own[own["element"] == i]
            name = _name(row) or _one_name(own)
            of_net = (table, i)
            yield _Found(name, (start, end), *_breaker_and_lock(own), z_ohm, rating_a, of_net)


def _off(net: Any, table: str) -> pd.Series[bool]:
    """Branches that are out of service, or have an open switch."""
    off: pd.Series[bool] = ~net[table]["in_service"].astype(bool)
    off |= net[table].index.isin(open_on(net, table)["element"])
    return off


def switches_on(net: Any, table: str) -> pd.DataFrame:
    """Switches that stand on the branches of a table, their ``element``."""
    on: pd.DataFrame = net.switch[net.switch["et"].map(TABLE_OF) == table]
    return on


def open_on(net: Any, table: str) -> pd.DataFrame:
    """Open switches that stand on the branches of a table, their ``element``."""
    on = switches_on(net, table)
    return on[~on["closed"].astype(bool)]


def _z_ohm(net: Any, table: str, row: Any, base_kv: float) -> complex | None:
    """Series impedance of a branch without a ratio; None for one with a ratio."""
    if table == "line":
        kv = float(net.bus.at[row["from_bus"], "vn_kv"])
        length = float(row["length_km"]) / float(row.get("parallel", 1.0))
        length *= (base_kv / kv) ** 2
        return complex(row["r_ohm_per_km"] * length, row["x_ohm_per_km"] * length)
    base_ohm = base_kv**2 / float(row["sn_mva"])
    if table == "impedance":
        return complex(row["rft_pu"], row["xft_pu"]) * base_ohm
    if not _is_nominal(net, row):
        return None
    r_pu, z_pu = (float(row[name]) / 100.0 for name in ("vkr_percent", "vk_percent"))
    units = float(row.get("parallel", 1.0))
    return complex(r_pu, np.sqrt(max(z_pu**2 - r_pu**2, 0.0))) * base_ohm / units


def _is_nominal(net: Any, row: Any) -> bool:
    """Whether a transformer has the ratio of its buses' nominal voltages."""
    kv = [float(net.bus.at[row[side], "vn_kv"]) for side in ENDS["trafo"]]
    own = [float(row["vn_hv_kv"]), float(row["vn_lv_kv"])]
    tap = pd.to_numeric(row.get("tap_pos"), errors="coerce")
    step = tap - pd.to_numeric(row.get("tap_neutral"), errors="coerce")
    return kv == own and not (np.isfinite(step) and step != 0.0)


def _open_bus_switches(net: Any) -> Iterator[_Found]:
    """Open switches between two buses, which have next to no impedance."""
    between = net.switch[(net.switch["et"] == "b") & ~net.switch["closed"].astype(bool)]
    for i, switch in between.iterrows():
        buses = int(switch["bus"]), int(switch["element"])
        own = _breaker_and_lock(between.loc[[i]])
        yield _Found(_name(switch), buses, *own, complex(MIN_OHM, 0.0), element=("switch", i))


def _on_lines(net: Any, joined: NetCase) -> Iterator[_Found]:
    """Closed switches by the line on which they stand; their buses are rows of the case."""
    branches = joined.branches
    elements = zip(branches["table"], branches["element"], strict=True)
    row_of = {element: i for i, element in enumerate(elements)}
    pairs = [
        frozenset(pair)
        for pair in branches[["from", "to"]].astype(int).itertuples(index=False, name=None)
    ]
    # Of parallel lines that are one here, the switch of one does not open the other.
    once = {
        pair for pair, count in pd.Series(pairs, dtype=object).value_counts().items() if count == 1
    }
    standing: dict[int, list[tuple[Any, bool]]] = {}
    for i, element, apart in _closed(net, joined):
        line = row_of.get(element)
        if line is not None and pairs[line] in once:
            standing.setdefault(line, []).append((i, apart))
    for line, switches in sorted(standing.items()):
        branch = branches.iloc[line]
        own = net.switch.loc[[i for i, _ in switches]]
        names = [_name(net[branch["table"]].loc[branch["element"]]), _one_name(own)]
        if len(switches) == 1 and switches[0][1]:
            names.reverse()  # the switch is an element of its own
        name = next(filter(None, names), "")
        yield _Found(name, (int(branch["from"]), int(branch["to"])), *_breaker_and_lock(own))


def _closed(net: Any, joined: NetCase) -> Iterator[tuple[Any, tuple[str, Any], bool]]:
    """Closed switches, the branch that each cuts off alone, and whether they lie beside it."""
    closed = net.switch[net.switch["closed"].astype(bool)]
    for i, switch in closed.iterrows():
        if switch["et"] in TABLE_OF:
            yield i, (TABLE_OF[switch["et"]], switch["element"]), False
        elif switch["et"] == "b" and float(switch["z_ohm"]) > 0.0:
            yield i, ("switch", i), False
    for i, branch in _cutting_off(net, [*_joints(net, closed, joined)]):
        yield i, branch, True


class _Joint(NamedTuple):
    """A closed switch, or a line of next to no impedance, that makes one bus of two."""

    switch: Any | None
    line: Any | None
    start: int
    end: int


def _joints(net: Any, closed: pd.DataFrame, joined: NetCase) -> Iterator[_Joint]:
    """Switches and lines between buses that are one in the network."""
    for i, switch in closed[(closed["et"] == "b") & ~(closed["z_ohm"] > 0.0)].iterrows():
        real = i if switch["type"] != JOINT else None
        yield _Joint(real, None, int(switch["bus"]), int(switch["element"]))
    on_line = closed[closed["et"] == "l"].drop_duplicates("element")
    switch_on = dict(zip(on_line["element"], on_line.index, strict=True))
    lines = in_service(net, "line")
    for i, *ends in lines[[*ENDS["line"]]].itertuples(name=None):
        start, end = map(int, ends)
        row = joined.bus_at.get(start)
        if row is not None and row == joined.bus_at.get(end):
            yield _Joint(switch_on.get(i), i, start, end)


def _cutting_off(net: Any, joints: list[_Joint]) -> Iterator[tuple[Any, tuple[str, Any]]]:
    """Switches within one bus of the network, of which one side is the end of one branch alone."""
    near: dict[int, list[tuple[_Joint, int]]] = {}
    for joint in joints:
        near.setdefault(joint.start, []).append((joint, joint.end))
        near.setdefault(joint.end, []).append((joint, joint.start))
    owned = {int(bus) for table in ASSETS if table in net for bus in in_service(net, table)["bus"]}
    inside = {("line", joint.line) for joint in joints}
    ends: dict[int, list[tuple[str, Any]]] = {}
    for table, sides in {**ENDS, "trafo3w": ("hv_bus", "mv_bus", "lv_bus")}.items():
        for i, *buses in in_service(net, table)[list(sides)].itertuples(name=None):
            for bus in buses if (table, i) not in inside else ():
                ends.setdefault(int(bus), []).append((table, i))
    for joint in joints:
        for first, other in ((joint.start, joint.end), (joint.end, joint.start)):
            if joint.switch is None:
                continue
            side = _reached(first, near, joint)
            branches = [branch for bus in side for branch in ends.get(bus, ())]
            alone = len(branches) == 1 and branches[0][0] in ENDS and not side & owned
            if other not in side and alone:
                yield joint.switch, branches[0]
                break


def _reached(
    bus: int, near: Mapping[int, Iterable[tuple[_Joint, int]]], without: _Joint
) -> set[int]:
    """Buses that are joined to one without a switch."""
    found, ahead = {bus}, [bus]
    while ahead:
        for joint, other in near.get(ahead.pop(), ()):
            if joint is not without and other not in found:
                found.add(other)
                ahead.append(other)
    return found


def _breaker_and_lock(switches: pd.DataFrame) -> tuple[bool, str]:
    """Whether switches of one line are a circuit breaker, and why they are locked, if they are."""
    reasons = [text for text in switches.get(LOCKED, ()) if isinstance(text, str) and text]
    return bool((switches["type"] == "CB").any()), next(iter(reasons), "")


def _one_name(switches: pd.DataFrame) -> str:
    """Name of the only switch of a line; empty if there are several."""
    return _name(switches.iloc[0]) if len(switches) == 1 else ""


def _name(element: Any) -> str:
    """The source's name of an element; empty if it has none."""
    return element["name"] if isinstance(element["name"], str) else ""
