"""Changes of a pandapower net that can be taken back: rows that are ours, and states of branches.

A column ``vppres`` of the net marks what was put into it, and what was opened or closed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags
from vppres.core.errors import InputError, Problem
from vppres.feeders.net.switches import ENDS, open_elements, open_on
from vppres.scenario.configuration import Branches
from vppres.scenario.network import BusId

OURS = "vppres"
"""Column of the net that marks what was put into it; with ``opened``, a grid that was opened."""

SHUNTS = ("shunt", "ward")
"""Tables of constant admittances."""

PUT, OPENED, CLOSED = "put", "opened", "closed"

STATE = {**dict.fromkeys((*ENDS, *SHUNTS), "in_service"), "switch": "closed"}
"""Tables of what may carry or not, and the column that says so."""

Change = tuple[str, Any, bool]
"""Table, row and new state of a branch or switch."""


def ours(table: pd.DataFrame, word: str) -> pd.Series[bool]:
    """Rows that bear a mark of ours."""
    if OURS not in table:
        return pd.Series(False, table.index)
    return table[OURS] == word


def mark(net: Any, table: str, rows: Any, word: str) -> None:
    """Mark rows of a table as ours."""
    if OURS not in net[table]:
        net[table][OURS] = pd.Series("", net[table].index, dtype=object)
    net[table].loc[rows, OURS] = word


def put_back(net: Any) -> None:
    """Give branches, switches and shunts their states before an earlier step changed them."""
    for table, column in STATE.items():
        for word, before in ((OPENED, True), (CLOSED, False)):
            if (rows := ours(net[table], word)).any():
                net[table].loc[rows, column] = before
                net[table].loc[rows, OURS] = ""


def set_branches(net: Any, bus_of: Mapping[int, BusId], branches: Branches, carries: Flags) -> None:
    """Open the lines of a net that carry nothing, and close the ties that carry.

    The net has its branches as they were for the import; ``carries`` says which branches carry,
    (E,).

    Raises
    ------
    InputError
        For each that the net does not have; nothing is changed then.
    """
    changes: list[Change] = []
    problems = []
    pairs = [frozenset(ends) for ends in zip(branches.from_bus, branches.to_bus, strict=True)]
    tie = ~branches.closed
    free = [*_open_between(net, bus_of, branches.network.base_kv)] if carries[tie].any() else []
    for branch in np.flatnonzero(carries == tie):
        if tie[branch]:
            at, ties = branch - branches.network.n_lines, branches.ties
            found = _closed(net, pairs[branch], complex(ties.r_ohm[at], ties.x_ohm[at]), free)
        else:
            found = _opened(net, bus_of, pairs[branch])
        if not found:
            problems.append(_problem(bool(tie[branch]), branches.names[branch]))
        changes += found
    if problems:
        raise InputError(problems)
    for table, row, is_closed in changes:
        net[table].loc[row, STATE[table]] = is_closed
        mark(net, table, [row], CLOSED if is_closed else OPENED)


def switch_off_shunts(net: Any, bus_of: Mapping[int, BusId], buses: Collection[BusId]) -> None:
    """Take the shunts at some buses of the scenario out of service, and branches open at an end."""
    if not buses:
        return
    for table in SHUNTS:
        rows = net[table][net[table]["in_service"].astype(bool)]
        _switch_off(net, table, rows.index[rows["bus"].map(bus_of).isin(buses)])
    for table, sides in ENDS.items():
        rows = net[table][net[table]["in_service"].astype(bool)]
        there = rows[[*sides]].isin(bus_of)
        at = rows[[*sides]].isin([bus for bus, own in bus_of.items() if own in buses])
        is_open = rows.index.isin(open_on(net, table)["element"]) | ~there.all(axis=1)
        _switch_off(net, table, rows.index[is_open & at.any(axis=1)])


def _switch_off(net: Any, table: str, rows: Any) -> None:
    if len(rows):
        net[table].loc[rows, STATE[table]] = False
        mark(net, table, rows, OPENED)


def _problem(is_tie: bool, name: str) -> Problem:
    """A branch that is not in the net."""
    return Problem(
        "set-points",
        f"is {'closed' if is_tie else 'open or out'}, and the net has no such branch",
        "Give the net that the scenario was made from; switch a winding of a transformer with "
        "three by hand.",
        field="switch" if is_tie else "line",
        value=name,
    )


def _opened(net: Any, bus_of: Mapping[int, BusId], pair: frozenset[BusId]) -> list[Change]:
    """Changes that take all of a net between two buses out of service."""
    found: list[Change] = []
    for table, sides in ENDS.items():
        rows = net[table][net[table]["in_service"].astype(bool)]
        found += [
            (table, i, False)
            for i, *ends in rows[[*sides]].itertuples(name=None)
            if _pair(bus_of, ends) == pair
        ]
    between = net.switch[(net.switch["et"] == "b") & net.switch["closed"].astype(bool)]
    found += [
        ("switch", i, False)
        for i, *ends in between[["bus", "element"]].itertuples(name=None)
        if _pair(bus_of, ends) == pair
    ]
    return found


_Free = tuple[tuple[str, Any], frozenset[BusId], complex]


def _open_between(net: Any, bus_of: Mapping[int, BusId], base_kv: float) -> Iterator[_Free]:
    """Open elements of a net: table and row, the scenario's buses, impedance."""
    for element, ends, z_ohm in open_elements(net, base_kv):
        pair = _pair(bus_of, ends)
        if len(pair) == 2:
            yield element, pair, z_ohm


def _closed(net: Any, pair: frozenset[BusId], z_ohm: complex, free: list[_Free]) -> list[Change]:
    """Changes that close a tie: of several between its buses the one that is most like it."""
    fitting = [one for one in free if one[1] == pair]
    if not fitting:
        return []
    best = min(fitting, key=lambda one: abs(one[2] - z_ohm))
    free.remove(best)
    (table, row), *_ = best
    if table == "switch":
        return [("switch", row, True)]
    still_open = open_on(net, table)
    found: list[Change] = [
        ("switch", i, True) for i in still_open.index[still_open["element"] == row]
    ]
    if not net[table].loc[row, "in_service"]:
        found.append((table, row, True))
    return found


def _pair(bus_of: Mapping[int, BusId], ends: Any) -> frozenset[BusId]:
    """Both buses of the scenario; fewer where an end is none, or both are one."""
    return frozenset(bus_of[int(end)] for end in ends if int(end) in bus_of)
