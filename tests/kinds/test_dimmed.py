"""Customers that may be dimmed: hand-solved windows, methods against each other, days, messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.builders import live
from tests.support.live_service import HERE, NOON, client, decided, said, site
from tests.support.small_windows import (
    DARK,
    OPEN,
    first_step,
    full_of,
    island,
    two_buses,
    window,
    with_pv,
)
from vppres import InputError, RunOptions, explain_day, run_day, summarise
from vppres.contract.decision import Decision
from vppres.control.guard.check import violations
from vppres.day.metrics import service_by_customer
from vppres.io.digest import scenario_digest
from vppres.kinds.customer.data import SwitchingRules
from vppres.model.site import Site
from vppres.plant.plant import Plant
from vppres.report.run_folder import render_report
from vppres.scenario.priority import Ranks
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import SolveLimits


def dimmable(day: Scenario, *least: float) -> Scenario:
    """The day with the least share of each customer."""
    return replace(day, customers=replace(day.customers, share_min=least))


def dark_hours(energy_kwh: float, weights: Sequence[float], *least: float) -> Scenario:
    """Two dark hours; a battery gives this much energy to customers of 10 kW each."""
    return dimmable(island([[10.0] * len(weights)] * 2, weights, energy_kwh), *least)


# Hand-solved windows.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("energy_kwh", "least", "supplied"),
    [
        (15.0, 1.0, 1.0),  # whole hours only
        (15.0, 0.8, 1.0),  # two hours would take 16 kWh
        (15.0, 0.5, 1.5),
        (15.0, 0.0, 1.5),
        (20.5, 0.5, 2.0),
        (6.0, 0.7, 0.0),  # an hour at the least share would take 7 kWh
    ],
)
def test_energy_is_shared_down_to_the_least_share(
    method: str, energy_kwh: float, least: float, supplied: float
) -> None:
    day = dark_hours(energy_kwh, [1.0], least)
    answer = WindowSolver(Site.of(day), method).solve(window(day))
    share = answer.dispatch.supplied.astype(float)
    assert share.sum() == pytest.approx(supplied, abs=1e-4)
    assert ((share == 0.0) | (share >= least)).all()
    assert answer.objective == pytest.approx(supplied, abs=1e-3)
    assert answer.status == "optimal"


@pytest.mark.parametrize("method", METHODS)
def test_weight_per_kw_says_who_is_dimmed(method: str) -> None:
    """20 kWh for 40: the heavier has all, and what is left over goes to the lighter."""
    day = dark_hours(25.0, [1.0, 0.4], 0.1, 0.1)
    share = WindowSolver(Site.of(day), method).solve(window(day)).dispatch.supplied
    assert share.sum(axis=0) == pytest.approx([2.0, 0.5], abs=1e-4)


def test_a_surplus_of_ones_own_sun_needs_no_dimming() -> None:
    day = dimmable(with_pv(two_buses([[10.0]] * 2, [1.0], [OPEN, DARK]), [4.0, 10.0]), 0.2)
    answer = WindowSolver(Site.of(day)).solve(window(day))
    assert answer.dispatch.supplied.tolist() == [[1.0], [1.0]]
    short = replace(day, grid_limit_kw=[DARK] * 2)
    assert WindowSolver(Site.of(short)).solve(window(short)).dispatch.supplied[
        0, 0
    ] == pytest.approx(0.4, abs=1e-5)


def test_one_is_today_to_the_last_bit(tiny: Scenario) -> None:
    whole = dimmable(tiny, 1.0, 1.0, 1.0)
    assert Site.of(whole).key == Site.of(tiny).key
    assert scenario_digest(whole) == scenario_digest(tiny)


def test_many_that_may_be_dimmed_never_outweigh_a_critical_one_in_strict_order() -> None:
    """The hospital needs all of the energy, which would give 100 homes their least share."""
    homes = 100
    day = two_buses([[50.0] + [1.0] * homes], [1.0] * (1 + homes), [DARK])
    tier = np.array(["critical"] + ["low"] * homes, dtype=object)
    day = replace(
        day,
        tiers=("critical", "low"),
        batteries=full_of(51.0),
        customers=replace(day.customers, tier=tier, share_min=[1.0] + [0.0] * homes),
    )
    ranked = Site.of(day).ranked(Ranks.of(day.customers, day.tiers, 1), 1)
    answer = WindowSolver(ranked).solve(window(day))
    assert answer.dispatch.supplied[0, 0] == 1.0
    assert answer.dispatch.supplied[0, 1:].sum() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("recover_h", "limit_kw", "service"),
    [
        (np.nan, OPEN, 5.5),  # 15 kWh of 20 in the dark, then four hours with grid
        (1.0, OPEN, 6.0),
        (1.0, 12.0, 5.7),  # an hour of 2 kW besides
        (2.0, 12.0, 6.0),  # dimmed in the third hour too, and three hours of 2 kW besides or less
        (0.9, OPEN, 5.5),  # less than a step
    ],
)
def test_what_is_caught_up_counts_again(
    method: str, recover_h: float, limit_kw: float, service: float
) -> None:
    day = dark_then_open(recover_h, limit_kw)
    answer = WindowSolver(Site.of(day), method).solve(window(day))
    share = answer.dispatch.supplied.astype(float)[:, 0]
    assert share.sum() == pytest.approx(service, abs=1e-4)
    assert answer.objective == pytest.approx(service, abs=2e-2)  # less the cost of import
    assert answer.status == "optimal"


@pytest.mark.parametrize("method", METHODS)
def test_the_connection_carries_what_is_caught_up(method: str) -> None:
    """30 kW are missing of the first hour, and no battery takes more than the customers do."""
    day = two_buses([[50.0, 50.0]] * 3, [1.0, 0.1], [70.0, OPEN, OPEN])
    customers = replace(day.customers, share_min=[1.0, 0.2], recover_h=[np.nan, 2.0])
    day = replace(day, customers=customers)
    answer = WindowSolver(Site.of(day), method, limits=SolveLimits(1e-7, 1e-6)).solve(window(day))
    share = answer.dispatch.supplied.astype(float)
    assert share[0] == pytest.approx([1.0, 0.4], abs=1e-4)
    assert share[1:].sum() == pytest.approx(2.0 + 2.6, abs=1e-4)
    assert answer.objective == pytest.approx(3.3, abs=2e-2)  # less the cost of import
    assert answer.bound >= answer.objective - 1e-6


def dark_then_open(recover_h: float, limit_kw: float) -> Scenario:
    """Two dark hours with 15 of 20 kWh, and four with so much import."""
    day = two_buses([[10.0]] * 6, [1.0], [DARK] * 2 + [limit_kw] * 4)
    customers = replace(day.customers, share_min=[0.5], recover_h=[recover_h])
    return replace(day, batteries=full_of(15.0), customers=customers)


@pytest.mark.nightly
def test_what_is_owed_survives_a_restart() -> None:
    """Steps one by one know what the steps before left, and day and service agree."""
    day = dark_then_open(2.0, OPEN)
    options = RunOptions(horizon_h=2.0, isolate=False)
    run = run_day(day, options)
    whole = run.customers["share"].to_numpy()
    assert whole.sum() == pytest.approx(6.0, abs=1e-3)
    assert (whole[2:] >= 1.0).all()  # nobody is dimmed where the grid gives all
    assert summarise(run)["resilience"] == pytest.approx(0.75, abs=1e-3)
    assert summarise(run)["energy_not_supplied_kwh"] == pytest.approx(0.0, abs=1e-2)
    found = [step.customers.loc["c0", "share"] for step in live(day, [{}] * 6, options)]
    assert found == pytest.approx(whole, abs=1e-3)
    told = explain_day(run).explanations
    assert set(told.loc[told["action"].isin(["caught_up", "dimmed"]), "driver"]) == {"recovery"}


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(40))
def test_methods_agree_on_random_windows(seed: int) -> None:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 11])
    count = len(scenario.customers)
    least = np.where(rng.random(count) < 0.5, rng.choice([0.0, 0.3, 0.7], count), 1.0)
    least[rng.integers(count)] = 0.2
    recover_h = np.where((rng.random(count) < 0.5) & (least < 1.0), scenario.grid.dt_h, np.nan)
    day = dimmable(scenario, *least)
    day = replace(day, customers=replace(day.customers, recover_h=recover_h))
    assert_methods_agree(Site.of(day), data)


# The step: plant and guard.


def test_the_plant_supplies_the_share_of_the_real_demand(tiny: Scenario) -> None:
    day = dimmable(tiny, 1.0, 0.5, 0.0)
    plan = WindowSolver(Site.of(day)).solve(window(day)).dispatch
    share = np.array([1.0, 0.5, 0.0])
    plan = replace(plan, served=np.ones((6, 3), dtype=bool), share=np.tile(share, (6, 1)))
    plant = Plant(day)
    done = plant.apply(3, Decision(plan, 3), plant.initial_state())
    assert done.served.tolist() == [True, True, False]  # dimmed to nothing is off
    drawn_kw = -done.p_injection_kw[[1, 2, 3]] + [29.0, 0.0, 18.5]
    battery_kw = np.array([(done.charge_kw - done.discharge_kw)[i] for i in (0, 1)])
    curtailed = done.pv_curtailed_kw
    expected = [65.0 + battery_kw[0] + curtailed[0], 22.5, battery_kw[1] + curtailed[1]]
    assert drawn_kw == pytest.approx(expected)


def test_the_guard_refuses_less_than_the_least_share(tiny: Scenario) -> None:
    day = dimmable(tiny, 1.0, 0.5, 1.0)
    observed = first_step(day, window(day))
    plan = WindowSolver(observed.site).solve(window(day)).dispatch
    assert violations(Decision(plan), observed) == []
    below = replace(plan, share=plan.supplied * np.array([1.0, 0.4, 1.0]))
    assert "a customer is supplied in part" in violations(Decision(below), observed)


# Days.


@pytest.mark.daily
def test_a_day_counts_shares_and_says_why() -> None:
    day = dark_hours(15.0, [1.0], 0.5)
    run = explain_day(run_day(day, RunOptions(horizon_h=1.0)))
    summary = summarise(run)
    share = run.customers["share"].to_numpy()
    assert share.sum() == pytest.approx(1.5, abs=1e-4)
    assert summary["resilience"] == pytest.approx(0.75, abs=1e-4)
    assert summary["served_share"]["critical"] == pytest.approx(0.75, abs=1e-4)
    assert summary["energy_not_supplied_kwh"] == pytest.approx(5.0, abs=1e-2)
    assert summary["customer_interruptions"] == 0
    assert service_by_customer(run)["unserved_kwh"].item() == pytest.approx(5.0, abs=1e-2)
    told = run.explanations
    words = told.loc[told["action"] == "dimmed", "words"]
    assert words.str.match(r"Dimmed to \d+% of 10.0 kW.*stored energy").all() and len(words)
    page = render_report(run, summary)
    assert "c0 dimmed, to" in page and "1 of 1 customers may be dimmed" in page


def test_a_service_sends_the_share(tiny: Scenario, tmp_path: Path) -> None:
    """What is stored for an hour carries the hospital, and the shop in part."""
    day = dimmable(site(tiny), 1.0, 0.1, 1.0)
    clock = SetClock(NOON)
    with client(Service(day, HERE), tmp_path, clock) as http:
        http.put("/v1/events/storm", {"type": "outage", "start": written(NOON)})
        points = said(decided(http, clock, NOON, soc=0.5), "customers")
        dimmed: dict[str, Any] = http.get("/v1/overview").json()["plan"]["dimmed"]
        reasons = http.get("/v1/plan").json()
    assert "share" not in points["hospital"]
    # In an outage nothing is switched without a plan: the last share stays.
    assert points["shop"]["default"] == {"served": True, "share": points["shop"]["share"]}
    assert 0.1 <= points["shop"]["share"] < 1.0
    assert dimmed == {"shop": points["shop"]["share"]}
    assert reasons["setpoints"]


# Files and messages.


def test_what_cannot_be_dimmed_is_refused(tiny: Scenario) -> None:
    with pytest.raises(InputError, match=r"customer shop.*share_min.*above 0.*longest time off"):
        replace(tiny.customers, share_min=[1.0, 0.0, 1.0], max_off_h=[np.nan, 2.0, np.nan])
    with pytest.raises(InputError, match=r"customer shop.*recover_h.*not dimmed"):
        replace(tiny.customers, recover_h=[np.nan, 2.0, np.nan])
    cold = RunOptions(switching=SwitchingRules(cold_load_factor=2.0, cold_load_h=1.0))
    with pytest.raises(InputError, match=r"cold_load_factor.*may be dimmed"):
        run_day(dimmable(tiny, 1.0, 0.5, 1.0), cold)
