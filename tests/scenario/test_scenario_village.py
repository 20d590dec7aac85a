"""The packaged week of a village: built from its seed, and every kind of asset in one outage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from data.village_hot_week import build as builder
from vppres import RunOptions, Scenario, load_scenario, run_day, summarise
from vppres.io import scenario_digest

NAME = "village-hot-week"


@pytest.fixture(scope="module")
def week() -> Scenario:
    return load_scenario(NAME)


def test_packaged_folder_is_what_the_builder_builds(week: Scenario) -> None:
    built = builder.build()
    for name in ("load_kw", "pv_kw", "temperature_c", "price_gbp_per_kwh", "grid_limit_kw"):
        np.testing.assert_allclose(getattr(built, name), getattr(week, name), rtol=1e-14)
    for table in ("customers", "pv", "batteries", "chargers", "thermal_loads", "gensets"):
        assert getattr(built, table).id.tolist() == getattr(week, table).id.tolist()
    assert scenario_digest(replace(built, network=week.network)) == scenario_digest(week)


def test_village_has_what_its_page_says(week: Scenario) -> None:
    homes = [name.startswith("home-") for name in week.customers.id]
    assert (sum(homes), len(week.thermal_loads), len(week.chargers)) == (60, 20, 15)
    assert int(week.chargers.two_way.sum()) == 5
    assert week.outage.sum() * week.grid.dt_h == 30.0
    assert np.flatnonzero(week.customers.longest_off_h == 4.0).size == 2
    sets = week.gensets
    ten_hours = 10.0 * sets.litres(np.array([True]), sets.p_max_kw, dt_h=1.0)
    assert ten_hours == pytest.approx(sets.fuel_level_litres, rel=0.01)


def test_night_of_the_outage_runs_with_all_of_it(week: Scenario) -> None:
    night = week.between(60, 80)  # from an hour before the outage to the next morning
    warm = replace(night.thermal_loads, t_initial_c=night.thermal_loads.t_max_c)
    night = replace(night, thermal_loads=warm)
    run = run_day(night, RunOptions(isolate=False))
    summary = summarise(run)
    assert (run.steps["fallback"] == "none").all()
    assert run.steps["gap"].max() < 1e-4
    assert summary["served_share"]["critical"] == 1.0
    assert summary["gensets"]["hours_on"] > 0.0
    assert run.vehicles["plugged"].any()
    assert (run.thermal_loads["p_kw"] > 0.0).any()
