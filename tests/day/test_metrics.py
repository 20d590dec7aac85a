"""The figures of a run, against values worked out by hand on the small day."""

from __future__ import annotations

import json
import platform
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from tests.support.made_up_runs import (
    OPTIONS,
    SERVED,
    day_run,
    day_scenario,
    small_run,
    small_scenario,
)
from vppres.day import metrics
from vppres.day.trajectory import Trajectory
from vppres.report.findings import findings


def with_served(run: Trajectory, served: bool) -> Trajectory:
    return replace(run, customers=run.customers.assign(served=served))


def with_steps(run: Trajectory, column: str, values: list[float | bool]) -> Trajectory:
    return replace(run, steps=run.steps.assign(**{column: values}))


@pytest.mark.parametrize(("served", "expected"), [(True, 1.0), (False, 0.0)])
def test_resilience_limits(served, expected):
    assert metrics.resilience(with_served(small_run(), served)) == expected


def test_resilience_looks_at_the_outage_only():
    run = small_run()
    connected = ~run.customers["time"].isin(run.steps.loc[run.steps["outage"], "time"])
    dark = replace(run, customers=run.customers.assign(served=run.customers["served"] & ~connected))
    assert metrics.resilience(dark) == metrics.resilience(run)
    assert metrics.served_share(dark, outage=False) == {"critical": 0.0, "high": None, "low": 0.0}


def test_service_by_tier_by_hand():
    shares = metrics.service_by_tier(small_run())
    assert shares["critical"].tolist() == [1.0, 1.0, 0.0, 1.0]
    assert shares["low"].tolist() == [1.0, 0.0, 0.5, 1.0]


def test_service_by_customer_by_hand():
    lost = metrics.service_by_customer(small_run())
    assert lost["id"].tolist() == ["a", "b", "c"]
    assert lost["bus"].tolist() == [2, 3, 4]
    assert lost["tier"].tolist() == ["critical", "low", "low"]
    # Half-hour steps at 10, 20 and 40 kW.
    assert lost["unserved_h"].tolist() == [0.5, 0.5, 1.0]
    assert lost["unserved_kwh"].tolist() == [5.0, 10.0, 40.0]


def test_customers_are_listed_in_the_order_of_the_scenario():
    day = small_scenario()
    names = replace(day, customers=replace(day.customers, id=["z", "b", "m"]))
    assert metrics.service_by_customer(small_run(names))["id"].tolist() == ["z", "b", "m"]


def test_energy_and_cost_are_proportional_to_the_step_length():
    hourly = small_run(small_scenario(step_minutes=60.0))
    for figure in (metrics.import_kwh, metrics.cost_gbp, metrics.pv_curtailed_kwh):
        assert figure(hourly) == pytest.approx(2 * figure(small_run()))


def test_island_figures_by_hand():
    run = with_steps(small_run(), "p_grid_kw", [500.0, 3.0, -2.0, -700.0])
    assert metrics.island_figures(run) == {
        "island_import_max_kw": 3.0,
        "island_export_max_kw": 2.0,
        "island_reactive_max_kvar": 2.0,
    }


def test_import_above_the_limit_is_counted_and_named():
    day = replace(small_scenario(), grid_limit_kw=[90.0, 0.0, 0.0, 110.0])
    run = small_run(day)  # imports 100, 101, 102 and 103 kW
    assert metrics.import_above_limit_max_kw(run) == pytest.approx(10.0)
    assert "Import above its limit in 1 step, by up to 10.0 kW." in findings(run)


def test_an_island_that_only_exports_imports_nothing():
    run = with_steps(small_run(), "p_grid_kw", [500.0, -1.0, -2.0, 700.0])
    assert metrics.island_figures(run)["island_import_max_kw"] == 0.0


def test_summary_tells_the_outage_from_the_connected_steps():
    # In the outage a is served in one of two steps, b and c in one of four customer-steps; while
    # the grid is there, c is let go once of four.
    served = small_run().customers["served"].to_numpy().copy()
    served[11] = False
    run = replace(small_run(), customers=small_run().customers.assign(served=served))
    summary = metrics.summarise(run)
    assert summary["served_share"] == {"critical": 0.5, "high": None, "low": 0.25}
    assert summary["served_share_connected"] == {"critical": 1.0, "high": None, "low": 0.75}


