"""Fixed demand below zero: generation at a bus that no asset owns and nothing curtails."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.support.small_windows import DARK, OPEN, battery, two_buses, with_pv
from vppres.cli import commands
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.run_files import read_run
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.io import write_scenario
from vppres.scenario.network import Network
from vppres.scenario.scenario import Scenario

GIVEN_KW = 20.0


def run_of(
    load_kw: float,
    grid_limit_kw: list[float],
    soc: float,
    method: str = "decomposed",
    export_limit_kw: float = np.inf,
) -> Trajectory:
    """A customer, a battery of 100 kWh and 50 kW without losses, and 20 kW of fixed generation."""
    day = two_buses([[load_kw]] * len(grid_limit_kw), [1.0], grid_limit_kw)
    day = replace(day, export_limit_kw=np.array(export_limit_kw))
    options = RunOptions(mode="physical", headroom=0.0, method=method)
    return run_day(with_fixed_generation(day, soc), options)


def with_fixed_generation(day: Scenario, soc: float) -> Scenario:
    """The day with 20 kW of fixed generation, and a battery of 100 kWh and 50 kW."""
    network = Network(
        [1], [2], [0.001], [0.001], slack_bus=1, base_kv=11.0,
        drawing_bus=[2], p_fixed_kw=[-GIVEN_KW],
    )  # fmt: skip
    ideal = {"soc_min": 0.0, "soc_max": 1.0, "eta_charge": 1.0, "eta_discharge": 1.0}
    values = {name: [value] for name, value in {**ideal, "soc_initial": soc}.items()}
    return replace(day, network=network, batteries=replace(battery(), **values))


def decided(run: Trajectory) -> set[str]:
    """How the steps were decided, and by which fallbacks."""
    return {*run.steps["status"], *run.steps["fallback"]}


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_what_exceeds_the_demand_is_exported(method: str) -> None:
    run = run_of(5.0, [OPEN] * 2, soc=1.0, method=method)
    assert decided(run) == {"optimal", "none"}
    given_kw = (run.batteries["discharge_kw"] - run.batteries["charge_kw"]).to_numpy()
    import_kw = run.steps["p_grid_kw"].to_numpy()
    assert import_kw == pytest.approx(5.0 - GIVEN_KW - given_kw, abs=1e-3)


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
@pytest.mark.parametrize("limit_kw", [0.0, 4.0])
def test_what_nothing_takes_is_told(limit_kw: float, method: str) -> None:
    """15 kW are left beside a full battery, which gives nothing; the customer stays on."""
    run = run_of(5.0, [OPEN] * 2, 1.0, method, limit_kw)
    assert decided(run) == {"optimal", "none"}
    assert run.customers["served"].all()
    assert run.steps["p_grid_kw"].to_numpy() == pytest.approx(-15.0, abs=1e-3)
    words = [one for one in summarise(run)["cautions"] if one.startswith("Fixed generation")]
    assert words == [
        "Fixed generation is more than demand, batteries and the export limit take, by up to "
        f"{15.0 - limit_kw:.1f} kW in 2 steps, first at 19 Jul 00:00: it cannot be curtailed, and "
        "flows to the grid all the same."
    ]


@pytest.mark.daily
def test_a_folder_whose_connection_takes_less_than_is_generated_is_planned(
    tmp_path: Path,
) -> None:
    """20 kW of fixed generation, 8 kW of PV power and a connection of 4 kW, for three hours.

    Its owner takes 5 kW of PV power and the other customer 3 kW: 3 kW of PV power are curtailed and
    17 kW are left. The battery has room for 10 kWh of 51 kWh, the grid gets the rest, and nobody is
    off.
    """
    day = two_buses([[5.0, 3.0]] * 3, [1.0, 1.0], [OPEN] * 3)
    day = replace(with_pv(day, [8.0] * 3), export_limit_kw=np.array(4.0))
    folder = tmp_path / "folder"
    write_scenario(with_fixed_generation(day, soc=0.9), folder)
    out = tmp_path / "run"
    arguments = ["run", str(folder), "--mode", "physical", "--headroom", "0", "--out", str(out)]
    done = CliRunner().invoke(commands.app, arguments)
    assert done.exit_code == 0, done.output
    run = read_run(out)
    assert decided(run) == {"optimal", "none"}
    assert run.customers["served"].all()
    given_kw = -run.steps["p_grid_kw"].to_numpy()
    assert given_kw.sum() == pytest.approx(3 * 17.0 - 10.0, abs=0.01)
    assert given_kw.max() <= 17.0 + 1e-3
    assert run.pv["curtailed_kw"].to_numpy() == pytest.approx(3.0, abs=1e-3)
    assert run.batteries["discharge_kw"].to_numpy() == pytest.approx(0.0, abs=1e-3)
    (words,) = (one for one in summarise(run)["cautions"] if one.startswith("Fixed generation"))
    assert f"by up to {given_kw.max() - 4.0:.1f} kW" in words


@pytest.mark.parametrize("method", ["decomposed", "monolithic"])
def test_a_battery_takes_it_in_an_island_without_customers(method: str) -> None:
    """90 kW are more than 20 kW and the battery's 50: it takes 20 kWh in each of three hours."""
    run = run_of(90.0, [DARK] * 3, soc=0.2, method=method)
    assert decided(run) == {"optimal", "none"}
    assert not run.customers["served"].any()
    assert run.batteries["soc_end"].tolist() == pytest.approx([0.4, 0.6, 0.8], abs=1e-4)


def test_a_battery_that_it_fills_holds_the_island_until_then() -> None:
    """With 5 kW of demand 15 kWh are left each hour: 30 kWh of room are two hours of three."""
    run = run_of(5.0, [DARK] * 3, soc=0.7)
    assert run.customers["served"].tolist() == [True, True, False]
    assert run.steps["status"].tolist() == ["optimal", "optimal", "blacked_out"]


def test_it_supplies_customers_in_an_island() -> None:
    """Of 60 kW the battery gives 40: twice before it is empty, and nobody is off before then."""
    run = run_of(60.0, [DARK] * 2, soc=0.81)
    assert decided(run) == {"optimal", "none"}
    assert run.customers["served"].all()
    assert np.diff(run.t.soc["b0"]) == pytest.approx([-0.4, -0.4], abs=1e-4)
