"""Cooling and heat: known answers, methods against each other, plant, a day, messages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.builders import planned_kw, solved
from tests.support.homes import homes, hot
from tests.support.small_windows import DARK, OPEN
from tests.support.vans import van
from vppres import (
    RunOptions,
    run_day,
    summarise,
)
from vppres.core.arrays import Floats
from vppres.kinds.cooling.physics import Climate, Rooms, rests_at_c
from vppres.plant.plant import Plant
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.solve.ladder import METHODS

PHYSICAL = RunOptions(mode="physical", horizon_h=2.0, isolate=False)


def path_c(day: Scenario, power_kw: Floats) -> Floats:
    """Temperatures at the ends of all steps as one window."""
    rooms = Rooms.of(day, range(day.grid.n_steps), day.thermal_loads.t_initial_c)
    return rooms.t_c(power_kw)


@pytest.mark.parametrize(("begins_c", "hours"), [(24.0, 6.97), (22.0, 12.91)])
def test_a_home_without_power_is_too_warm_after_known_hours(begins_c: float, hours: float) -> None:
    day = hot([DARK] * 900, t_initial_c=begins_c)
    day = replace(day, grid=TimeGrid(day.grid.start, 1.0, 900))
    climate = Plant(day).of(Climate)
    too_warm = []
    for t in range(900):
        climate.state = climate.after_c(t, np.zeros(1))
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
    t_c = path_c(day, power_kw)[:, 0]
    assert power_kw[3:] == pytest.approx(0.0, abs=1e-9)
    assert t_c[2] == pytest.approx(36.5 - 11.5 * np.exp(2 / 40), abs=1e-4)
    assert t_c[4] == pytest.approx(25.0, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_an_outage_is_too_warm_and_feasible(method: str) -> None:
    """All that is missed without power counts a quarter of a step."""
    day = hot([DARK] * 9)
    assert solved(day, method).objective == pytest.approx(-0.25)


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
    rest, cooled = (path_c(day, np.full((2, 1), kw))[0, 0] for kw in (0.0, 2.0))
    assert 60.0 * (rest - 24.0) == pytest.approx(0.025 * (34.0 - 24.0), rel=1e-3)
    assert 60.0 * (rest - cooled) == pytest.approx(0.875, rel=1e-3)
    tight = hot([OPEN] * 4, gain_kw=0.0, r_c_per_kw=1e9)
    assert path_c(tight, np.full((4, 1), 4.57 / 4))[-1, 0] == pytest.approx(22.0, abs=1e-3)


def test_limits_of_resistance_and_capacity() -> None:
    """Without losses heat is stored like energy; an endless capacity keeps its temperature."""
    power_kw = np.array([[0.0], [1.0], [2.0]])
    stored = path_c(hot([OPEN] * 3, r_c_per_kw=1e9), power_kw)[:, 0]
    assert stored == pytest.approx(24.0 + np.cumsum(0.5 - 3.5 * power_kw[:, 0]) / 8.0, abs=1e-6)
    kept = path_c(hot([OPEN] * 3, c_kwh_per_c=1e12), power_kw)
    assert kept == pytest.approx(24.0, abs=1e-9)


def test_the_coefficient_of_performance_falls_with_heat_outside() -> None:
    loads = homes("c0", cop_per_c=-0.1)
    outside_c = np.array([[25.0], [35.0], [60.0]])
    idle_c, cooled_c = (rests_at_c(loads, outside_c, np.zeros(1), np.full(1, kw)) for kw in (0, 1))
    heat_kw = (cooled_c - idle_c) / loads.r_c_per_kw
    assert heat_kw[:, 0] == pytest.approx([-4.5, -3.5, -1.0])


@pytest.mark.parametrize("method", METHODS)
def test_a_home_that_is_off_is_not_cooled(method: str) -> None:
    day = hot([DARK, OPEN, OPEN], t_initial_c=30.0)
    power_kw = planned_kw(day, method)[:, 0]
    assert power_kw == pytest.approx([0.0, 2.0, 2.0], abs=1e-5)  # and restored, it draws the most


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
    served = run.customers["served"].to_numpy(float)
    assert (rows["p_kw"].to_numpy() <= 2.0 * served + 1e-9).all()
    figures = summarise(run)
    assert figures["thermal_loads"]["machines_kwh"] > 1.0
    assert figures["vehicles"]["charged_kwh"] > 10.0
    assert figures["thermal_loads"]["hours_above_band_by_tier"]["critical"] == 0.0
