"""The packaged two days in quarter hours: built from their seed, two outages, part of the grid."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data.two_outages_cigre_mv import build as builder
from vppres import RunOptions, Scenario, find_scenario, load_scenario, run_day
from vppres.io import scenario_digest, write_scenario
from vppres.scenario.timegrid import TimeGrid

NAME = "two-outages-cigre-mv"


@pytest.fixture(scope="module")
def day() -> Scenario:
    return load_scenario(NAME)


def assert_alike(built: object, packaged: object) -> None:
    """Arrays of two records are equal to rounding, everything else exactly."""
    for f in fields(packaged):
        ours, theirs = getattr(built, f.name), getattr(packaged, f.name)
        if isinstance(ours, np.ndarray) and ours.dtype != object:
            np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=0.0, err_msg=f.name)
        elif isinstance(ours, np.ndarray):
            assert ours.tolist() == theirs.tolist(), f.name
        elif not is_dataclass(ours):
            assert ours == theirs, f.name


def test_packaged_folder_is_what_the_builder_builds(day: Scenario) -> None:
    """To the last digits: impedances of another way of computing them differ in the sixteenth."""
    built = builder.build()
    for part in ("network", "customers", "pv", "batteries"):
        assert_alike(getattr(built, part), getattr(day, part))
    assert_alike(built, day)
    assert sum(file.stat().st_size for file in find_scenario(NAME).iterdir()) < 100_000


def test_round_trip(day: Scenario, tmp_path: Path) -> None:
    write_scenario(day, tmp_path / "copy")
    assert scenario_digest(load_scenario(tmp_path / "copy")) == scenario_digest(day)


def test_two_days_two_outages_and_a_part_of_the_grid(day: Scenario) -> None:
    assert (day.grid.n_steps, day.grid.step_minutes) == (192, 15.0)
    # 12:00 to 16:00 of the first day, 17:30 to 20:00 of the second.
    assert np.flatnonzero(day.outage).tolist() == [*range(48, 64), *range(166, 176)]
    part = np.flatnonzero(np.isfinite(day.grid_limit_kw) & ~day.outage)
    assert part.tolist() == [*range(64, 72)]  # until 18:00
    assert (day.grid_limit_kw[part] < day.load_kw[part].sum(axis=1)).all()


def test_second_day_is_cloudy(day: Scenario) -> None:
    energy = day.pv_kw.sum(axis=1).reshape(2, 96).sum(axis=1)
    assert energy[1] < 0.8 * energy[0]


@pytest.mark.nightly
def test_other_seeds_draw_other_days() -> None:
    one, other = builder.build(1), builder.build(2)
    assert (one.load_kw != other.load_kw).any()
    assert (one.pv_kw.sum(axis=1) != other.pv_kw.sum(axis=1)).any()


@pytest.mark.nightly
def test_hours_around_the_first_outage_run(day: Scenario) -> None:
    first, count = 44, 28  # 11:00 to 18:00
    part = replace(
        day,
        grid=TimeGrid(day.grid.times[first], 15.0, count),
        **{
            name: getattr(day, name)[first : first + count]
            for name in ("load_kw", "pv_kw", "price_gbp_per_kwh", "temperature_c", "grid_limit_kw")
        },
    )
    run = run_day(part, RunOptions(horizon_h=1.0))
    served = run.customers.set_index("time")["served"].groupby(level=0).mean()
    assert (served[: pd.Timestamp("2025-07-01T11:45Z")] == 1.0).all()
    assert (
        served[pd.Timestamp("2025-07-01T12:00Z") : pd.Timestamp("2025-07-01T15:45Z")].mean() < 1.0
    )
    restored = run.steps.set_index("time")["p_grid_kw"][pd.Timestamp("2025-07-01T16:00Z") :]
    assert restored.max() <= builder.PARTIAL_KW * 1.02  # losses come on top
