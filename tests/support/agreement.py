"""The ladder beside the whole problem: both answers of a window, checked by code that is neither."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import CHECKER_TOLERANCE
from vppres.core.errors import InfeasibleError
from vppres.kinds.customer.physics import SwitchingState
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

BOUND_TOLERANCE = 1e-6
SHARP = SolveLimits(gap_rel=1e-7, gap_abs=1e-6)
"""Limits of a monolith whose optimum is known beyond the gap of the ladder."""


def both_methods(site: Site, data: WindowData) -> list[WindowSolution]:
    """The window's answers by the ladder and by the monolith."""
    return [WindowSolver(site, method).solve(data) for method in METHODS]


def largest_objective(scenario: Scenario, data: WindowData) -> float:
    """f1 with everybody served in every step."""
    return float(scenario.customers.weight.sum() * scenario.grid.dt_h * data.n_steps)


def assert_holds(
    scenario: Scenario,
    data: WindowData,
    answer: WindowSolution,
    state: SwitchingState | None = None,
) -> None:
    """The dispatch satisfies every equation, and its objective is what it says."""
    check = check_dispatch(scenario, data, answer.dispatch, state)
    assert check.worst[1] <= CHECKER_TOLERANCE, check.worst
    assert answer.objective == pytest.approx(check.objective, abs=1e-9)


def assert_sound(
    scenario: Scenario,
    data: WindowData,
    answer: WindowSolution,
    state: SwitchingState | None = None,
) -> None:
    """The dispatch satisfies every equation, its objective is what it says, its bound above it."""
    assert_holds(scenario, data, answer, state)
    assert answer.bound >= answer.objective - BOUND_TOLERANCE
    assert answer.status == "optimal"
    assert answer.gap <= SolveLimits().gap_rel
    assert answer.gap_abs <= SolveLimits().gap_abs


def assert_agree(
    scenario: Scenario,
    data: WindowData,
    answers: Sequence[WindowSolution],
    state: SwitchingState | None = None,
) -> None:
    """Objectives are equal within the gap, and no bound lies below any dispatch's objective."""
    gap = SolveLimits().absolute(largest_objective(scenario, data))
    best = max((answer.objective for answer in answers), default=0.0)
    for answer in answers:
        assert_sound(scenario, data, answer, state)
        assert answer.objective >= best - gap
        assert answer.bound >= best - BOUND_TOLERANCE


def assert_methods_agree(site: Site, data: WindowData, always: bool = True) -> None:
    """Compare both methods on a window with assets that :func:`check_dispatch` does not know.

    If it may have no dispatch, both methods say so.
    """
    answers = []
    for method in METHODS:
        try:
            answers.append(WindowSolver(site, method).solve(data))
        except InfeasibleError:
            assert not always
    if not answers:
        return
    one, other = answers
    gap = 1e-4 * max(abs(other.objective), 0.01) + 1e-6
    assert one.objective == pytest.approx(other.objective, abs=2.0 * gap)
    assert min(one.bound, other.bound) >= max(one.objective, other.objective) - gap
    for answer in answers:
        d = answer.dispatch
        assert not broken(site, data.for_service(d.served), d)


def assert_certified(site: Site, data: WindowData) -> None:
    """The ladder's answer is optimal, and neither method's bound lies below the other's answer."""
    ladder = WindowSolver(site).solve(data)
    whole = WindowSolver(site, "monolithic", limits=SHARP).solve(data)
    margin = 2e-6 * max(abs(whole.objective), 1.0)
    assert ladder.status == "optimal"
    assert ladder.bound >= whole.objective - margin
    assert whole.bound >= ladder.objective - margin
