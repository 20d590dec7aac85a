"""All terms at once without the network: which fleet is searched, and when that is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.agreement import assert_agree, both_methods
from tests.support.small_windows import DARK, battery, two_buses, window
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import shared_cache
from vppres.solve.dispatch import keep_dispatch
from vppres.solve.result import SolveLimits
from vppres.solve.solvers import find_solver
from vppres.solve.task import WindowTask

ONE_FULL = (0.85, 0.15), (6.0, 80.0)
"""States and powers in kW of two batteries, of which the strong one is empty."""
BOTH_FULL = (0.8, 0.8), (43.0, 43.0)


def without_grid(
    soc: tuple[float, float], power_kw: tuple[float, float]
) -> tuple[Scenario, WindowData]:
    """Nine customers whose weights have no grid, for three dark hours."""
    rng = np.random.default_rng(14)
    load = rng.uniform(2.0, 9.0, 9)
    scenario = two_buses([load] * 3, rng.uniform(0.1, 1.0, 9), [DARK] * 3)
    fleet = replace(battery(count=2), soc_initial=np.array(soc), p_max_kw=np.array(power_kw))
    scenario = replace(scenario, batteries=fleet)
    return scenario, window(scenario)


def stages_of(scenario: Scenario, data: WindowData) -> list[str]:
    """Stages of a window that the monolith agrees with, up to the last search."""
    answers = both_methods(Site.of(scenario), data)
    assert_agree(scenario, data, answers)
    names = [stage.partition("[")[0] for stage in answers[0].stages]
    return [name for name in names if name in ("shares", "aggregate")]


@pytest.mark.parametrize(
    ("many", "stages"),
    [
        (1, ["shares", "shares", "aggregate"]),
        (1_000, ["aggregate", "shares", "shares", "aggregate"]),
    ],
)
def test_where_one_battery_says_too_much_every_battery_is_searched(
    monkeypatch: pytest.MonkeyPatch, many: int, stages: list[str]
) -> None:
    monkeypatch.setattr("vppres.solve.fleet.all_terms.MANY", many)
    assert stages_of(*without_grid(*ONE_FULL)) == stages


@pytest.mark.parametrize(
    ("many", "stages"), [(1, ["shares", "shares", "aggregate"]), (1_000, ["aggregate"])]
)
def test_one_battery_is_enough_where_all_can_give_as_much(
    monkeypatch: pytest.MonkeyPatch, many: int, stages: list[str]
) -> None:
    monkeypatch.setattr("vppres.solve.fleet.all_terms.MANY", many)
    assert stages_of(*without_grid(*BOTH_FULL)) == stages


# How close.


@pytest.mark.parametrize(
    ("thought", "left", "searches"),
    [
        (1.0, 0.7, 1),  # As close as it was asked for.
        (20.0, 0.3, 1),  # Asked for too little, and close enough by chance.
        (20.0, 0.7, 2),  # Certified, but what is left for tie-breakers has been used.
        (20.0, 5.0, 2),
    ],
)
def test_what_a_search_leaves_is_a_share_of_the_gap_that_there_is(
    thought: float, left: float, searches: int
) -> None:
    """Gaps in those of the plan: what was thought before it was known, what the search leaves."""
    share = 0.5
    scenario, data = without_grid(*BOTH_FULL)
    cache = shared_cache(Site.of(scenario))
    task = WindowTask.begin(data, cache, SolveLimits(), find_solver("highs"), 16)
    asked: list[float] = []

    def search(gap: float) -> bool:
        asked.append(gap)
        keep_dispatch(task, np.zeros(data.load_kw.shape, dtype=bool))
        best = task.certificate.best
        assert best is not None
        task.certificate.bound_by(best.value + min(left * task.gap_to_best, gap))
        return True

    true_gap = task.limits.gap_at(0.0)
    assert task.search_to_its_gap(thought * true_gap, share, search)
    assert asked == pytest.approx([share * thought * true_gap, share * true_gap][:searches])