def test_summary_by_hand():
    summary = metrics.summarise(small_run(planned={"served": SERVED}))
    digest, versions = summary.pop("input_digest"), summary.pop("versions")
    assert len(digest) == 64
    assert set(versions) == {"python", *metrics.PACKAGES}
    # Weights 1, 0.1, 0.2; only a served in step 1, only b in step 2: (1 + 0.1) / (2 x 1.3).
    assert summary.pop("resilience") == pytest.approx(1.1 / 2.6)
    assert summary.pop("resilience_planned") == pytest.approx(1.1 / 2.6)
    # Lowest AC voltages 0.98, 0.97, 0.96, 0.95; the model says 0.99.
    assert summary.pop("v_mean_of_min_ac_pu") == pytest.approx(0.965)
    assert summary.pop("v_error_max_pu") == pytest.approx(0.04)
    # 0, 1, 2 and 3 s; the 95th percentile lies 0.85 of the way from 2 to 3.
    assert summary.pop("solve_s") == pytest.approx(
        {"total": 6.0, "median": 1.5, "p95": 2.85, "max": 3.0}
    )
    # With grid, steps 0 and 3 import 100 and 103 kW for half an hour at 0.1 and 0.4 GBP/kWh.
    # a goes off and on again, b off and on, c off and on: one pair each.
    assert summary == {
        "cautions": [
            "Tier order was not kept in 1 customer-step (a): the energy of lower tiers would have "
            "sufficed. At 19 Jul 01:00 a (critical, 10.0 kW) was off supply, while b had up "
            "to 20.0 kW."
        ],
        "served_share": {"critical": 0.5, "high": None, "low": 0.25},
        "served_share_connected": {"critical": 1.0, "high": None, "low": 1.0},
        "minutes_off_max": {"critical": 30.0, "high": None, "low": 60.0},
        "minutes_off_gini": {"critical": 0.0, "high": None, "low": pytest.approx(1.0 / 6.0)},
        "cost_gbp": pytest.approx(0.5 * (0.1 * 100 + 0.4 * 103)),
        "import_kwh": 101.5,
        "export_kwh": 0.0,
        "export_revenue_gbp": 0.0,
        "net_cost_gbp": pytest.approx(0.5 * (0.1 * 100 + 0.4 * 103)),
        "pv_curtailed_kwh": 2.0,
        "v_min_ac_pu": 0.95,
        "v_max_ac_pu": 1.0,
        "line_current_max_a": 0.0,
        "line_loading_max": None,
        "island_import_max_kw": 102.0,
        "island_export_max_kw": 0.0,
        "island_reactive_max_kvar": 2.0,
        "import_above_limit_max_kw": None,
        "switching_actions": 6,
        "actions_beyond_one_pair": 0,
        "switching_relaxed_steps": 0,
        "setpoint_moves_kw": None,
        "corrections": 0,
        "fallbacks": 0,
        "fallbacks_by_kind": {},
        "estimated_steps": 0,
        "ac_failures": 0,
        "ac_not_found": 0,
        # Off are b for a step (20 kW), c for two (40 kW), a for one (10 kW), of half an hour each.
        "customer_interruptions": 3.0,
        "interruptions_per_customer": 1.0,
        "customer_minutes_lost": 120.0,
        "minutes_lost_per_customer": 40.0,
        "energy_not_supplied_kwh": 55.0,
        "voll_gbp_per_kwh": 16.94,
        "energy_not_supplied_gbp": pytest.approx(931.7),
        "gap_max": 0.003,
        "controller": "mpc",
        "horizon_h": 5.0,
        "solver": "highs",
        "method": "decomposed",
        "seed": 7,
        "options": {"errors": {"load_bias": 0.1}, "thermal": "off"},
    }


def test_operation_figures_by_hand():
    run = small_run()
    assert metrics.operation_figures(run)["fallbacks"] == 0
    run = with_steps(run, "fallback", ["rule", "none", "rule", "previous_plan"])
    run = with_steps(run, "estimated", ["soc of b4", "", "", "load"])
    failed = [f"{metrics.NOBODY} because", "collapse", "", "collapse"]
    figures = metrics.operation_figures(with_steps(run, "ac_failed", failed))
    assert (figures["fallbacks"], figures["estimated_steps"]) == (3, 2)
    assert (figures["ac_failures"], figures["ac_not_found"]) == (2, 1)
    assert figures["fallbacks_by_kind"] == {"rule": 2, "previous_plan": 1}


