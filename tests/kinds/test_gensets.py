"""Generating sets: known answers, methods against each other, plant, a day, messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.builders import known, planned_kw, solved
from tests.support.sets import ahead, gensets, random_sets
from tests.support.small_windows import DARK, OPEN, battery, two_buses
from vppres.kinds.gensets.data import Gensets, Refuels
from vppres.kinds.gensets.physics import Engines
from vppres.model.numerics import objective_scale
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.cache import shared_cache
from vppres.solve.forms import Form, window_problem
from vppres.solve.ladder import METHODS
from vppres.solve.solvers import find_solver, run, run_conic

HALF_AN_HOUR = pd.Timedelta(minutes=30)


def plants(*cost: float, **more: Any) -> Gensets:
    """Power stations that have no tank to speak of and cost so much per MWh."""
    return gensets(
        len(cost),
        **{
            "fuel_price_gbp_per_litre": np.array(cost),
            "litres_per_kwh": 1.0,
            "litres_per_h_idle": 0.0,
            "tank_litres": 1e6,
            "fuel_level_litres": 1e6,
            "only_in_outage": False,
        }
        | more,
    )


def island(load_kw: list[float], sets: Gensets, steps_h: float = 1.0) -> Scenario:
    """One customer without grid."""
    steps = len(load_kw)
    day = two_buses([[kw] for kw in load_kw], [1.0], [DARK] * steps, r_ohm=1e-6)
    grid = TimeGrid(day.grid.start, 60.0 * steps_h, steps)
    return replace(day, grid=grid, gensets=sets)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("sets", "cost"),
    [
        (plants(20.0, 70.0, p_max_kw=[10e3, 1e3], p_min_kw=[3e3, 100.0]), 356_000.0),
        (
            plants(
                20.0,
                70.0,
                p_max_kw=[10e3, 1e3],
                p_min_kw=[1e3, 0.0],
                start_cost_gbp=[3000.0, 1000.0],
                on_before_h=[-9.0, 9.0],
            ),
            359_000.0,
        ),
    ],
)
def test_unit_commitment_costs_what_is_published(method: str, sets: Gensets, cost: float) -> None:
    """Coal, coal, coal, gas."""
    answer = solved(island([4000.0, 6000.0, 5000.0, 800.0], sets), method)
    assert answer.dispatch.served.all()
    assert answer.terms.f2 == pytest.approx(cost, abs=1.0)


@pytest.mark.parametrize("method", METHODS)
def test_least_times_on_and_off_as_published(method: str) -> None:
    more: dict[str, Any] = {"p_max_kw": [10e3, 1e3], "p_min_kw": [1e3, 100.0]}
    day = island([4000.0, 800.0, 5000.0, 3000.0], plants(20.0, 70.0, min_on_h=[0.0, 3.0], **more))
    expected = [[3900.0, 100.0], [0.0, 800.0], [4900.0, 100.0], [3000.0, 0.0]]
    assert -planned_kw(day, method) == pytest.approx(np.array(expected), abs=1e-2)
    more = {"p_max_kw": [10e3, 4e3], "p_min_kw": [3e3, 100.0], "on_before_h": [-1.0, -1.0]}
    day = island([3000.0, 800.0, 3000.0, 8000.0], plants(20.0, 70.0, min_off_h=[2.0, 0.0], **more))
    expected = [[0.0, 3000.0], [0.0, 800.0], [3000.0, 0.0], [8000.0, 0.0]]
    assert -planned_kw(day, method) == pytest.approx(np.array(expected), abs=1e-2)


REOPT = {"litres_per_kwh": 0.2889, "litres_per_h_idle": 0.0}
"""REopt's default, an efficiency of 0.322 at any load: 200 l are 692 kWh."""


@pytest.mark.parametrize(
    ("power_kw", "line", "hours"),
    [(100.0, {}, 6.06), (50.0, {}, 9.66), (30.0, {}, 12.66), (100.0, REOPT, 6.92)],
)
def test_a_tank_lasts_for_known_hours(
    power_kw: float, line: dict[str, float], hours: float
) -> None:
    day = island([power_kw] * 1300, gensets(**line), steps_h=0.01)
    engines = Engines(day)
    done = 0
    while True:
        on, given_kw = engines.possible(done, np.array([True]), np.array([power_kw]))
        if not on[0] or given_kw[0] < power_kw - 1e-6:
            break
        engines.advance(done, -given_kw, on)
        done += 1
    assert done * 0.01 == pytest.approx(hours, abs=0.011)


def test_a_battery_beside_a_set_makes_the_fuel_last_longer() -> None:
    """50 kW: at full power 6.06 h, then 273 kWh of the battery; 11.53 h instead of 9.66 h."""
    alone = solved(island([50.0] * 13, gensets()))
    assert alone.dispatch.served.sum() == 9
    day = replace(island([50.0] * 13, gensets()), batteries=battery(600.0, 100.0, 100.0))
    assert solved(day).dispatch.served.sum() == 11


