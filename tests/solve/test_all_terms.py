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
    return [name for name in names if name == "aggregate"]


@pytest.mark.parametrize(("fleet", "searches"), [(ONE_FULL, 2), (BOTH_FULL, 1)])
def test_every_battery_is_searched_if_one_for_all_says_too_much(
    fleet: tuple[tuple[float, float], tuple[float, float]], searches: int
) -> None:
    assert len(stages_of(*without_grid(*fleet))) == searches


@pytest.mark.parametrize(
    ("thought", "left", "searches"),
    [
        (1.0, 0.7, 1),  # As close as it was asked for.
        (20.0, 0.3, 1),  # Asked for too little, and close enough by chance.
        (20.0, 0.7, 2),  # Certified, but what is left for tie-breakers has been used.
        (20.0, 5.0, 2),
    ],
)
def test_a_search_is_done_again_if_it_stopped_at_too_large_a_gap(
    monkeypatch: pytest.MonkeyPatch, thought: float, left: float, searches: int
) -> None:
    """Gaps in those of the plan: what was thought before it was known, what the search leaves."""
    scenario, data = without_grid(*BOTH_FULL)
    cache = shared_cache(Site.of(scenario))
    task = WindowTask(data, cache, SolveLimits(), find_solver("highs"), 16)
    true_gap = task.limits.gap_at(0.0)
    monkeypatch.setattr(WindowTask, "gap", thought * true_gap)
    asked: list[float] = []

    def search(gap: float) -> bool:
        asked.append(gap)
        keep_dispatch(task, np.zeros(data.load_kw.shape, dtype=bool))
        best = task.certificate.best
        task.certificate.bound_by(best.value + min(left * task.gap_to_best, gap))
        return True

    assert task.search_to_its_gap(0.5, search)
    assert asked == pytest.approx([0.5 * thought * true_gap, 0.5 * true_gap][:searches])
