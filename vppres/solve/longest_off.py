"""Windows whose customers may be off for so long at a time (``docs/method.md``, *Stages*).

Without the limits a window is a relaxation, and a smaller one: its steps may fall apart, and
customers of equal weight are alike. What exceeds no limit there is as good as anything within them.
"""

from __future__ import annotations

from dataclasses import replace

from vppres.core.errors import LimitError, NumericalError, SolveError
from vppres.model.data import WindowData
from vppres.solve.apart import SolveStep, better
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.result import SolveLimits, Status, WindowSolution


def solve_with_limits(
    data: WindowData, limits: SolveLimits, without: SolveStep, within: SolveStep
) -> WindowSolution:
    """Solve a window without its longest times off, and with them if the answer exceeds one.

    Raises
    ------
    SolveError
        If the window has no dispatch.
    """
    rules = data.switching
    assert rules is not None
    deadline = Deadline(limits.time_s)
    freed = replace(rules, longest_off=rules.longest_off.without_customers())
    relaxed = replace(data, switching=None if freed.idle else freed)
    try:
        free = without(relaxed, limits.at_most(HALF * limits.time_s))
    except (LimitError, NumericalError):
        # It says nothing then, and the other half of the time may be enough.
        return within(data, limits.at_most(deadline.left_s))
    beyond = rules.longest_off.cost(free.dispatch.served)
    if beyond == 0.0:
        return free
    paid = replace(
        free,
        terms=replace(free.terms, f6=free.terms.f6 + beyond),
        objective=free.objective - beyond,
        service_gap=free.service_gap + beyond,
    )
    try:
        found = within(data, limits.at_most(deadline.left_s))
    except SolveError:
        met = limits.met(paid.bound, paid.objective)
        return paid if met else replace(paid, status=Status.TIME_LIMIT)
    return better(found, paid, limits)
