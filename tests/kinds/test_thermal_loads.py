"""Cooling and heat: known answers, methods against each other, plant, a day, messages."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmarks.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.homes import homes, hot, with_random_homes
from tests.support.small_windows import DARK, OPEN, first_step, two_buses, window
from tests.support.vans import van
from vppres import (
    InputError,
    RunOptions,
    explain_day,
    run_day,
    summarise,
)
from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import Decision
from vppres.control.guard.check import violations
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.kinds.cooling.physics import Climate, Rooms
from vppres.kinds.cooling.record import cautions
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.violations import broken
from vppres.plant.plant import Plant
from vppres.report.events import events_of
from vppres.scenario.rules import SwitchingRules
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.ladder import METHODS, WindowSolver

PHYSICAL = RunOptions(mode="physical", horizon_h=2.0, isolate=False)


def known(day: Scenario) -> WindowData:
    """All steps as one window."""
    return replace(window(day), ahead=KindsAhead({"thermal_loads": rooms_of(day)}))


def rooms_of(day: Scenario) -> Rooms:
    """All steps as one window of rooms."""
    rooms = Rooms.of(day, range(day.grid.n_steps), day.thermal_loads.t_initial_c)
    assert rooms is not None
    return rooms


def planned_kw(day: Scenario, method: str) -> np.ndarray[Any, Any]:
    """Power of the machines in the plan, whose answer breaks nothing."""
    answer = WindowSolver(Site.of(day), method).solve(known(day))
    assert answer.status == "optimal"
    assert not broken(Site.of(day), known(day), answer.dispatch)
    return answer.dispatch.taken_kw["thermal_loads"]


@pytest.mark.parametrize(("begins_c", "hours"), [(24.0, 6.97), (22.0, 12.91)])
def test_a_home_without_power_is_too_warm_after_known_hours(begins_c: float, hours: float) -> None:
    day = hot([DARK] * 900, t_initial_c=begins_c)
    day = replace(day, grid=TimeGrid(day.grid.start, 1.0, 900))
    climate = Plant(day).of(Climate)
    too_warm = []
    for t in range(900):
        climate.advance(t, np.zeros(1))
        too_warm.append(climate.state[0] > 26.0)
    assert (np.argmax(too_warm) + 1) / 60.0 == pytest.approx(hours, abs=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_holding_24_degrees_takes_0_714_kw(method: str) -> None:
    day = hot([OPEN] * 5, t_max_c=24.0)
    assert planned_kw(day, method)[:, 0] == pytest.approx(2.5 / 3.5, abs=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_home_is_cooled_before_an_outage_that_is_known(method: str) -> None:
    """Two hours at 25 °C need 1.19 K less before: (1 - exp(-2 / 40)) of 36.5 - T."""
    day = hot([OPEN] * 3 + [DARK] * 2, t_max_c=25.0)
    power_kw = planned_kw(day, method)
    t_c = rooms_of(day).t_c(power_kw)[:, 0]
    assert power_kw[3:] == pytest.approx(0.0, abs=1e-9)
    assert t_c[2] == pytest.approx(36.5 - 11.5 * np.exp(2 / 40), abs=1e-4)
    assert t_c[4] == pytest.approx(25.0, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_an_outage_is_too_warm_and_feasible(method: str) -> None:
    """All that is missed without power counts a quarter of a step."""
    day = hot([DARK] * 9)
    answer = WindowSolver(Site.of(day), method).solve(known(day))
    assert answer.status == "optimal"
    assert answer.objective == pytest.approx(-0.25)


@pytest.mark.parametrize("method", METHODS)
def test_a_tank_is_heated_with_the_other_sign(method: str) -> None:
    """A tank in a cellar of 15 °C that loses 1 kW to the tap holds 50 °C with 1.7 / 2.5 kW."""
    tank = {"heats": True, "cop": 2.5, "r_c_per_kw": 50.0, "c_kwh_per_c": 0.3, "around_c": 15.0}
    band = {"t_min_c": 50.0, "t_max_c": 60.0, "t_initial_c": 50.0, "gain_kw": -1.0}
    power_kw = planned_kw(hot([OPEN] * 4, **tank, **band), method)
    assert power_kw[:, 0] == pytest.approx(1.7 / 2.5, abs=1e-5)


def test_a_home_in_the_terms_of_others() -> None:
    """EMHASS: it cools by 0.875 K/h at 2 kW, and nears 34 °C by 0.025 of the distance an hour.

    Two degrees less are 4.57 kWh of electricity.
    """
    day = hot([OPEN] * 2, gain_kw=0.0)
    day = replace(day, grid=TimeGrid(day.grid.start, 1.0, 2))
    rest, cooled = (rooms_of(day).t_c(np.full((2, 1), kw))[0, 0] for kw in (0.0, 2.0))
    assert 60.0 * (rest - 24.0) == pytest.approx(0.025 * (34.0 - 24.0), rel=1e-3)
    assert 60.0 * (rest - cooled) == pytest.approx(0.875, rel=1e-3)
    tight = hot([OPEN] * 4, gain_kw=0.0, r_c_per_kw=1e9)
    assert rooms_of(tight).t_c(np.full((4, 1), 4.57 / 4))[-1, 0] == pytest.approx(22.0, abs=1e-3)


def test_limits_of_resistance_and_capacity() -> None:
    """Without losses heat is stored like energy; an endless capacity keeps its temperature."""
    power_kw = np.array([[0.0], [1.0], [2.0]])
    stored = rooms_of(hot([OPEN] * 3, r_c_per_kw=1e9)).t_c(power_kw)[:, 0]
    assert stored == pytest.approx(24.0 + np.cumsum(0.5 - 3.5 * power_kw[:, 0]) / 8.0, abs=1e-6)
    kept = rooms_of(hot([OPEN] * 3, c_kwh_per_c=1e12)).t_c(power_kw)
    assert kept == pytest.approx(24.0, abs=1e-9)


def test_the_coefficient_of_performance_falls_with_heat_outside() -> None:
    loads = homes("c0", cop_per_c=-0.1)
    outside_c = np.array([[25.0], [35.0], [60.0]])
    assert loads.heat_per_kw(outside_c)[:, 0] == pytest.approx([-4.5, -3.5, -1.0])


def test_plant_and_plan_agree_and_who_is_off_warms_up() -> None:
    rng = np.random.default_rng(4)
    steps = 24
    day = two_buses([[1.0, 1.0]] * steps, [1.0, 1.0], [OPEN] * steps)
    day = replace(
        day,
        temperature_c=rng.uniform(10.0, 40.0, steps),
        thermal_loads=homes("c0", "c1", "c1", cop_per_c=-0.05, heats=[False, True, False]),
    )
    served = rng.random((steps, 2)) < 0.6
    climate = Plant(day).of(Climate)
    done_kw, t_c = [], []
    for t in range(steps):
        done_kw.append(climate.possible_kw(rng.uniform(-0.5, 3.0, 3), served[t]))
        climate.advance(t, done_kw[-1])
        t_c.append(climate.state)
    off = ~served[:, [0, 1, 1]]
    assert np.array(done_kw)[off].max() == 0.0
    assert np.abs(rooms_of(day).t_c(np.array(done_kw)) - np.array(t_c)).max() < 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_a_home_that_is_off_is_not_cooled(method: str) -> None:
    day = hot([DARK, OPEN, OPEN], t_initial_c=30.0)
    power_kw = planned_kw(day, method)[:, 0]
    assert power_kw == pytest.approx([0.0, 2.0, 2.0], abs=1e-5)  # and restored, it draws the most


def test_a_hundred_hot_homes_never_outweigh_one_customer() -> None:
    day = two_buses([[20.0, 0.01]] * 3, [1.0, 1000.0], [20.01] * 3)
    loads = homes(*["c1"] * 100, t_initial_c=40.0)
    day = replace(day, temperature_c=np.full(3, 45.0), thermal_loads=loads)
    answer = WindowSolver(Site.of(day)).solve(known(day))
    assert answer.dispatch.served.all()


@pytest.mark.monolith
@pytest.mark.parametrize("seed", range(40))
def test_methods_agree_on_random_windows(seed: int) -> None:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    day = with_random_homes(scenario, np.random.default_rng([seed, 42]))
    data = replace(data, ahead=KindsAhead({"thermal_loads": rooms_of(day)}))
    assert_methods_agree(Site.of(day), data)


def test_the_guard_refuses_a_machine_of_a_customer_that_is_off() -> None:
    day = hot([OPEN, OPEN], t_max_c=24.0)
    data = known(day)
    plan = WindowSolver(Site.of(day)).solve(data).dispatch
    state = replace(first_step(day, data), ahead=data.ahead)
    assert not violations(Decision(plan), state)
    too_much = plan.acting("thermal_loads", np.full((2, 1), 2.5))
    assert any("thermal load power" in each for each in violations(Decision(too_much), state))
    off = replace(plan, served=np.zeros_like(plan.served))
    assert any("thermal load power" in each for each in violations(Decision(off), state))


@pytest.mark.nightly
def test_a_day_tells_of_cooling_ahead(tmp_path: Path) -> None:
    """What is planned happens, is recorded, counted and explained, and its files are read again."""
    day = hot([OPEN] * 4 + [DARK] * 5 + [OPEN] * 3, t_max_c=25.0)
    run = run_day(day, RunOptions(isolate=False))
    rows = run.thermal_loads
    assert rows is not None
    t_c = rows["t_end_c"].to_numpy()
    assert t_c[3] < 24.0 and rows["p_kw"].to_numpy()[4:9].max() == 0.0
    assert rows["t_start_c"].to_numpy()[1:] == pytest.approx(t_c[:-1], abs=0.0)
    figures = summarise(run)["thermal_loads"]
    assert figures["missed_k_h"] == pytest.approx(np.maximum(t_c - 25.0, 0.0).sum(), abs=1e-4)
    assert cautions(run)[0].startswith("1 of 1 room or tank outside the comfort band, for ")
    explanations = explain_day(run).explanations
    assert explanations is not None
    words = explanations[explanations["action"] == "prepared"]["words"].tolist()
    assert words[-1] == f"Cooled to {t_c[3]:.1f} °C because the grid goes at 04:00."
    left = int(np.argmax(t_c > 25.0 + 1e-6))
    comfort = [event for event in events_of(run) if "comfort" in event.words]
    assert [event.words for event in comfort] == [
        f"1 room or tank leaves its comfort band: h0 ({t_c[left]:.1f} °C)."
    ]
    assert comfort[0].t == left + 1
    write_scenario(day, tmp_path / "day")
    again = read_scenario(tmp_path / "day")
    assert scenario_digest(again) == scenario_digest(day)
    assert scenario_digest(replace(day, thermal_loads=homes())) != scenario_digest(day)
    folder = tmp_path / "day" / "thermal_loads.csv"
    table = pd.read_csv(folder)
    table["t_min_c"] = 30.0
    table.to_csv(folder, index=False)
    with pytest.raises(InputError, match=r"thermal_loads.csv.*t_min_c.*not below t_max_c"):
        read_scenario(tmp_path / "day")


@pytest.mark.nightly
def test_rooms_beside_vehicles_switch_nobody_off_in_an_island(tiny: Scenario) -> None:
    """Physical mode: the same customers are on as without them, and what is off does not cool."""
    alone = run_day(tiny, PHYSICAL)
    charger, vehicle = van(tiny.grid.start, tiny.grid.end)
    rooms = homes("hospital", "shop", "homes", t_initial_c=26.5)
    cheap = replace(tiny.objective, lambda_grid=1e-7)
    day = replace(tiny, thermal_loads=rooms, chargers=charger, sessions=vehicle, objective=cheap)
    run = run_day(day, PHYSICAL)
    assert (run.customers["served"] == alone.customers["served"]).all()
    rows = run.thermal_loads
    assert rows is not None
    served = run.customers["served"].to_numpy(float)
    assert (rows["p_kw"].to_numpy() <= 2.0 * served + 1e-9).all()
    figures = summarise(run)
    assert figures["thermal_loads"]["machines_kwh"] > 1.0
    assert figures["vehicles"]["charged_kwh"] > 10.0
    assert figures["thermal_loads"]["hours_above_band_by_tier"]["critical"] == 0.0


def test_what_is_not_stated_is_refused_by_name() -> None:
    day = hot([OPEN] * 3)
    parts = replace(day, customers=replace(day.customers, shed_steps=[2]))
    with pytest.raises(InputError, match="shed_steps"):
        run_day(parts, RunOptions(isolate=False))
    with pytest.raises(InputError, match="plans no thermal loads"):
        run_day(day, RunOptions(controller="idle", isolate=False))
    day = hot([OPEN] * 12)
    dear = replace(day, objective=replace(day.objective, lambda_grid=1.0))
    with pytest.raises(InputError, match=r"lambda_grid.*energy dearer.*comfort of 1 rooms"):
        run_day(dear, RunOptions(isolate=False))
    cold = SwitchingRules(cold_load_factor=2.0, cold_load_h=1.0)
    with pytest.raises(InputError, match="twice"):
        run_day(day, RunOptions(isolate=False, switching=cold))
