"""Prices below zero: the feeder is paid for what it takes, and bounds stay bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io import read_scenario, write_scenario
from vppres.report.plots.figures import energy_and_price
from vppres.scenario.scenario import Scenario


@pytest.fixture
def paid(tiny: Scenario) -> Scenario:
    """The tiny day with prices below zero before and after the outage."""
    prices = np.array([-0.30, 0.28, -0.05, 0.35, 0.40, -0.45])
    return replace(tiny, price_gbp_per_kwh=prices)


def test_files_hold_prices_below_zero(paid: Scenario, tmp_path: Path) -> None:
    write_scenario(paid, tmp_path / "paid")
    read = read_scenario(tmp_path / "paid")
    assert read.price_gbp_per_kwh.tolist() == paid.price_gbp_per_kwh.tolist()


@pytest.mark.parametrize(
    "controller", ["full-horizon", pytest.param("mpc", marks=pytest.mark.nightly)]
)
def test_a_day_with_prices_below_zero_is_certified_as_by_the_monolith(
    paid: Scenario, controller: str
) -> None:
    """Both methods solve the same first window; each one's bound holds for the other's answer."""
    runs = {
        method: run_day(paid, RunOptions(controller=controller, horizon_h=5.0, method=method))
        for method in ("decomposed", "monolithic")
    }
    first = {method: run.steps.iloc[0] for method, run in runs.items()}
    for method, run in runs.items():
        other = first["monolithic" if method == "decomposed" else "decomposed"]
        assert first[method]["bound"] >= other["objective"] - 1e-6
        solved = run.steps.dropna(subset="gap")  # a plan of the whole day is solved once
        assert (solved["gap"] <= 1e-4).all()
        assert (solved["bound"] >= solved["objective"] - 1e-6).all()
    cost = {method: summarise(run)["cost_gbp"] for method, run in runs.items()}
    assert cost["decomposed"] == pytest.approx(cost["monolithic"], abs=0.05)
    assert (
        summarise(runs["decomposed"])["served_share"]
        == summarise(runs["monolithic"])["served_share"]
    )


def test_the_day_takes_more_when_it_is_paid(tiny: Scenario, paid: Scenario) -> None:
    """Batteries charge in the last hour, after the outage, where energy has no later use."""
    options = RunOptions(horizon_h=5.0)
    usual, earning = (run_day(day, options).steps["p_grid_kw"].iloc[-1] for day in (tiny, paid))
    assert earning > usual + 1.0


def test_prices_below_zero_are_drawn(paid: Scenario) -> None:
    run = run_day(paid, RunOptions(horizon_h=0.0))
    assert energy_and_price(run).panels[2]._range[0] < -0.45
