"""Limits of the network that a problem gets where its solutions violate them.

Those of phases and the ratings of lines: few of them bind, and all at once they would be most of a
problem's rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vppres.core.arrays import Floats
from vppres.model.beyond_paper.ratings import FAMILY, limit_kva
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.deadline import Deadline
from vppres.solve.network.rows import Rows
from vppres.solve.phases import PhaseLimits
from vppres.solve.result import Outcome, Status
from vppres.solve.selection import Selected
from vppres.solve.solvers import run_conic

OVER_RATING = 2e-7
"""Share of its rating by which a flow may be above it without another tangent: twice what HiGHS
leaves of a row. Each kW beyond a rating saves PV power that would be curtailed: half of what a
dispatch's check allows moves the objective by 2e-4."""


@dataclass(frozen=True, eq=False)
class FlowLimits:
    """Ratings of a balanced feeder's lines, which no problem has from the start.

    A row is a tangent of a line's disc, so that what has some of them is a relaxation.
    """

    data: WindowData
    problem: Selected

    near = ()

    def exceeded(self, x: Floats) -> list[Rows]:
        """Tangents of the flows that exceed their limits, as shares of these."""
        at = self.problem.at
        p_kw, q_kvar = x[at("P_flow")], x[at("Q_flow")]
        size = np.hypot(p_kw, q_kvar)
        most = np.broadcast_to(limit_kva(self.data), size.shape)
        out = size > most * (1.0 + OVER_RATING)
        if not out.any():
            return []
        share = most[out] * size[out]
        columns = np.stack([at("P_flow")[out], at("Q_flow")[out]], axis=1)
        tangents = -np.stack([p_kw[out] / share, q_kvar[out] / share], axis=1)
        return [Rows.of(columns, tangents, -1.0, np.inf, len(x))]


def limits_of(site: Site, data: WindowData, problem: Selected) -> PhaseLimits | FlowLimits | None:
    """Limits that a problem does not state, as rows on its columns with a least value each.

    None where the window has none, and where the problem has no network.
    """
    if data.phased:
        return PhaseLimits(site, data, problem)
    stated = FAMILY in problem.statement.families or "P_flow" not in problem.first
    limited = len(data.flow_max_kva) and not stated
    return FlowLimits(data, problem) if limited else None


def run_within_limits(
    site: Site,
    data: WindowData,
    problem: Selected,
    time_s: float,
    rows: list[Rows] | None = None,
    solve: Callable[[float], Outcome] | None = None,
) -> Outcome:
    """Solve a problem in the network within the limits of a window that it does not state.

    By interior points, if there is no other ``solve`` for the seconds that are left.

    Limits that a solution exceeds are added until none is, or until they no longer move it: a
    solver leaves a row by its tolerance, and has those of the same point already. They are in
    ``rows`` then, and their duals behind the problem's own.
    """
    solve = solve or partial(run_conic, problem)
    if not data.phased and not len(data.flow_max_kva):
        return solve(time_s)
    deadline = Deadline(time_s)
    problem.compile()
    limits = limits_of(site, data, problem)
    if limits is None:
        return solve(deadline.left_s)
    rows = [] if rows is None else rows
    rows += limits.near
    before = np.empty(0)
    while True:
        problem.added = None
        if rows:
            joined = Rows.joined(rows)
            problem.added = joined.matrix, joined.lower
        outcome = solve(deadline.left_s)
        new: Sequence[Rows] = ()
        if outcome.status == Status.OPTIMAL and not np.array_equal(problem.x, before):
            new = limits.exceeded(problem.x)
            before = problem.x.copy()
        if not new or deadline.passed:
            problem.added = None
            status = Status.NO_ANSWER if new else outcome.status
            return replace(outcome, status=status, solve_s=deadline.spent_s)
        rows += new
