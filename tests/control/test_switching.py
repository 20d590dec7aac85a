"""The choice of a configuration beside trying all of them, each by the monolith."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from benchmarks.cut_feeders import CASES, decided
from tests.support.switched import best_by_trying, has_loop, switched_day
from vppres import RunOptions, run_day
from vppres.control.switching import Switching
from vppres.day.assembly import make_controller
from vppres.day.configured import configurations_of
from vppres.day.simulate import Day
from vppres.scenario.configuration import Branches, blocks_of, in_configuration
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

MOVING = RunOptions(mode="paper", horizon_h=3.0, isolate=False, move_switches=True)


def assert_best(day: Scenario) -> None:
    """The plan of the first step is worth as much as that of the best configuration."""
    options = MOVING.on(day)
    decider = make_controller(day, options)
    if not isinstance(decider, Switching):  # every switch is locked
        return
    seen = Day(day, options).observe(decider, 0)
    best, _ = best_by_trying(day, options, seen)
    decision = decider.decide(seen)
    gap = SolveLimits().gap_at(best)
    search = decider.last
    assert search.best.score == pytest.approx(best, abs=2.0 * gap + 1e-6)
    assert decision.info.bound - search.best.candidate.price >= best - 1e-6
    assert decision.info.status == "optimal"


@pytest.mark.daily
@pytest.mark.parametrize("seed", [*range(20), 100])
def test_the_answer_is_the_best_of_all_configurations(seed: int) -> None:
    assert_best(switched_day(seed))


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(101, 201))
def test_the_answer_is_the_best_of_eight_switches(seed: int) -> None:
    assert_best(switched_day(seed, most=8))


@pytest.mark.daily
@pytest.mark.parametrize("mode", ["paper", "physical"])
@pytest.mark.parametrize("seed", range(8))
def test_no_loop_and_no_two_live_parts_joined(seed: int, mode: str) -> None:
    day = switched_day(seed)
    run = run_day(day, replace(MOVING, mode=mode, horizon_h=2.0))
    branches = Branches.of(day)
    closed = configurations_of(run)
    if closed is None:
        return
    assert not any(has_loop(branches, each) for each in closed)
    locked = day.switches.locked != ""
    names = np.array(branches.names)
    for each in closed:
        assert not (set(names[each != branches.closed]) & set(day.switches.id[locked]))
    v_pu = run.by_step("buses", "v_ac_pu")
    for t in range(1, len(closed)):
        before, after = closed[t - 1], closed[t]
        out = in_configuration(day, branches, before).scenario.out_of_service(range(t - 1, t))
        at = in_configuration(day, branches, before)
        carrying = before & ~np.where(at.lines >= 0, out.lines[0][at.lines], True)
        source = blocks_of(branches.ends, carrying, day.network.n_buses)
        live = np.isfinite(v_pu[t - 1])
        joined = blocks_of(branches.ends, before & after, day.network.n_buses)
        for branch in np.flatnonzero(after & ~before):
            a, b = branches.ends[branch]
            if live[a] and live[b] and joined[a] != joined[b]:
                assert source[a] == source[b]


def test_a_search_that_leaves_configurations_out_has_a_bound() -> None:
    """Most that a feeder in one piece serves holds for those that were not looked at."""
    day = switched_day(5)
    options = MOVING.on(day)
    decider = make_controller(day, options)
    assert isinstance(decider, Switching)
    seen = Day(day, options).observe(decider, 0)
    best, _ = best_by_trying(day, options, seen)
    with patch("vppres.control.candidates.MOST_TRIED", 0):
        decision = decider.decide(seen)
    assert decision.info.objective < best
    assert best - 1e-6 <= decision.info.bound < np.inf


def test_all_plans_of_a_step_share_its_time() -> None:
    day = switched_day(5)
    options = MOVING.on(day)
    decider = make_controller(day, options)
    limit_s = options.limits.time_s
    asked: list[float] = []
    solve = WindowSolver.solve

    def noted(solver: WindowSolver, data: Any, within_s: float) -> Any:
        asked.append(within_s)
        return solve(solver, data, within_s)

    with patch.object(WindowSolver, "solve", noted):
        decider.decide(Day(day, options).observe(decider, 0))
    assert asked[0] == 0.5 * limit_s
    assert len(asked) > 1
    assert all(within_s < limit_s for within_s in asked[1:])


@pytest.mark.daily
def test_switches_of_a_feeder_of_a_thousand_buses_move_with_a_bound() -> None:
    decision = decided(next(each for each in CASES if each.name == "20 switches"))
    assert decision.switched.moved == "closed tie 14-0, 27, opened 6-7"
    assert decision.info.gap < 1e-3
