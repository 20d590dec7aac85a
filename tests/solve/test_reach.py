"""Whether everyone can be served, before anything is solved; random windows: test_windows.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_windows import DARK, OPEN, battery, two_buses, window, with_pv
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.fleet.reach import everyone_in_reach
from vppres.solve.ladder import WindowSolver


def one_hour_then_dark(load_kw: float, soc: float) -> Scenario:
    """A connected hour and a dark one; the battery holds 70 kWh and gives 50 kW."""
    day = two_buses([[10.0], [load_kw]], [1.0], [OPEN, DARK])
    return replace(day, batteries=battery(soc=soc))


@pytest.mark.parametrize(
    ("load_kw", "soc", "within"),
    [
        (49.9, 0.85, True),
        (50.1, 0.85, False),  # more than its power
        # From empty, an hour at 50 kW stores 47.5 kWh, of which 45.125 kWh come back.
        (45.1, 0.15, True),
        (45.2, 0.15, False),
    ],
)
def test_reach_is_that_of_power_and_energy(load_kw: float, soc: float, within: bool) -> None:
    scenario = one_hour_then_dark(load_kw, soc)
    data = window(scenario)
    assert everyone_in_reach(Site.of(scenario), data) is within
    answer = WindowSolver(Site.of(scenario)).solve(data)
    assert answer.dispatch.served.all() == within


def test_everyone_in_an_outage_is_served_without_a_search() -> None:
    scenario = one_hour_then_dark(40.0, 0.5)
    answer = WindowSolver(Site.of(scenario)).solve(window(scenario))
    assert answer.stages == ("cost[highs]", "tie_breakers[clarabel]")
    assert answer.gap < 1e-6


def test_nothing_stored_and_nothing_given_reaches_nobody() -> None:
    day = two_buses([[10.0], [5.0]], [1.0], [OPEN, DARK])
    assert not everyone_in_reach(Site.of(day), window(day))
    lit = replace(day, grid_limit_kw=np.array([OPEN, 5.0]))
    assert everyone_in_reach(Site.of(lit), window(lit))
    sunny = with_pv(day, [0.0, 5.0])
    assert everyone_in_reach(Site.of(sunny), window(sunny))
