"""Currents of lines stay within their ratings, or the run names the line."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest

from tests.support.sets import gensets
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window
from vppres.core.units import kva_to_a
from vppres.day.metrics import cautions, line_current_a, line_loading
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.model.beyond_paper.ratings import LineRatings, with_ratings_given
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.report.findings import findings
from vppres.scenario.network import Network
from vppres.scenario.scenario import LIMIT, REPORT, SOFT, Scenario
from vppres.solve.ladder import WindowSolver

OUTAGE = (pd.Timestamp("2025-07-01T12:00Z"), pd.Timestamp("2025-07-01T16:00Z"))


def ran(day: Scenario, ratings: str, mode: str = "physical") -> Trajectory:
    return run_day(day, RunOptions(horizon_h=8.0, ratings=ratings, mode=mode))


@cache
def narrow_feeder(batteries: bool, steps: slice = slice(4, 6)) -> Scenario:
    """33 buses whose lines are rated at 85% of what the evening draws without control."""
    rules = NewScenarioOptions(
        step_minutes=240.0,
        outages=(OUTAGE,),
        add_batteries=batteries,
        pv="sized" if batteries else "none",
        draw_tiers=True,
    )
    day = new_scenario(import_network("case33bw"), rules)
    alone = run_day(day.between(4, 6), RunOptions(controller="idle"))
    most_a = line_current_a(alone).max(axis=0)
    return replace(day, network=replace(day.network, i_max_a=0.85 * most_a + 1.0)).between(
        steps.start, steps.stop
    )


@pytest.mark.nightly
@pytest.mark.parametrize("batteries", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_currents_stay_within_ratings(batteries: bool) -> None:
    day = narrow_feeder(batteries)
    assert line_loading(ran(day, REPORT)).max() > 1.0
    kept = ran(day, LIMIT)
    assert line_loading(kept).max() <= 1.0
    assert (kept.steps["fallback"] == "none").all()
    assert kept.customers["served"].mean() > 0.7
    if not kept.customers["served"].all():
        assert "Lines at their rating then: " in cautions(kept)[0]
        told = explain_day(kept).explanations
        off = told[told["action"] == "not_served"]
        by_rating = off[off["binding"] == "rating"]
        assert len(by_rating) > len(off) / 2
        assert by_rating["words"].str.contains("line from [0-9]+ to [0-9]+").all()
        assert not (off["driver"] == "unexplained").any()


def test_shadow_prices_state_the_ratings_of_lines(tiny: Scenario) -> None:
    rated = replace(tiny.network, i_max_a=np.full(tiny.network.n_lines, 100.0))
    site = Site.of(replace(tiny, network=rated))
    priced = Statement(site, 1, ((LineRatings, True),))
    assert "line_rating" in priced.families
    assert priced.own == ()  # every stage of the prices knows them


def test_ratings_give_way_by_a_share_of_what_is_beyond_them() -> None:
    """Eight customers of 4 kW behind 5 kVA, and behind it a line of 100 kVA that stays as it is."""
    day = two_buses([[4.0] * 8], [1.0] * 8, [OPEN])
    i_max_a = kva_to_a(np.array([5.0, 100.0]), 11.0)
    network = Network([1, 2], [2, 3], [0.01] * 2, [0.01] * 2, 1, base_kv=11.0, i_max_a=i_max_a)
    customers = replace(day.customers, bus=[3] * 8)
    data = window(day := replace(day, network=network, customers=customers))
    site = Site.of(day)
    free = WindowSolver(site).solve(data).dispatch
    assert free.p_flow_kw == pytest.approx(32.0, abs=1e-4)
    assert WindowSolver(replace(site, rated=True)).solve(data).dispatch.served.sum() == 1
    for share in (0.0, 0.25, 1.0):
        given = with_ratings_given(site, data, free, share).flow_max_kva
        # A thousandth of a rating is left free.
        assert given == pytest.approx(np.array([[4.995 + share * (32.0 - 4.995), 99.9]]), rel=1e-4)


@pytest.mark.parametrize(("outages", "priority", "sets"), [
    ("known", "weights", True),
    ("known", "strict", True),
    ("belief", "weights", False),
    ("belief", "strict", False),
    ("belief", "strict", True),
])  # fmt: skip
def test_ratings_limit_plans_by_belief_and_with_generating_sets(
    outages: str, priority: str, sets: bool
) -> None:
    """Three customers of 2 kW behind 5 kVA: one is off, though a set could run elsewhere."""
    day = two_buses([[2.0] * 3] * 4, [1.0, 0.9, 0.8], [OPEN, DARK, DARK, OPEN])
    i_max_a = kva_to_a(np.array([100.0, 5.0]), 11.0)
    network = Network([1, 2], [2, 3], [0.01] * 2, [0.01] * 2, 1, base_kv=11.0, i_max_a=i_max_a)
    day = replace(
        day,
        network=network,
        customers=replace(day.customers, bus=[3] * 3, tier=["critical", "high", "low"]),
        batteries=battery(40.0, 10.0, 10.0, soc=0.8),
        gensets=gensets(p_max_kw=6.0, p_min_kw=1.0) if sets else day.gensets,
    )
    run = run_day(
        day,
        RunOptions(
            horizon_h=2.0, ratings=LIMIT, mode="physical", outages=outages, priority=priority
        ),
    )
    assert line_loading(run).max() <= 1.0
    with_grid = run.customers["served"].to_numpy().reshape(4, 3)[[0, 3]]
    assert (with_grid == [True, True, False]).all()
    assert (run.steps["fallback"] == "none").all()


@pytest.mark.parametrize("mode", ["paper", "physical"])
@pytest.mark.parametrize(("soc", "most"), [(0.3, 1.0), (0.15, 1.2)])
def test_soft_ratings_give_way_to_the_feeder_itself_where_batteries_do_not_help(
    mode: str, soc: float, most: float
) -> None:
    """Three customers of 2 kW behind 5 kVA; an empty battery would charge at the low price."""
    day = two_buses([[2.0] * 3] * 4, [1.0, 0.9, 0.8], [OPEN] * 4, [0.1, 1.0, 1.0, 1.0])
    i_max_a = kva_to_a(np.array([100.0, 5.0]), 11.0)
    network = Network([1, 2], [2, 3], [0.01] * 2, [0.01] * 2, 1, base_kv=11.0, i_max_a=i_max_a)
    batteries = replace(battery(40.0, 10.0, 10.0, soc=soc), bus=[3])
    customers = replace(day.customers, bus=[3] * 3)
    run = ran(replace(day, network=network, customers=customers, batteries=batteries), SOFT, mode)
    assert run.customers["served"].all()
    assert line_loading(run).max() == pytest.approx(most, abs=2e-3)
    assert (run.steps["fallback"] == "none").all()


def test_ratings_that_bind_nothing_change_nothing() -> None:
    day = narrow_feeder(batteries=False)
    wide = replace(day, network=replace(day.network, i_max_a=1e4 * np.ones(32)))
    limited, reported = (ran(wide, ratings) for ratings in (LIMIT, REPORT))
    pd.testing.assert_frame_equal(limited.customers, reported.customers)
    pd.testing.assert_frame_equal(limited.lines, reported.lines)


def test_a_rating_that_no_dispatch_keeps_is_named() -> None:
    day = narrow_feeder(batteries=False)
    fixed = replace(
        day.network,
        drawing_bus=np.array([33], dtype=object),
        p_fixed_kw=np.array([500.0]),
        p_shunt_kw=np.zeros(1),
        q_shunt_kvar=np.zeros(1),
        q_fixed_kvar=np.zeros(1),
        island=np.ones(1, dtype=bool),
        i_max_a=np.full(32, 15.0),
    )
    run = ran(replace(day, network=fixed), LIMIT)
    assert any(words.startswith("Lines above their rating") for words in findings(run))