@pytest.mark.parametrize("method", METHODS)
def test_a_set_follows_its_ramps_and_stops_from_any_power(method: str) -> None:
    sets = gensets(ramp_up_kw_per_h=40.0, ramp_down_kw_per_h=30.0, tank_litres=1e4)
    day = two_buses([[kw] for kw in (40.0, 80.0, 100.0, 70.0, 40.0)], [1.0], [DARK] * 5)
    assert -planned_kw(replace(day, gensets=sets), method)[:, 0] == pytest.approx(
        [40.0, 80.0, 100.0, 70.0, 40.0], abs=1e-4
    )
    back = two_buses([[40.0], [80.0], [100.0], [50.0]], [1.0], [DARK] * 3 + [OPEN])
    assert -planned_kw(replace(back, gensets=sets), method)[3, 0] == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_a_set_runs_on_after_the_outage_for_its_least_time_alone(method: str) -> None:
    day = two_buses([[50.0]] * 5, [1.0], [OPEN, DARK, OPEN, OPEN, OPEN], price=9.0)
    plan = solved(replace(day, gensets=gensets(min_on_h=3.0)), method).dispatch
    assert plan.running["gensets"][:, 0].tolist() == [False, True, True, True, False]
    always = solved(replace(day, gensets=gensets(only_in_outage=False)), method).dispatch
    assert always.running["gensets"].all()


def test_plant_and_plan_agree_on_what_random_sets_can_do() -> None:
    """What the plant makes of any wish is allowed by the window's rules, with the same fuel."""
    rng = np.random.default_rng(3)
    day = island([1000.0] * 40, gensets())
    sets = random_sets(rng, day)
    times = day.grid.times
    refuels = Refuels([sets.id[0]] * 2, [times[9] - HALF_AN_HOUR, times[20]], [150.0, 1e4])
    day = replace(day, gensets=sets, refuels=refuels)
    engines = Engines(day)
    on, power_kw, fuel_litres = [], [], []
    for t in range(40):
        wanted = rng.random(len(sets)) < 0.7
        wish_kw = sets.p_max_kw * rng.uniform(0.0, 1.2, len(sets))
        engines.advance(t, *engines.follow(t, -wish_kw, wanted, np.ones(1, dtype=bool)))
        state = engines.state
        on.append(state.on)
        power_kw.append(state.power_kw)
        fuel_litres.append(state.fuel_litres)
    free = replace(day.gensets, min_on_h=np.zeros(len(sets)))  # the plant stops when it is told
    seen = ahead(replace(day, gensets=free), 40).without_duties()
    runs, given_kw = np.array(on), np.array(power_kw)
    rules = (free, runs, day.outage, day.grid.dt_h)
    assert runs.any() and not seen.wrongly_switched(*rules).any()
    assert seen.moved_too_fast_kw(free, runs, given_kw, day.grid.dt_h).max() < 1e-6
    left = seen.fuel_litres(free, runs, given_kw, day.grid.dt_h)
    assert np.abs(left - np.array(fuel_litres)).max() < 1e-9
    assert left[9, 0] > left[8, 0] and left[20, 0] > left[19, 0]


@pytest.mark.parametrize("method", METHODS)
def test_fuel_that_is_delivered_in_time_is_planned_with(method: str) -> None:
    """25 l are one step of 50 kW; a delivery within the second step counts from the third on."""
    day = island([50.0] * 4, gensets(fuel_level_litres=25.0))
    late = day.grid.times[1] + HALF_AN_HOUR
    day = replace(day, refuels=Refuels(["g0"], [late], [40.0]))
    served = solved(day, method).dispatch.served[:, 0]
    assert served[2:].all() and served.sum() == 3


def test_interior_points_find_the_bound_of_the_largest_weights() -> None:
    """A weight of 1e6, the most of strict order: Clarabel alone calls the window unbounded."""
    day = two_buses([[90.0, 30.0]] * 6, [1e6, 1.0], [OPEN, *[DARK] * 4, OPEN], price=0.3)
    day = replace(day, batteries=battery(60.0, 20.0, 20.0, soc=0.85, count=4))
    day = replace(day, gensets=gensets(2), objective=replace(day.objective, lambda_grid=1e-9))
    site, data = Site.of(day), known(day)
    form = Form("service", "relaxed", "relaxed", 16, outer=True)
    bounds = []
    for conic in (True, False):
        problem = window_problem(shared_cache(site), data, form, conic)
        problem.fill(data)
        scale = objective_scale(site)
        spec = find_solver("highs")
        found = run_conic(problem, 60.0, scale) if conic else run(problem, spec, 0.0, 60.0, scale)
        assert found.status == "optimal"
        bounds.append(found.bound)
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-4)


def test_sets_are_switched_as_for_one_battery_and_the_dispatch_costs_as_little() -> None:
    """Four batteries alike; the whole problem finds no cheaper use of the sets."""
    day = two_buses([[90.0]] * 6, [1.0], [OPEN, DARK, DARK, DARK, DARK, OPEN], price=0.3)
    day = replace(day, batteries=battery(60.0, 20.0, 20.0, soc=0.85, count=4))
    day = replace(day, gensets=gensets(2, p_max_kw=[60.0, 80.0], start_cost_gbp=[3.0, 1.0]))
    answer, whole = (solved(day, method) for method in METHODS)
    stages = [stage.partition("[")[0] for stage in answer.stages]
    assert "switched" in stages and "aggregate" not in stages
    assert answer.dispatch.served.all() and answer.status == "optimal"
    assert answer.terms.f2 == pytest.approx(whole.terms.f2, rel=1e-3)
