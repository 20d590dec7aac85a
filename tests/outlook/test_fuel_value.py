"""Fuel that is valued together with batteries: by hand, against the monolith, in a day."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import assert_methods_agree
from tests.support.sets import ahead, gensets, random_sets
from tests.support.small_windows import DARK, battery, two_buses, window
from vppres.contract.ahead import KindsAhead
from vppres.contract.stored_value import PIECES, StoredValue
from vppres.core.arrays import Floats
from vppres.model.site import Site
from vppres.outlook.belief import OutageBelief
from vppres.outlook.value import Ahead, EquivalentBattery, stored_value
from vppres.solve.ladder import METHODS, WindowSolver

KWH_PER_LITRE = 4.0
LASTS = OutageBelief(np.empty((0, 4)), [[0.0] * 5 + [1.0]], 0.0, out=True)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("per_kwh", "served"), [(0.01, [1, 1]), (0.03, [1, 0]), (0.1, [0, 0])])
def test_service_is_given_up_to_keep_fuel_by_hand(
    method: str, per_kwh: float, served: list[int]
) -> None:
    """5 l serve a customer and stand for 21.1 stored kWh: .057 and .019 a stored kWh."""
    day = two_buses([[20.0, 20.0]], [1.2, 0.4], [DARK])
    sets = gensets(
        p_max_kw=40.0,
        p_min_kw=0.0,
        litres_per_kwh=1.0 / KWH_PER_LITRE,
        litres_per_h_idle=0.0,
        fuel_level_litres=15.0,
        fuel_price_gbp_per_litre=0.0,
    )
    day = replace(day, gensets=sets, batteries=battery(soc=0.15))
    energy = np.linspace(15.0, 185.0, PIECES + 1)
    value = StoredValue(
        energy, per_kwh * (energy - 15.0), 1000.0, True, {"gensets": sets.kwh_per_litre / 0.95}
    )
    data = replace(window(day), ahead=KindsAhead({"gensets": ahead(day)}), stored_value=value)
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert answer.status == "optimal"
    assert answer.dispatch.served[0].tolist() == [bool(x) for x in served]
    left_kwh = (15.0 - 5.0 * sum(served)) * KWH_PER_LITRE / 0.95
    expected = float(np.array(served) @ [1.2, 0.4]) + per_kwh * left_kwh
    assert answer.objective == pytest.approx(expected, abs=2e-5)


def worth(one: EquivalentBattery, **more: Any) -> StoredValue:
    """What energy is worth in four hours of an outage with 30 kW of customers."""
    values: dict[str, Any] = {
        "load_kw": np.full((4, 2), 15.0), "pv_kw": np.zeros(4),
        "price_gbp_per_kwh": np.full(4, 0.2), "import_kw": np.full(4, np.inf), "export": None,
        "weight": np.array([1.0, 0.1]), "lambda_curt": 0.1, "dt_h": 1.0,
        "delivered_kwh": np.zeros(4),
    }  # fmt: skip
    return stored_value(LASTS, one, Ahead(**values | more), 16.94, np.zeros_like)


def at(value: StoredValue, energy_kwh: Floats) -> list[float]:
    return [value.at(each) for each in energy_kwh]


def test_fuel_is_worth_what_a_battery_of_as_much_energy_is() -> None:
    """A battery and a set together against a battery that has their power and energy."""
    both = EquivalentBattery(10.0, 50.0, 25.0, 5.0, 0.95, 0.95, sets_kw=20.0, fuel_kwh=60.0)
    one = EquivalentBattery(10.0, 110.0, 25.0, 25.0, 0.95, 0.95)
    energy = np.linspace(10.0, 110.0, 7)
    assert at(worth(both), energy) == pytest.approx(at(worth(one), energy), abs=0.02)
    # In the three hours behind the present one 25 kW serve the first and two thirds of the other.
    assert worth(both).at(110.0) == pytest.approx(3.0 * (1.0 + 0.1 * 2.0 / 3.0), rel=1e-3)


def test_a_delivery_is_worth_as_much_as_fuel_in_the_tank() -> None:
    """In the next step already, 30 kWh are as good as if they were there."""
    one = EquivalentBattery(10.0, 50.0, 25.0, 5.0, 0.95, 0.95, sets_kw=20.0, fuel_kwh=60.0)
    there = worth(one)
    coming = worth(one, delivered_kwh=np.array([0.0, 30.0, 0.0, 0.0]))
    low = np.linspace(10.0, 80.0, 5)
    gained = np.array(at(there, low + 30.0)) - there.at(40.0)
    assert at(coming, low) == pytest.approx(gained, abs=0.02)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", [1, 4, 5, 6, 7, 8, 9, 10])  # days with batteries
def test_methods_agree_on_random_windows(seed: int) -> None:
    scenario, data = random_window(seed, stressed=seed % 2 > 0)
    rng = np.random.default_rng([seed, 44])
    day = replace(scenario, gensets=random_sets(rng, scenario))
    b = day.batteries
    of_fuel = day.gensets.kwh_per_litre / 0.95
    most_kwh = float(b.energy_kwh @ b.soc_max + day.gensets.tank_litres @ of_fuel)
    energy = np.linspace(float(b.energy_kwh @ b.soc_min), most_kwh, PIECES + 1)
    slope = np.sort(rng.exponential(0.01, PIECES))[::-1]
    service = np.append(0.0, np.cumsum(slope * np.diff(energy)))
    first = replace(data.first(1), ahead=KindsAhead({"gensets": ahead(day, 1)}))
    if seed % 3:
        first = replace(first, grid_limit_kw=np.zeros(1))
    out = bool(first.grid_limit_kw[0] <= 0.0)
    value = StoredValue(energy, service, 1000.0, out, {"gensets": of_fuel})
    assert_methods_agree(Site.of(day), replace(first, stored_value=value))
