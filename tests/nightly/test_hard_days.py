"""Days of the kinds that hurt, and what was mended for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from benchmarks.hard_days import KINDS, hard_day, hard_window
from tests.support.agreement import assert_agree, both_methods
from tests.support.dispatch_check import check_dispatch
from tests.support.small_windows import (
    DARK,
    OPEN,
    battery,
    two_buses,
    window,
    with_pv,
)
from vppres.control.converged import in_the_dark
from vppres.io.python_door import check_scenario
from vppres.model.numerics import objective_scale
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.cache import ModelCache
from vppres.solve.fleet.relaxation import Fleet, counts_of_alike, fleet_problem
from vppres.solve.ladder import WindowSolver
from vppres.solve.programs import search_options
from vppres.solve.result import SolveLimits, Status, WindowSolution
from vppres.solve.selection import Sheet
from vppres.solve.solvers import find_solver, run

# The days.


@pytest.mark.parametrize("kind", KINDS)
def test_days_are_sound_and_come_again_from_their_seed(kind: str) -> None:
    for seed in range(3):
        day = hard_day(kind, seed)
        again = hard_day(kind, seed)
        assert kind in day.traits
        assert 10 <= day.scenario.network.n_buses <= 120
        assert np.array_equal(day.scenario.load_kw, again.scenario.load_kw)
        assert Site.of(day.scenario).key == Site.of(again.scenario).key
        check_scenario(day.scenario)


def test_the_traits_are_there() -> None:
    assert len(hard_day("no_batteries", 0).scenario.batteries) == 0
    assert hard_day("no_power", 0).scenario.batteries.p_max_kw.max() == 1e-3
    assert len(set(hard_day("five_tiers", 0).scenario.tiers)) == 5
    limit = hard_day("varying_limit", 0).scenario.grid_limit_kw
    assert np.isfinite(limit).all()
    assert len(np.unique(limit)) > 12
    assert hard_day("quarters", 0).scenario.grid.n_steps == 192
    assert hard_day("export", 0).scenario.exports
    assert hard_day("low_voltage", 0).scenario.network.base_kv == 0.4
    assert hard_day("tight", 0).scenario.network.v_min_pu == 0.97
    peaks = np.sort(hard_day("giant", 0).scenario.load_kw.max(axis=0))
    assert peaks[-1] > peaks[:-1].sum()
    assert hard_day("small_former", 0).scenario.controller.mode == "physical"
    assert hard_day("small_former", 0).scenario.batteries.formers.sum() == 1
    assert hard_day("rules", 1).rules.active


def solve(day: Scenario) -> WindowSolution:
    return WindowSolver(Site.of(day)).solve(window(day))


# Sun that nobody can use.


def test_one_full_battery_cannot_lose_what_is_curtailed() -> None:
    """100 kW of sun, 20 kW of demand, a full battery: at once it would lose, in turns it cannot.

    Charging and discharging at once would lose power in a relaxation. In one step a full battery
    can do neither: it may not be charged, and what it discharged would be curtailed instead.
    """
    day = with_pv(
        replace(
            two_buses([[20.0]], [1.0], [DARK]),
            batteries=battery(p_max_kw=50.0, s_max_kva=50.0, soc=0.85),
        ),
        [100.0],
    )
    answer = solve(day)
    assert answer.status == Status.OPTIMAL
    assert answer.terms.f3 == pytest.approx(80.0, abs=1e-4)


@pytest.mark.parametrize("seed", [12, 22, 30, 42, 53])
def test_batteries_lose_in_turns_what_they_can(seed: int) -> None:
    """Their modes decide how much is curtailed: as the whole problem says."""
    case = random_window(seed, stressed=True)
    data = replace(case.data, pv_kw=1.5 * case.data.pv_kw)
    answers = both_methods(Site.of(case.scenario), data)
    assert any(stage.startswith("modes") for stage in answers[0].stages)
    assert_agree(case.scenario, data, answers)


def test_a_search_for_modes_knows_how_large_the_objective_is() -> None:
    """Service and lost sun nearly cancel: a gap of all service would be 50 times what is left."""
    case = hard_window("surplus", 301)
    answer = WindowSolver(case.site).solve(case.data)
    assert any(stage.startswith("modes_relaxed") for stage in answer.stages)
    assert abs(answer.objective) < 0.03 < answer.terms.f1
    assert answer.status == Status.OPTIMAL
    assert answer.gap <= 1e-4


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_polygons_of_more_sides_close_what_corners_keep_open(method: str) -> None:
    """With 16 sides the outer ones end at 7.178 and the inner ones at 7.156: neither is true."""
    case = hard_window("surplus", 302)
    answer = WindowSolver(case.site, method).solve(case.data)
    assert len([name for name in answer.stages if name.startswith("full_outer")]) == 2
    assert answer.status == Status.OPTIMAL
    assert answer.objective == pytest.approx(7.1669, abs=1e-4)
    assert check_dispatch(case.day.scenario, case.data, answer.dispatch).worst[1] < 2e-5


# What is called optimal.


def test_what_the_dark_loses_makes_the_gap_a_larger_share() -> None:
    """Two of three customer hours are lost in the dark: 2e-4 of 3 are 6e-4 of what is left."""
    day = two_buses([[10.0], [10.0], [10.0]], [1.0], [DARK, DARK, OPEN])
    site = Site.of(day)
    lit = replace(window(day), grid_limit_kw=np.full(3, OPEN))
    found = WindowSolver(site).solve(lit)
    found = replace(found, bound=found.objective + 2e-4)
    dark = np.array([False, True, True])  # a dark first step is a blackout
    assert found.status == Status.OPTIMAL
    assert found.gap == pytest.approx(2e-4 / 3.0, rel=1e-3)
    left = in_the_dark(site, window(day), dark, found, SolveLimits())
    assert left.objective == pytest.approx(1.0, abs=1e-3)
    assert left.gap == pytest.approx(2e-4, rel=1e-3)
    assert left.status == Status.GAP_OPEN
    assert in_the_dark(site, window(day), ~dark & dark, found, SolveLimits()) is found


# Batteries of no power.


@pytest.mark.parametrize("seed", [3, 28])
def test_batteries_of_no_power_are_as_good_as_the_whole_problem(seed: int) -> None:
    case = random_window(seed)
    b = case.scenario.batteries
    idle = np.full(len(b), 1e-3)
    small = replace(b, p_max_kw=idle, s_max_kva=idle, energy_kwh=1.5 * idle)
    scenario = replace(case.scenario, batteries=small)
    data = replace(case.data, grid_limit_kw=np.zeros(case.data.n_steps))
    assert_agree(scenario, data, both_methods(Site.of(scenario), data))


# Counts to branch on.


def test_counts_say_how_many_of_a_weight_are_served() -> None:
    case = hard_window("rules", 7)
    customers = case.site.customers
    first = case.data.first(3)
    problem = fleet_problem(ModelCache(case.site), first, True, integer=True, goal="weighted")
    problem.write(first)
    run(problem, find_solver("highs"), 0.0, 10.0)
    counts = problem.x[problem.at("counts")]
    weights, many = np.unique(customers.weight, return_counts=True)
    served = np.round(problem.value_of("x_served"))
    of_weight = [served[:, customers.weight == w].sum(axis=1) for w in weights[many > 1]]
    assert np.allclose(counts, np.transpose(of_weight))


def test_customers_of_different_weights_have_no_counts() -> None:
    site = hard_window("rules", 7).site
    apart = replace(site.customers, weight=1.0 + np.arange(len(site.customers)))
    other = replace(site, customers=apart)
    assert not counts_of_alike(Fleet(other, Sheet(other, 2), lumped=True))


# Sets to begin with.


def test_searches_for_sets_begin_near_the_linear_solution() -> None:
    """And find what they find without: a set is where they begin, not where they end."""
    case = hard_window("rules", 1)
    cache = ModelCache(case.site)
    problem = fleet_problem(cache, case.data, True, integer=True, goal="weighted")
    problem.write(case.data)
    x = problem.sheet.columns["x_served"]
    highs, scip = find_solver("highs"), find_solver("scip")
    asked = 1e-6, 20.0, objective_scale(case.site)
    plain = run(problem, highs, *asked)
    nobody = np.zeros(x.shape, dtype=bool)
    options = search_options(case.site, case.data)
    for solver in (highs, scip):
        found = run(problem, solver, *asked, options, nobody)
        assert found.value == pytest.approx(plain.value, abs=1e-5)


@pytest.mark.parametrize("stored", [True, False])
@pytest.mark.parametrize("ruled", [True, False])
def test_rules_and_batteries_decide_how_sets_are_searched(ruled: bool, stored: bool) -> None:
    """Sums to branch on are left to HiGHS where rules and batteries make a root take long."""
    case = hard_window("rules", 1)
    count = 3 if stored else 0
    site = Site.of(replace(case.day.scenario, batteries=battery(count=count)))
    data = case.data if ruled else replace(case.data, switching=None)
    options = search_options(site, data)
    assert options["mip_allow_restart"] is False
    assert options["mip_heuristic_run_rins"] is ruled
    assert ("presolve_rule_off" in options) is not (ruled and stored)
