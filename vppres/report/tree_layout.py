"""Places of a radial feeder's buses in a one-line diagram, computed from the network alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Wholes, freeze_arrays
from vppres.scenario.network import Network


@dataclass(frozen=True, eq=False)
class TreeLayout:
    """Column and row of each bus, shape (N,) each.

    The column is the number of lines to the slack bus. No two buses share a place, and a line
    drawn down or up its sending bus's column and then along its receiving bus's row crosses none
    of the others.
    """

    column: Wholes
    row: Wholes

    def __post_init__(self) -> None:
        freeze_arrays(self)


def tree_layout(network: Network) -> TreeLayout:
    """Lay out a feeder: the longest path is a straight trunk, laterals lie above and below it.

    A lateral is laid out like the trunk. Laterals are placed from the far end of their trunk, each
    in the nearest row in which it and its own laterals have room.

    Examples
    --------
    >>> net = Network([1, 2, 2], [2, 3, 4], [0.1] * 3, [0.1] * 3, slack_bus=1, base_kv=11.0)
    >>> layout = tree_layout(net)
    >>> layout.column.tolist(), layout.row.tolist()
    ([0, 1, 2, 2], [0, 0, 0, 1])
    """
    children: list[list[int]] = [[] for _ in range(network.n_buses)]
    column = np.zeros(network.n_buses, dtype=int)
    for bus, parent in enumerate(network.parent.tolist(), start=1):
        children[parent].append(bus)
        column[bus] = column[parent] + 1
    reach = column.copy()
    for bus in range(network.n_buses - 1, 0, -1):
        parent = int(network.parent[bus - 1])
        reach[parent] = max(reach[parent], reach[bus])
    rows, _ = _place(0, children, reach, column)
    row = np.array([rows[bus] for bus in range(network.n_buses)])
    return TreeLayout(column, row - row.min())


def _place(
    bus: int, children: list[list[int]], reach: Wholes, column: Wholes
) -> tuple[dict[int, int], dict[int, Wholes]]:
    """Lay out a bus and all that it feeds.

    Gives the row of each bus, counted from that of the first, and for each side how many rows are
    in use, by column.
    """
    trunk = [bus]
    while children[trunk[-1]]:
        trunk.append(max(children[trunk[-1]], key=lambda child: reach[child]))
    rows = dict.fromkeys(trunk, 0)
    used = {side: np.zeros(reach[bus] + 1, dtype=int) for side in (1, -1)}
    for start_bus, ahead in zip(trunk[-2::-1], trunk[:0:-1], strict=True):
        for lateral in children[start_bus]:
            if lateral == ahead:
                continue
            own_rows, own_used = _place(lateral, children, reach, column)
            span = slice(column[lateral], reach[lateral] + 1)
            starts = {s: (used[s][span] + own_used[-1][span]).max() + 1 for s in used}
            side = min(starts, key=starts.__getitem__)
            start = starts[side]
            rows |= {below: side * (start + depth) for below, depth in own_rows.items()}
            used[side][span] = start + own_used[1][span]
            used[side][column[start_bus]] = start  # the line to the lateral
    return rows, used
