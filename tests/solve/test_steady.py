"""An answer under switching rules where no search has found one."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hard_days import hard_window
from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import CHECKER_TOLERANCE
from vppres.solve.fleet.rungs import steady_sets
from vppres.solve.ladder import WindowSolver

SEEDS = (0, 1, 2, 3, 4, 5, 7, 8, 9)
ANSWERED = (1, 2, 4, 5, 7, 8, 9)
"""Of these, windows that have a dispatch."""


@pytest.mark.parametrize("seed", SEEDS)
def test_steady_sets_obey_the_rules(seed: int) -> None:
    case = hard_window("rules", seed)
    rules = case.data.switching
    found = list(steady_sets(case.data))
    assert len(found) == 3
    for each in found:
        assert not rules.broken(each).any()
        on, off = rules.changes(each)
        assert (on | off).sum(axis=0).max() <= 2


@pytest.mark.parametrize("seed", ANSWERED)
def test_a_window_without_a_search_is_answered(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.setattr("vppres.solve.ladder.rungs", lambda _: [])
    for name in ("worth_everyone", "worth_an_answer", "worth_the_whole"):
        monkeypatch.setattr(f"vppres.solve.ladder.{name}", lambda _: False)
    case = hard_window("rules", seed)
    answer = WindowSolver(case.site).solve(case.data)
    assert np.isinf(answer.bound)
    rules = case.data.switching
    assert not rules.broken(answer.dispatch.served).any()
    cold = case.data.for_service(answer.dispatch.served)
    worst = check_dispatch(case.day.scenario, cold, answer.dispatch).worst[1]
    assert worst < CHECKER_TOLERANCE
