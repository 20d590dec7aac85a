"""Windows whose steps nothing joins, solved one by one (``docs/method.md``, *Steps apart*).

Batteries carry energy, and switching rules carry duties, from one step to another. Where there is
neither, the objective is a sum over the steps, and so are the best dispatch and its bound. Solved
together, such a window is one knapsack for each step at the same time, and a search multiplies
their branches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.terms import Terms
from vppres.solve.deadline import Deadline
from vppres.solve.result import SolveLimits, Status, WindowSolution

SolveStep = Callable[[WindowData, SolveLimits], WindowSolution]

LEAST_S = 0.01
"""What a step may take where earlier ones have used up the time: its grace is for an answer."""


def falls_apart(site: Site, data: WindowData) -> bool:
    """Whether a window has several steps and nothing that joins them."""
    return data.n_steps > 1 and len(site.batteries) == 0 and data.switching is None


def solve_apart(data: WindowData, limits: SolveLimits, solve: SolveStep) -> WindowSolution:
    """Solve a window step by step.

    Parameters
    ----------
    data : WindowData
        A window that falls apart.
    limits : SolveLimits
        Of the whole window: a step gets its share of the absolute gap and of the time left.
    solve : callable
        Solves the window of one step.

    Raises
    ------
    SolveError
        If a step has no dispatch.
    """
    deadline = Deadline(limits.time_s)
    steps: list[WindowSolution] = []
    for k in range(data.n_steps):
        share = 1.0 / (data.n_steps - k)
        alone = SolveLimits(
            gap_rel=limits.gap_rel,
            gap_abs=limits.gap_abs / data.n_steps,
            time_s=max(share * deadline.left_s, LEAST_S),
        )
        steps.append(solve(data.part(slice(k, k + 1)), alone))
    return _joined(steps, limits, deadline)


def _joined(
    steps: Sequence[WindowSolution], limits: SolveLimits, deadline: Deadline
) -> WindowSolution:
    """The window of these steps: all figures are sums.

    So the gap of cost is that of sets that serve as much in each step, not in all together.
    """
    objective = sum(step.objective for step in steps)
    bound = sum(step.bound for step in steps)
    losses = [step.loss_kw for step in steps if step.loss_kw is not None]
    return WindowSolution(
        dispatch=_one_dispatch([step.dispatch for step in steps]),
        terms=Terms(
            **{f.name: sum(getattr(step.terms, f.name) for step in steps) for f in fields(Terms)}
        ),
        objective=objective,
        bound=bound,
        status=_status(steps, limits.met(bound, objective)),
        service_gap=sum(step.service_gap for step in steps),
        cost_gap_gbp=sum(step.cost_gap_gbp for step in steps),
        solve_s=deadline.spent_s,
        solver_s=sum(step.solver_s for step in steps),
        stages=tuple(stage for step in steps for stage in step.stages),
        loss_kw=np.concatenate(losses) if losses else None,
    )


def _status(steps: Sequence[WindowSolution], met: bool) -> Status:
    """What the whole window's dispatch is worth."""
    if met:
        return Status.OPTIMAL
    late = any(step.status == Status.TIME_LIMIT for step in steps)
    return Status.TIME_LIMIT if late else Status.GAP_OPEN


def _one_dispatch(parts: Sequence[Dispatch]) -> Dispatch:
    """The dispatches of consecutive steps as one; ``soc`` has a row more than the steps."""
    rows = {
        f.name: np.concatenate([getattr(part, f.name) for part in parts])
        for f in fields(Dispatch)
        if f.name != "soc"
    }
    soc = np.concatenate([parts[0].soc[:1], *(part.soc[1:] for part in parts)])
    return Dispatch(**rows, soc=soc)
