"""The paper's numbers, on real days. Values and tolerances stand in experiments/published.py."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from experiments import efficiency, forecast_errors, ideal
from experiments.battery_energy import rows as battery_rows
from experiments.config import Config
from experiments.drawing import FULL, MPC
from experiments.forecast_errors import points
from experiments.grid_import import rows as import_rows
from experiments.jobs import Job
from experiments.prediction_horizon import rows as horizon_rows
from experiments.published import STATEMENTS
from experiments.results import DayResult
from experiments.rows import Row
from experiments.runner import Cache, simulate
from experiments.voltage import rows as voltage_rows

Days = Callable[[Iterable[Job]], dict[Job, DayResult]]

IDEAL: Config = {"horizon_h": 5, "horizons_h": [0, 2, 4, 5]}
LOAD_ERROR: Config = {
    "field": "load_alpha_per_h",
    "levels": [0.02],
    "error_seeds": 1,
    "builder_seeds": 2,
}
HEATING: Config = {"horizon_h": 6, "scheme": "euler", "other_schemes": [], "builder_seeds": 0}


@pytest.fixture(scope="session")
def days(tmp_path_factory: pytest.TempPathFactory) -> Days:
    """Simulated days, shared by the tests and by the processes that run them."""
    folder = Path(tmp_path_factory.getbasetemp().parent) / "published_days"
    folder.mkdir(exist_ok=True)
    cache = Cache(folder)

    def get(jobs: Iterable[Job]) -> dict[Job, DayResult]:
        found = {}
        for job in jobs:
            result = cache.get(job)
            if result is None:
                result = simulate(job)[1]
                cache.put(job, result)
            found[job] = result
        return found

    return get


def misses(rows: list[Row]) -> list[str]:
    """Rows that do not hold, with what was found."""
    return [f"{row.id} {row.quantity}: {row.ours}. {row.reason}" for row in rows if not row.holds]


@pytest.mark.daily
def test_resilience_and_cost_against_the_horizon(days: Days) -> None:
    jobs = [*(ideal.mpc(h) for h in IDEAL["horizons_h"]), ideal.FULL_HORIZON]
    results = days(jobs)
    rows = horizon_rows(IDEAL, results)
    assert [row.id for row in rows] == ["R1", "R2", "R2b", "R3a", "R3b", "R3c"]
    # R3c asks for a rise at every step of H; from H = 2 on the cost is level within 0.15 %.
    assert misses([row for row in rows if row.id != "R3c"]) == []
    cost = [results[ideal.mpc(h)].summary["cost_gbp"] for h in IDEAL["horizons_h"]]
    assert cost[0] < min(cost[1:])


@pytest.mark.nightly
def test_resilience_rises_with_the_horizon_and_is_flat_from_four_hours(days: Days) -> None:
    jobs = [ideal.mpc(horizon_h) for horizon_h in range(9)]
    results = days(jobs)
    values = [results[job].resilience for job in jobs]
    assert min(np.diff(values)) >= -1e-9, values
    assert max(values[4:]) - min(values[4:]) <= 0.003, values
    assert values[4] - values[0] > 0.05, values


def test_ideal_day_of_both_controllers(days: Days) -> None:
    results = days(ideal.jobs(IDEAL))
    rows = [
        *voltage_rows(IDEAL, results),
        *battery_rows(IDEAL, results),
        *import_rows(IDEAL, results),
    ]
    found = {row.id for row in rows}
    assert {"R4", "R5", "R6a", "R6b", "R7", "R8", "R9", "R10", "R11", "R22", "R23"} <= found
    # Nothing charges in hour 0 or discharges before hour 6, and the MPC charges later in the
    # morning than the full horizon: docs/reproduction.md gives the figures.
    # The means of the lowest voltage are 0.003 pu above the published ones.
    not_held = {"R6a", "R6b", "R8", "R9", "R10b"}
    assert {row.id for row in rows if not row.holds} == not_held
    assert misses([row for row in rows if row.id not in not_held]) == []


def test_planned_is_what_happens_under_ideal_conditions(days: Days) -> None:
    day = days([ideal.FULL_HORIZON])[ideal.FULL_HORIZON]
    assert day.summary["resilience_planned"] == pytest.approx(day.resilience)
    assert day.planned["energy_kwh"] == pytest.approx(day.steps["energy_kwh"], abs=0.01)


@pytest.mark.nightly
def test_mpc_keeps_its_resilience_under_load_error_and_the_plan_does_not(days: Days) -> None:
    results = days(forecast_errors.jobs(LOAD_ERROR))
    mpc, full = (points(LOAD_ERROR, results, name)[-1] for name in (MPC, FULL))
    assert mpc.level == full.level == 0.02
    median = float(np.median(full.spread()))
    assert STATEMENTS["R13"].holds(mpc.days[0].resilience)
    assert STATEMENTS["R14"].holds(median)
    assert STATEMENTS["R18"].holds(mpc.days[0].resilience / median - 1.0)


@pytest.mark.nightly
def test_heating_leaves_the_full_horizon_short(days: Days) -> None:
    full = efficiency.pair(HEATING, "euler")[FULL]
    day = days([full])[full]
    # 1.2 % below the published import, whose two values differ by 0.3 %.
    assert day.summary["import_kwh"] == pytest.approx(STATEMENTS["R20b"].high, rel=0.015)
    assert not STATEMENTS["R20b"].holds(day.summary["import_kwh"])
    assert STATEMENTS["R21"].holds(efficiency.shortfall_kwh(day))


@pytest.mark.nightly
def test_mpc_makes_up_for_the_heating(days: Days) -> None:
    results = days(efficiency.jobs(HEATING))
    held = ("R19a", "R19c")  # R20a is of the level alone; R24 hangs on which plan is met
    rows = [row for row in efficiency.rows(HEATING, results) if row.id in held]
    assert len(rows) == len(held)
    assert misses(rows) == []