def test_reason_figures_by_hand():
    explained = pd.DataFrame(
        {
            "item": ["customer", "customer", "battery", "step", "pv"],
            "action": ["not_served", "not_served", "charge", "balance", "curtailed"],
            "driver": ["energy", "unexplained", "price", "unexplained", "energy"],
        }
    )
    assert metrics.reason_figures(explained) == {
        "explained_share": 0.75,
        "drivers": {
            "not_served": {"energy": 1, "unexplained": 1},
            "charge": {"price": 1},
            "curtailed": {"energy": 1},
        },
    }
    nothing = metrics.reason_figures(explained[explained["item"] == "step"])
    assert nothing == {"explained_share": None, "drivers": {}}
    run = replace(small_run(), explanations=explained)
    summary = metrics.summarise(run)
    assert summary["explained_share"] == 0.75
    assert summary["cost_gbp"] == metrics.cost_gbp(run)


def test_versions_of_what_is_not_installed_are_none(monkeypatch):
    monkeypatch.setattr(metrics, "PACKAGES", ("numpy", "no-such-package"))
    assert metrics.versions() == {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "no-such-package": None,
    }


def test_summary_counts_corrections():
    run = with_steps(small_run(), "corrected", [False, True, True, False])
    assert metrics.summarise(run)["corrections"] == 2


def test_without_outage_what_is_about_the_outage_is_null():
    summary = metrics.summarise(small_run(small_scenario(outage=False)))
    assert summary["resilience"] is None
    assert set(summary["served_share"].values()) == {None}
    assert metrics.island_figures(small_run(small_scenario(outage=False))) == {
        "island_import_max_kw": None,
        "island_export_max_kw": None,
        "island_reactive_max_kvar": None,
    }
    assert summary["island_import_max_kw"] is None
    assert summary["import_kwh"] == pytest.approx(0.5 * (100 + 101 + 102 + 103))


def test_planned_resilience_by_hand():
    # The plan serves a and c in both outage steps: 1.2 / 1.3.
    run = small_run(planned={"served": [[True, False, True]] * 4})
    assert metrics.summarise(run)["resilience_planned"] == pytest.approx(1.2 / 1.3)


def test_planned_resilience_needs_a_plan_and_an_outage():
    assert metrics.resilience_planned(small_run()) is None
    quiet = small_run(small_scenario(outage=False), planned={"served": SERVED})
    assert metrics.resilience_planned(quiet) is None


def test_the_full_horizon_has_no_prediction_horizon():
    run = replace(small_run(), options=OPTIONS | {"controller": "full-horizon"})
    assert metrics.summarise(run)["horizon_h"] is None
    assert metrics.summarise(small_run())["horizon_h"] == 5.0


def test_summary_is_strict_json_even_where_a_figure_is_undefined():
    run = with_steps(small_run(), "gap", [np.inf, 0.0, 0.0, 0.0])
    run = replace(
        with_steps(run, "v_error_pu", [np.nan] * 4),
        options=OPTIONS | {"time_limit_s": np.inf, "seed": np.int64(3)},
    )
    summary = metrics.summarise(run)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["gap_max"] is None
    assert summary["v_error_max_pu"] is None
    assert summary["options"]["time_limit_s"] is None


def test_digest_follows_the_scenario():
    digest = metrics.summarise(small_run())["input_digest"]
    assert digest == metrics.summarise(small_run())["input_digest"]
    assert digest != metrics.summarise(small_run(small_scenario(outage=False)))["input_digest"]


def test_more_supply_never_lowers_resilience():
    day = day_scenario()
    values = [metrics.resilience(day_run(day, supply)) for supply in (0.0, 800.0, 1700.0, 9e9)]
    assert values == sorted(values)
    assert (values[0], values[-1]) == (0.0, 1.0)


def test_a_connection_counts_for_its_homes() -> None:
    run = small_run()
    day = run.scenario
    homes = np.arange(1, len(day.customers) + 1) * 10
    street = replace(run, scenario=replace(day, customers=replace(day.customers, homes=homes)))
    single = reliability_by_customer(run)
    figures = metrics.summarise(street)
    assert figures["customer_interruptions"] == single["interruptions"] @ homes
    assert figures["minutes_lost_per_customer"] == pytest.approx(
        single["minutes"] @ homes / homes.sum()
    )
    assert figures["resilience"] == metrics.summarise(run)["resilience"]


def reliability_by_customer(run: Trajectory) -> dict[str, np.ndarray]:
    """Losses of supply and minutes lost of each customer, counted one by one."""
    minutes = run.scenario.grid.step_minutes
    found: dict[str, list[float]] = {"interruptions": [], "minutes": []}
    for name in run.scenario.customers.id:
        rows = run.customers[run.customers["id"] == name].sort_values("time")
        on = [True, *rows["served"].astype(bool)]
        found["interruptions"].append(sum(a and not b for a, b in pairwise(on)))
        found["minutes"].append(minutes * on.count(False))
    return {name: np.array(values) for name, values in found.items()}
