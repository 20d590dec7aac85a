"""Windows whose steps nothing joins, solved one by one (``docs/method.md``, *Stages*).

Batteries carry energy, and switching rules carry duties, from one step to another. Where there is
neither, the objective is a sum over the steps, and so are the best dispatch and its bound. Solved
together, such a window is one knapsack for each step at the same time, and a search multiplies
their branches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from vppres.contract.dispatch import Dispatch
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.terms import Terms
from vppres.solve.deadline import LEAST_S, Deadline
from vppres.solve.result import SolveLimits, Status, WindowSolution

SolveStep = Callable[[WindowData, SolveLimits], WindowSolution]

SHARES = 2.0
"""Shares of the time left that a step may take: most need less than theirs."""


def falls_apart(site: Site, data: WindowData) -> bool:
    """Whether a window has several steps and nothing that joins them."""
    idle = site.batteries.idle and not data.ending
    return data.n_steps > 1 and idle and data.switching is None


def better(one: WindowSolution, other: WindowSolution, limits: SolveLimits) -> WindowSolution:
    """The better of two answers to the same window, with the bound of both and what both took.

    The gaps of service and cost are its own: those of the other are gaps to another service.
    """
    best = max(one, other, key=lambda answer: (answer.objective, -answer.service_gap))
    bound = min(one.bound, other.bound)
    met = limits.met(bound, best.objective)
    return replace(
        best,
        bound=bound,
        status=Status.OPTIMAL if met else one.status,
        solve_s=one.solve_s + other.solve_s,
        solver_s=one.solver_s + other.solver_s,
        stages=other.stages + one.stages,
    )


def solve_apart(data: WindowData, limits: SolveLimits, solve: SolveStep) -> WindowSolution:
    """Solve a window step by step.

    A step gets its share of the absolute gap and of the time left.

    Raises
    ------
    SolveError
        If a step has no dispatch.
    """
    deadline = Deadline(limits.time_s)
    parts = [data.part(slice(k, k + 1)) for k in range(data.n_steps)]
    shares = _shares(data.n_steps, limits, deadline)
    steps = [solve(part, alone) for part, alone in zip(parts, shares, strict=True)]
    found = _joined(steps, limits, deadline)
    if found.status == Status.OPTIMAL:
        return found
    closer = replace(limits, gap_abs=limits.gap_at(found.objective) / data.n_steps)
    again = [
        _closer(part, step, closer.at_most(deadline.left_s), solve)
        for part, step in zip(parts, steps, strict=True)
    ]
    return _joined(again, limits, deadline)


def _closer(
    part: WindowData, step: WindowSolution, limits: SolveLimits, solve: SolveStep
) -> WindowSolution:
    """A step's answer, sought once more where it leaves more open than its share.

    What some steps gain and others lose adds up to less than any of them is worth, and a gap that
    is small beside each may be large beside all.
    """
    if step.bound - step.objective <= limits.gap_abs or limits.time_s <= LEAST_S:
        return step
    try:
        return better(solve(part, limits), step, limits)
    except SolveError:
        return step


def _shares(n_steps: int, limits: SolveLimits, deadline: Deadline) -> Iterator[SolveLimits]:
    """Limits of each step, of the time as it is left when the step begins.

    Where earlier ones have used it up, a step has its grace for an answer.
    """
    for k in range(n_steps):
        share = min(SHARES / (n_steps - k), 1.0)
        time_s = max(share * deadline.left_s, LEAST_S)
        yield replace(limits, gap_abs=limits.gap_abs / n_steps, time_s=time_s)


def _joined(
    steps: Sequence[WindowSolution], limits: SolveLimits, deadline: Deadline
) -> WindowSolution:
    """The window of these steps: all figures are sums.

    So the gap of cost is that of sets that serve as much in each step, not in all together.
    """
    objective = sum(step.objective for step in steps)
    bound = sum(step.bound for step in steps)
    late = any(step.status == Status.TIME_LIMIT for step in steps)
    not_met = Status.TIME_LIMIT if late else Status.GAP_OPEN
    losses = [step.loss_kw for step in steps if step.loss_kw is not None]
    return WindowSolution(
        dispatch=_one_dispatch([step.dispatch for step in steps]),
        terms=Terms(
            **{f.name: sum(getattr(step.terms, f.name) for step in steps) for f in fields(Terms)}
        ),
        objective=objective,
        bound=bound,
        status=Status.OPTIMAL if limits.met(bound, objective) else not_met,
        service_gap=sum(step.service_gap for step in steps),
        cost_gap_gbp=sum(step.cost_gap_gbp for step in steps),
        solve_s=deadline.spent_s,
        solver_s=sum(step.solver_s for step in steps),
        stages=tuple(stage for step in steps for stage in step.stages),
        loss_kw=np.concatenate(losses) if losses else None,
    )


def _one_dispatch(parts: Sequence[Dispatch]) -> Dispatch:
    """The dispatches of consecutive steps as one; ``soc`` has a row more than the steps."""
    rows: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in parts[0].arrays()
        if name != "soc"
    }
    soc = np.concatenate([parts[0].soc[:1], *(part.soc[1:] for part in parts)])
    return Dispatch(**rows, soc=soc)
