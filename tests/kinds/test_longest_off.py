"""Longest times off: hand-solved windows, methods against each other, days, restarts, messages."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_rules, random_window
from tests.support.agreement import assert_methods_agree
from tests.support.builders import HERE, live
from tests.support.small_windows import OPEN, first_step, island, two_buses, window
from vppres import RunOptions, explain_day, run_day, summarise
from vppres.control.planner import levels_of
from vppres.control.rules import rule_dispatch
from vppres.day import priority
from vppres.kinds.customer.data import SwitchingRules
from vppres.kinds.customer.physics import SwitchingState
from vppres.model.beyond_paper.table import beyond_paper
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.report.run_folder import render_report
from vppres.scenario.priority import Ranks
from vppres.scenario.remarks import remarks
from vppres.scenario.scenario import Scenario
from vppres.solve.apart import better
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import SolveLimits

NEVER = float("inf")


def dark_hours(
    load_kw: Sequence[float],
    weights: Sequence[float],
    energy_kwh: float,
    longest_h: Sequence[float],
    hours: int = 4,
) -> Scenario:
    """A dark feeder whose battery can give this much energy at its terminals, and any power."""
    day = island([load_kw] * hours, weights, energy_kwh)
    return replace(day, customers=replace(day.customers, max_off_h=longest_h))


def with_limits(day: Scenario, data: WindowData, state: SwitchingState) -> WindowData:
    """A window with the limits of its customers, at their prices."""
    rules = state.window(data.n_steps).priced(Site.of(day).hour_beyond, day.grid.dt_h)
    return replace(data, switching=None if rules.idle else rules)


def state_of(day: Scenario, off_h: Sequence[float]) -> SwitchingState:
    """Customers that have been off for some hours, on supply for 0."""
    start = SwitchingState.of(SwitchingRules(), day.customers, day.grid.dt_h)
    off = np.array(off_h)
    return replace(start, served=off == 0.0, since_h=np.where(off > 0.0, off, NEVER))


# Hand-solved windows.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("energy_kwh", "longest_h", "off_h", "hours_on", "beyond"),
    [
        (41.0, np.nan, 0.0, (4, 0), 0),  # without a limit the first is on throughout
        (41.0, 2.0, 0.0, (3, 1), 0),  # one hour of the middle two is the second one's
        (41.0, 1.0, 0.0, (2, 2), 0),
        (41.0, 0.0, 0.0, (0, 4), 0),  # never off: an hour of it weighs 0.5, an hour beyond 1
        (0.0, 2.0, 0.0, (0, 0), 2),  # nothing to serve with: broken by the least
        (0.0, 2.0, 1.0, (0, 0), 3),  # and an hour before the window counts
        (11.0, 1.0, 1.0, (0, 1), 2),  # now: then the second hour is within the limit too
    ],
)
def test_limit_is_kept_or_broken_by_the_least(
    method: str,
    energy_kwh: float,
    longest_h: float,
    off_h: float,
    hours_on: tuple[int, int],
    beyond: int,
) -> None:
    """Two customers of 10 kW and the weights 1 and 0.5: an hour beyond costs 2 x 0.5."""
    day = dark_hours([10.0, 10.0], [1.0, 0.5], energy_kwh, [np.nan, longest_h])
    data = with_limits(day, window(day), state_of(day, [0.0, off_h]))
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert tuple(answer.dispatch.served.sum(axis=0)) == hours_on
    assert answer.terms.f6 == pytest.approx(1.0 * beyond)
    assert answer.objective == pytest.approx(hours_on @ np.array([1.0, 0.5]) - beyond, abs=1e-3)
    assert answer.status == "optimal"


def test_a_due_customer_is_served_at_once() -> None:
    day = dark_hours([10.0, 10.0], [1.0, 0.5], 41.0, [np.nan, 2.0])
    data = with_limits(day, window(day), state_of(day, [0.0, 2.0]))
    served = WindowSolver(Site.of(day)).solve(data).dispatch.served
    assert served[0].tolist() == [False, True]


def test_steps_without_batteries_are_joined_where_a_limit_says_something() -> None:
    day = two_buses([[10.0, 10.0]] * 3, [1.0, 0.9], [10.0] * 3)
    limited = replace(day, customers=replace(day.customers, own_backup_h=[np.nan, 1.0]))
    data = with_limits(limited, window(limited), state_of(limited, [0.0, 0.0]))
    answer = WindowSolver(Site.of(limited)).solve(data)
    assert answer.dispatch.served[:, 1].tolist() == [False, True, False]
    assert answer.status == "optimal"


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(40))
def test_methods_agree_on_random_windows(seed: int) -> None:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 9])
    count, dt_h = len(scenario.customers), scenario.grid.dt_h
    longest_h = np.where(rng.random(count) < 0.6, dt_h * rng.integers(0, 3, count), np.nan)
    scenario = replace(scenario, customers=replace(scenario.customers, max_off_h=longest_h))
    served = rng.random(count) < 0.5
    state = SwitchingState(
        random_rules(seed) if seed > 2 else SwitchingRules(),
        dt_h,
        served,
        np.where(served, np.inf, dt_h * rng.integers(1, 4, count)),
        np.zeros(count),
        longest_off_h=scenario.customers.longest_off_h,
    )
    data = with_limits(scenario, data, state)
    # Duties that the past leaves may have no answer.
    assert_methods_agree(Site.of(scenario), data, always=False)


def test_the_better_of_two_answers_keeps_the_gap_of_its_own_service() -> None:
    day = dark_hours([10.0, 10.0], [1.0, 0.5], 41.0, [np.nan, np.nan])
    most = replace(WindowSolver(Site.of(day)).solve(window(day)), service_gap=0.0)
    less = replace(most, objective=most.objective + 0.1, service_gap=0.5)
    again = replace(most, service_gap=0.2)
    limits = SolveLimits()
    assert better(most, less, limits).service_gap == better(less, most, limits).service_gap == 0.5
    assert better(most, again, limits).service_gap == better(again, most, limits).service_gap == 0.0


# The tiers come first.


def hospital_and_homes(homes: int) -> Scenario:
    """Two dark hours; homes that may not be off want what the hospital needs for one of them."""
    day = dark_hours(
        [float(homes)] + [1.0] * homes,
        [1.0] + [0.9] * homes,
        homes + 1.0,
        [np.nan] + [0.0] * homes,
        hours=2,
    )
    tier = np.array(["critical"] + ["low"] * homes, dtype=object)
    return replace(day, tiers=("critical", "low"), customers=replace(day.customers, tier=tier))


@pytest.mark.nightly
def test_no_limit_of_lower_tiers_outweighs_a_unit_of_a_higher_one() -> None:
    day = hospital_and_homes(40)
    state = state_of(day, [0.0] + [3.0] * 40)
    rules = state.window(2)
    for site, hours in (
        (priority.site_of(day, RunOptions(priority="strict", horizon_h=2.0).as_record()), 1),
        (Site.of(day), 0),
    ):
        priced = replace(window(day), switching=rules.priced(site.hour_beyond, site.dt_h))
        assert WindowSolver(site).solve(priced).dispatch.served[:, 0].sum() == hours


@pytest.mark.parametrize(("homes", "steps"), [(40, 24), (1000, 24), (1000, 96)])
def test_all_that_lower_tiers_may_pay_is_less_than_a_unit(homes: int, steps: int) -> None:
    """By construction: a thousand homes beyond their limits against a hospital."""
    day = hospital_and_homes(homes)
    ranks = Ranks.of(day.customers, day.tiers, steps)
    site = Site.of(day).ranked(ranks, steps)
    assert ranks.weight[0] > steps * site.hour_off[1:].sum()
    assert site.hour_beyond[1] == min(homes, (1e6 - 1 - homes * steps) // (homes * steps))


def test_a_rule_serves_the_due_customer_of_a_tier_first() -> None:
    day = dark_hours([10.0, 10.0], [1.0, 0.9], 11.0, [np.nan, 2.0])
    for off_h, served in ((1.0, [True, False]), (2.0, [False, True])):
        state = replace(first_step(day, window(day)), due=state_of(day, [0.0, off_h]).due)
        assert rule_dispatch(state, day.tiers).served[0].tolist() == served


# Days.


def six_hours(longest_h: float, backup: bool = False, energy_kwh: float = 61.0) -> Scenario:
    """Six dark hours; the battery carries one of two customers at a time."""
    day = dark_hours([10.0, 10.0], [1.0, 0.5], energy_kwh, [np.nan, longest_h], hours=6)
    day = replace(day, batteries=replace(day.batteries, p_max_kw=[11.0]))
    if backup:
        limits = replace(day.customers, max_off_h=[np.nan] * 2, own_backup_h=[np.nan, longest_h])
        day = replace(day, customers=limits)
    return day


@pytest.mark.nightly
def test_a_day_keeps_the_limit_and_says_why_the_customer_is_on() -> None:
    run = explain_day(run_day(six_hours(2.0, backup=True), RunOptions(horizon_h=1.0)))
    served = run.customers["served"].to_numpy(bool).reshape(6, 2)
    assert served[:, 1].tolist() == [False, False, True] * 2
    summary = summarise(run)
    assert summary["off_too_long"] == []
    assert not any("longest time off" in words for words in summary["cautions"])
    told = run.explanations
    restored = told[told["action"] == "restored"]
    assert restored[["id", "driver"]].to_numpy().tolist() == [["c1", "longest_off"]] * 2
    assert restored["words"].iloc[0] == "On at 02:00: its backup of 2 h ends."
    assert "On at 02:00: its backup of 2 h ends." in render_report(run, summary)


@pytest.mark.nightly
def test_a_limit_that_cannot_be_kept_is_named() -> None:
    run = explain_day(run_day(six_hours(2.0, energy_kwh=0.0), RunOptions(horizon_h=1.0)))
    summary = summarise(run)
    assert summary["off_too_long"] == [
        {"customer": "c1", "from": "2022-07-19T00:00:00Z", "off_h": 6.0, "limit_h": 2.0}
    ]
    assert "Off beyond the longest time off: c1 (critical) 6 h of 2 h." in summary["cautions"]
    told = run.explanations
    words = told.loc[told["id"] == "c1", "words"].tolist()
    assert words[2].endswith("It is 1 h beyond its longest time off of 2 h.")


@pytest.mark.nightly
def test_since_when_a_customer_is_off_survives_a_restart() -> None:
    steps = live(six_hours(2.0), [{}] * 6, replace(HERE, horizon_h=1.0))
    assert [bool(step.customers["served"]["c1"]) for step in steps] == [False, False, True] * 2


# Files.


def test_without_limits_nothing_is_added() -> None:
    day = two_buses([[10.0]], [1.0], [OPEN])
    assert not SwitchingState.of(SwitchingRules(), day.customers, 1.0).matters
    assert beyond_paper(Site.of(day), window(day)) == ()
    assert Site.of(day).hour_off.tolist() == [1.0]


def test_a_limit_shorter_than_a_step_is_told() -> None:
    day = six_hours(0.5)
    assert "The longest time off of c1 is shorter than a step of 1 h" in remarks(day)[0]
    assert not remarks(six_hours(0.0)) and not remarks(six_hours(2.0))


def test_bounds_of_the_levels_hold_for_every_schedule() -> None:
    """All schedules of three customers in two steps, each with its dispatch or without."""
    day = dark_hours([30.0, 10.0, 10.0], [1.0, 0.4, 0.4], 41.0, [np.nan, 0.0, np.nan], hours=2)
    tier = np.array(["critical", "low", "low"], dtype=object)
    day = replace(day, tiers=("critical", "low"), customers=replace(day.customers, tier=tier))
    site = priority.site_of(day, RunOptions(priority="strict", horizon_h=2.0).as_record())
    rules = state_of(day, [0.0, 0.0, 0.0]).window(2).priced(site.hour_beyond, site.dt_h)
    data = replace(window(day), switching=rules)
    solver = WindowSolver(site)
    plan = solver.solve(data)
    pairs = [part.split()[1].split("/") for part in levels_of(site, plan).split(", ")]
    supplied, most = np.array(pairs, dtype=int).T
    dispatched = 0
    for service in itertools.product([False, True], repeat=6):
        served = np.reshape(service, (2, 3))
        if rules.price(served) > plan.terms.f6 or solver.solve_served(data, served) is None:
            continue
        dispatched += 1
        units = site.ranks.supplied(served)
        assert tuple(units) <= tuple(supplied)
        assert units[0] <= most[0]
        assert units[1] <= most[1] or units[0] != supplied[0]
    assert dispatched > 3
