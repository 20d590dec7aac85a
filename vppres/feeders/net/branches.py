"""Branches of a pandapower case as two-ports: what a tree of lines with ratios makes of them.

A branch is an ideal transformer of ratio ``tap`` at its ``from`` bus and a series impedance with a
shunt at either end behind it, as in MATPOWER. Nothing here is approximate but the merging of
buses that are joined by next to no impedance.

Branches are tables with the columns ``from``, ``to``, ``r``, ``x``, ``tap``, ``y_from``, ``y_to``
(the shunts), ``label`` and ``rating_mva``; values are in pu of the case's base.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from vppres.core.arrays import Complexes, Flags, Floats, Wholes

LEAST_PU = 1e-6
"""Impedance in pu of 1 MVA below which a branch counts as a closed switch: 1 MVA drops at most a
millionth of the voltage across it. It is 0.14 milliohm at 12 kV and 0.16 microohm at 0.4 kV."""

EVEN = 1e-9
"""Difference of a branch's two shunts, as a share, up to which they count as the same."""


COLUMNS = {"from": 0, "to": 1, "r": 2, "x": 3, "tap": 8, "shift": 9}
CHARGING = 4
"""Columns of the branches of pandapower's case."""


def two_ports(branch: Floats, g: Floats, g_more: Floats, b_more: Floats) -> pd.DataFrame:
    """Branches of a case, with the leakage ``g`` and what the second shunt has beyond the first."""
    half = 0.5 * (g + 1j * branch[:, CHARGING])
    columns: dict[str, Any] = {name: branch[:, column] for name, column in COLUMNS.items()}
    columns |= {"y_from": half, "y_to": half + 0.5 * (g_more + 1j * b_more)}
    return pd.DataFrame(columns).astype({"from": int, "to": int})


class Stub(NamedTuple):
    """A branch that is open at one end: the row of its other end, and its admittance there."""

    label: str
    row: int
    y: complex


def split_stubs(branches: pd.DataFrame, own: set[int]) -> tuple[pd.DataFrame, list[Stub]]:
    """Branches without those that end at a bus which only the open end of a line has, and these.

    ``own`` has the rows of the source's buses. Stubs come from the outermost inwards; the
    admittance of one holds that of those behind it.
    """
    stubs: list[Stub] = []
    behind: dict[int, complex] = {}
    while True:
        buses, count = np.unique(branches[["from", "to"]].to_numpy(), return_counts=True)
        ends = set(buses[count == 1].tolist()) - own
        dangling = branches["from"].isin(ends) | branches["to"].isin(ends)
        if not dangling.any():
            return branches, [stub for stub in stubs if stub.row in own]
        for _, branch in branches[dangling].iterrows():
            stub = _seen(branch, ends, behind)
            behind[stub.row] = behind.get(stub.row, 0j) + stub.y
            stubs.append(stub)
        branches = branches[~dangling]


def _seen(branch: pd.Series, ends: set[int], behind: dict[int, complex]) -> Stub:
    """A dangling branch as the bus at its other end sees it: series and far shunt in a row."""
    series = 1 / complex(branch["r"], branch["x"])
    tap_2 = float(branch["tap"]) ** 2
    if int(branch["to"]) in ends:
        far = complex(branch["y_to"]) + behind.pop(int(branch["to"]), 0j)
        y = (complex(branch["y_from"]) + series * far / (series + far)) / tap_2
        return Stub(str(branch["label"]), int(branch["from"]), y)
    far = complex(branch["y_from"]) + behind.pop(int(branch["from"]), 0j) * tap_2
    y = complex(branch["y_to"]) + series * far / (series + far)
    return Stub(str(branch["label"]), int(branch["to"]), y)


def closed_switches(branches: pd.DataFrame, base_mva: float, bus_kv: Floats) -> pd.Series[bool]:
    """Branches with next to no impedance between buses of one level, and without a tap."""
    z_pu = np.hypot(branches["r"], branches["x"]) / base_mva
    same_kv = bus_kv[branches["from"]] == bus_kv[branches["to"]]
    closed: pd.Series[bool] = (z_pu < LEAST_PU) & (branches["tap"] == 1.0) & same_kv
    return closed


def joined_rows(branches: pd.DataFrame, count: int, first: int) -> Wholes:
    """The row that stands for each of ``count`` rows once the branches' ends are one bus.

    ``first`` always stands for itself; otherwise the lowest row stands for the others.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = branches["from"].to_numpy(int), branches["to"].to_numpy(int)
    graph = coo_array((np.ones(len(branches)), ends), shape=(count, count))
    _, group = connected_components(graph, directed=False)
    leader = np.full(group.max() + 1, count)
    np.minimum.at(leader, group, np.arange(count))
    leader[group[first]] = first
    return np.asarray(leader[group])


def parallel_as_one(branches: pd.DataFrame) -> pd.DataFrame:
    """One branch between two buses, with the direction of the first of them.

    Parallel branches of one ratio add up by their admittances. With different ratios a current
    circulates between them: their two-ports are added, and a branch with shunts of its own has the
    same two-port.
    """
    low = branches[["from", "to"]].min(axis=1)
    high = branches[["from", "to"]].max(axis=1)
    rows = [_one(group) for _, group in branches.groupby([low, high], sort=False)]
    return pd.DataFrame(rows, columns=[*_COLUMNS])


_COLUMNS = ("from", "to", "r", "x", "tap", "y_from", "y_to", "label", "rating_mva")


def _one(group: pd.DataFrame) -> tuple[object, ...]:
    """A branch that stands for parallel ones."""
    first = group.iloc[0]
    if len(group) == 1:
        return tuple(first[name] for name in _COLUMNS)
    z_all: Complexes = group["r"].to_numpy(float) + 1j * group["x"].to_numpy(float)
    series = 1 / z_all
    along = (group["from"] == first["from"]).to_numpy()
    tap = group["tap"].to_numpy(float)
    ends: list[Complexes] = [group[name].to_numpy(complex) for name in ("y_from", "y_to")]
    if (along | (tap == 1.0)).all() and np.ptp(tap) == 0.0:
        ratio = float(tap[0])
        total = series.sum()
        y_from = np.where(along, ends[0], ends[1]).sum()
        y_to = np.where(along, ends[1], ends[0]).sum()
    else:
        ratio, total, y_from, y_to = _added(series, tap, ends, along)
    z = 1 / total
    # Together they carry so much that the first of them reaches its own rating.
    rating = (group["rating_mva"] * abs(total) / np.abs(series)).min()
    label = " with ".join(group["label"])
    return first["from"], first["to"], z.real, z.imag, ratio, y_from, y_to, label, rating


def _added(
    series: Complexes,
    tap: Floats,
    ends: list[Complexes],
    along: Flags,
) -> tuple[float, complex, complex, complex]:
    """Ratio, series and end admittances of the sum of two-ports."""
    tapped = (series + ends[0]) / tap**2
    plain = series + ends[1]
    at_first = np.where(along, tapped, plain).sum()
    at_last = np.where(along, plain, tapped).sum()
    between = (series / tap).sum()
    ratio = float(np.sqrt(abs(at_last) / abs(at_first)))
    total = between * ratio
    return ratio, total, at_first * ratio**2 - total, at_last - total
