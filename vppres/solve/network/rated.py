"""Ratings of lines: a window that exceeds one without them is decided again in the network.

Most windows exceed none, and for them nothing changes. The rows are made where a solution violates
them, as those of voltages. Where the network's master does not apply or finds nothing, the answer
stays what it is, and the run names the line.
"""

from __future__ import annotations

from vppres.core.arrays import Flags
from vppres.solve.dispatch import settle
from vppres.solve.network.decide import InNetwork, network_master
from vppres.solve.result import WindowSolution
from vppres.solve.task import WindowTask


def decided_within(task: WindowTask) -> WindowSolution | None:
    """The best set that the ratings of a window allow, None if none was found."""
    master = network_master(task)
    if master is None:
        return None
    task.certificate.best = InNetwork(task, master).decide()
    return task.solution() if task.certificate.answered else None


def served_within(task: WindowTask, served: Flags) -> WindowSolution | None:
    """Cheapest dispatch of a schedule within the ratings of a window, None if it has none."""
    master = network_master(task)
    if master is None:
        return None
    task.certificate.best = InNetwork(task, master).cheapest(served)
    settle(task)
    return task.solution() if task.certificate.answered else None
