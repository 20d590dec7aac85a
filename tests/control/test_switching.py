"""The choice of a configuration beside trying all of them, each by the monolith."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.switched import best_by_trying, has_loop, switched_day
from vppres import RunOptions, run_day
from vppres.control.switching import Switching
from vppres.day.assembly import make_controller
from vppres.day.configured import configurations_of
from vppres.day.simulate import Day
from vppres.scenario.configuration import Branches, blocks_of, in_configuration
from vppres.solve.result import SolveLimits

MOVING = RunOptions(mode="paper", horizon_h=3.0, isolate=False, move_switches=True)


def assert_best(seed: int) -> None:
    """The plan of the first step is worth as much as that of the best configuration."""
    day = switched_day(seed)
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
    assert_best(seed)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(101, 201))
def test_the_answer_is_the_best_of_all_configurations_of_a_hundred(seed: int) -> None:
    assert_best(seed)


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
        assert source is not None
        live = np.isfinite(v_pu[t - 1])
        joined = blocks_of(branches.ends, before & after, day.network.n_buses)
        assert joined is not None
        for branch in np.flatnonzero(after & ~before):
            a, b = branches.ends[branch]
            if live[a] and live[b] and joined[a] != joined[b]:
                assert source[a] == source[b]
