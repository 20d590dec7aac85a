"""Sharing supply within a tier: weights by time off supply, turns, a minimum, and their memory."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Literal

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import vppres
from tests.support.small_windows import DARK, battery, two_buses
from vppres.day.recorder import ROTATED
from vppres.explain.day import explain_day
from vppres.scenario.assets import Customers
from vppres.scenario.fairness import Fairness, Interruption, hours_off, rotated, turns
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

TIERS = ("critical", "high", "low")
WEIGHTS = {"critical": 1.0, "high": 0.1, "low": 0.02}
HERE = vppres.RunOptions(horizon_h=1.0, priority="weights", isolate=False, guard=False)
HOUR = pd.Timedelta(hours=1)


@pytest.mark.parametrize("seed", range(20))
def test_rotation_of_single_weights_keeps_sums_and_passes_no_tier(seed: int) -> None:
    """Whoever weighed more than one of any lower tier still does."""
    rng = np.random.default_rng(seed)
    n = 8
    tier, weight = rng.choice(TIERS, n), rng.uniform(0.02, 2.0, n).round(2)
    ids = np.arange(n).astype(object)
    customers = Customers(ids, ids, tier, weight, np.full(n, 0.9))
    off_h = rng.uniform(0.0, 40.0, n) * rng.integers(0, 2, n)
    after = rotated(customers, TIERS, off_h, 0.5)
    for name in TIERS:
        assert after[tier == name].sum() == pytest.approx(weight[tier == name].sum(), rel=1e-9)
    rank = np.array([TIERS.index(name) for name in tier])
    before_all = (rank[:, None] < rank) & (weight[:, None] >= weight)
    assert (after[:, None] >= after - 1e-12)[before_all].all()


@given(
    st.lists(st.tuples(st.sampled_from(TIERS), st.integers(0, 30_000)), min_size=1, max_size=12),
    st.integers(0, 1_000),
)
def test_rotation_keeps_sums_and_the_order_of_tiers(
    drawn: list[tuple[str, int]], percent: int
) -> None:
    """Sums of tiers stay, who lost more weighs no less, and no tier overtakes another."""
    tier = np.array([name for name, _ in drawn])
    off_h = np.array([minutes / 60.0 for _, minutes in drawn])
    before = np.array([WEIGHTS[name] for name in tier])
    n = len(drawn)
    ids = np.arange(n).astype(object)
    customers = Customers(ids, ids, tier, before, np.full(n, 0.9))
    after = rotated(customers, TIERS, off_h, percent / 100.0)
    for name in TIERS:
        own = tier == name
        assert after[own].sum() == pytest.approx(before[own].sum())
        order = np.lexsort((after[own], off_h[own]))
        assert (np.diff(after[own][order]) >= -1e-12).all()
    for above, below in (("critical", "high"), ("high", "low"), ("critical", "low")):
        if (tier == above).any() and (tier == below).any():
            assert after[tier == above].min() >= after[tier == below].max() * (1.0 - 1e-9)


def test_turns_come_once_in_24_hours_of_outage() -> None:
    hours = np.arange(0.0, 24.0)
    taken = np.array([turns(5, hour, 2.0) for hour in hours])
    assert (taken.sum(axis=0) == 2).all()
    assert taken.sum(axis=1).max() == 1


def alike(day: Scenario) -> Scenario:
    """Three customers of one tier and the same demand, of which an outage carries some."""
    customers = replace(
        day.customers,
        tier=np.full(3, "low"),
        weight=np.full(3, 0.02),
        power_factor=np.full(3, 0.95),
    )
    load_kw = np.full(day.load_kw.shape, 25.0)
    return replace(day, customers=customers, load_kw=load_kw, tiers=("low",))


@pytest.mark.nightly
def test_of_customers_alike_the_one_that_lost_most_is_on(tiny: Scenario) -> None:
    start = tiny.grid.start - 10 * HOUR
    dark = tiny.grid.times[tiny.outage]
    for name in tiny.customers.id[:2]:
        lost = Interruption(start, start + 5 * HOUR, str(name))
        day = replace(alike(tiny), interruptions=(lost,))
        run = vppres.run_day(day, replace(HERE, rotation=1.0))
        on = run.customers[run.customers["time"].isin(dark)].groupby("id")["served"].sum()
        assert on[name] == on.max() > on.min()


@pytest.mark.nightly
def test_weights_change_after_each_turn(tiny: Scenario) -> None:
    """Those of the second hour of an outage follow from who was off in the first."""
    day = alike(tiny)
    for turn_h in (1.0, 2.0):
        run = vppres.run_day(day, replace(HERE, rotation=0.5, turn_h=turn_h))
        weight = run.customers[ROTATED].to_numpy().reshape(day.grid.n_steps, -1)
        off = ~run.customers["served"].to_numpy(bool).reshape(weight.shape)
        first, second, after = np.flatnonzero(day.outage)[0] + np.arange(3)
        off_h = off[first].astype(float)
        assert 0.0 < off_h.sum() < 3.0
        expected = rotated(day.customers, day.tiers, off_h if turn_h == 1.0 else 0.0 * off_h, 0.5)
        np.testing.assert_array_equal(weight[second], expected)
        both = off[first:after].sum(axis=0).astype(float)
        explained = explain_day(run).explanations
        assert len(explained[explained["action"] == "not_served"]) == off.sum()
        np.testing.assert_array_equal(weight[after], rotated(day.customers, day.tiers, both, 0.5))


def test_without_a_rule_and_with_one_that_has_no_effect_the_run_is_the_same(
    tiny: Scenario,
) -> None:
    """One customer a tier: rotation has nothing to rotate, to the last bit."""
    plain = vppres.run_day(tiny, HERE)
    shared = vppres.run_day(tiny, replace(HERE, rotation=0.5))
    for name in ("batteries", "pv"):
        pd.testing.assert_frame_equal(plain.tables[name], shared.tables[name])
    assert set(shared.customers.columns) - set(plain.customers.columns) == {ROTATED}


@pytest.mark.daily
@pytest.mark.parametrize("outages", ["known", pytest.param("belief", marks=pytest.mark.nightly)])
def test_a_minimum_takes_supply_within_its_tier_only(
    tiny: Scenario, outages: Literal["known", "belief"]
) -> None:
    """The largest would have nothing. In its turn its own tier gives way, a higher one does not."""
    dark = tiny.grid.times[tiny.outage]
    largest = tiny.customers.id[0]  # whose turn is the first
    served = {}
    for tiers in (("low", "low", "low"), ("low", "critical", "high")):
        weight = np.array([WEIGHTS[tier] for tier in tiers])
        customers = replace(tiny.customers, tier=np.array(tiers), weight=weight)
        load_kw = np.tile([60.0, 40.0, 40.0], (tiny.grid.n_steps, 1))
        day = replace(tiny, customers=customers, load_kw=load_kw)
        for hours in (0.0, 1.0):
            run = vppres.run_day(day, replace(HERE, outages=outages, minimum_on_h=hours))
            rows = run.customers[run.customers["time"].isin(dark)]
            served[tiers[1], hours] = rows.groupby("id")["served"].sum()
        assert served[tiers[1], 0.0][largest] == 0
    assert served["low", 1.0][largest] == 1
    assert served["critical", 1.0].equals(served["critical", 0.0])


def test_a_minimum_that_no_battery_can_give_blacks_nobody_out() -> None:
    """Lines with charging once made such a window one that no battery could hold."""
    day = two_buses([[200.0, 10.0]] * 2, [0.1, 1.0], [DARK, DARK])
    charged = Network([1], [2], [0.01], [0.01], slack_bus=1, base_kv=11.0, b_us=[1.0])
    day = replace(day, network=charged, batteries=battery(soc=0.8))
    sharing = vppres.RunOptions(mode="physical", priority="weights", minimum_on_h=2.0)
    run = vppres.run_day(day, sharing)
    assert set(run.steps["status"]) == {"optimal"}
    assert run.t.served.to_numpy(bool).tolist() == [[False, True]] * 2


@pytest.mark.nightly
def test_the_memory_goes_on_over_a_restart(tiny: Scenario) -> None:
    """A live controller that is restored decides as the one that went on, to the last bit."""
    options = replace(HERE, rotation=0.5, turn_h=1.0, minimum_on_h=1.0, guard=True)
    going = vppres.Controller.of(tiny, options)
    restored = vppres.Controller.of(tiny, options)
    soc = dict.fromkeys(tiny.batteries.id, 0.5)
    for t, time in enumerate(tiny.grid.times):
        limit = pd.Series(tiny.grid_limit_kw[t : t + 1], [time])
        now = vppres.Measurement(time, soc=soc, grid_limit_kw=limit)
        one, other = going.step(now), restored.step(now)
        pd.testing.assert_frame_equal(one.batteries, other.batteries)
        pd.testing.assert_frame_equal(one.customers, other.customers)
        state = json.loads(json.dumps(going.state()))
        restored = vppres.Controller.of(tiny, options, state=state)
    off_h = going.state()["now"]["memory"]["off_h"]
    assert sum(off_h) > 0.0
    with pytest.raises(vppres.InputError, match="rotation or minimum_on_h = False: was written"):
        vppres.Controller.of(tiny, replace(HERE, guard=True), state=going.state())


def test_what_is_logged_after_the_beginning_is_not_known(tiny: Scenario) -> None:
    first = tiny.grid.start
    logged = (
        Interruption(first - 2 * HOUR, first + 3 * HOUR, "homes"),
        Interruption(first + 3 * HOUR, first + 9 * HOUR, "shop"),
    )
    before = (Interruption(first - 2 * HOUR, first, "homes"),)
    weights = [
        vppres.run_day(
            replace(alike(tiny), interruptions=past), replace(HERE, rotation=0.5)
        ).customers["rotated_weight"]
        for past in (logged, before, ())
    ]
    assert weights[0].tolist() == weights[1].tolist()
    assert weights[0].tolist() != weights[2].tolist()


def test_outages_of_the_past_count_once_for_each_customer(tiny: Scenario) -> None:
    start = tiny.grid.start - 30 * HOUR
    past = [(0, 6, ""), (0, 2, "shop"), (4, 5, "shop")]
    past = [Interruption(start + a * HOUR, start + b * HOUR, who) for a, b, who in past]
    assert hours_off(past, tiny.customers.id).tolist() == [0.0, 3.0, 0.0]
    shared = replace(tiny, fairness=Fairness(rotation=0.2))
    assert vppres.RunOptions().on(shared).rotation == 0.2


def test_sharing_is_for_the_controller_that_plans_anew(tiny: Scenario) -> None:
    options = replace(HERE, controller="full-horizon", rotation=0.2)
    with pytest.raises(vppres.InputError, match="which is for the controller mpc"):
        vppres.run_day(tiny, options)
