"""A state of charge at the end of what is known: by hand, against the monolith, over midnight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_window
from tests.support.agreement import assert_certified
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window
from vppres.contract.forecast import Forecast
from vppres.contract.terminal import Terminal
from vppres.control.converged import physics_of
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.explain.day import explain_day
from vppres.io import read_scenario, write_scenario
from vppres.io.digest import scenario_digest
from vppres.kinds.export.physics import Export
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.beyond_paper.losses import lossless
from vppres.model.site import Site
from vppres.scenario.faults import OutOfService
from vppres.scenario.scenario import HARD, REPORT, ControllerDefaults, Scenario
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import WindowSolution


def solved(day: Scenario, terminal: Terminal | None, method: str = "decomposed") -> WindowSolution:
    """All steps of a scenario as one window."""
    data = replace(window(day), terminal=terminal)
    return WindowSolver(Site.of(day), method).solve(data)


def stored(energy_kwh: float, soc: float, limits_kw: list[float], load_kw: float) -> Scenario:
    """A customer of weight 1 and a battery of any power, with prices that rise."""
    day = two_buses([[load_kw]] * len(limits_kw), [1.0], limits_kw)
    return replace(
        day, batteries=battery(energy_kwh=energy_kwh, p_max_kw=1e3, s_max_kva=1e3, soc=soc)
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("soc", "expected"), [(None, 0.15), (0.5, 0.5), (1.0, 0.85)])
def test_energy_is_bought_for_the_end_by_hand(
    method: str, soc: float | None, expected: float
) -> None:
    """100 kWh at 0.3; limits 0.15 and 0.85, efficiency 0.95; what is missing is bought."""
    day = stored(100.0, 0.3, [OPEN, OPEN], 10.0)
    answer = solved(day, None if soc is None else Terminal(soc, 10.0), method)
    assert answer.dispatch.soc[-1, 0] == pytest.approx(expected, abs=1e-5)
    bought = answer.dispatch.charge_kw.sum() - answer.dispatch.discharge_kw.sum()
    change = 100.0 * (expected - 0.3)
    assert bought == pytest.approx(change / 0.95 if change > 0 else change * 0.95, abs=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_a_price_too_low_buys_nothing(method: str) -> None:
    day = stored(100.0, 0.3, [OPEN, OPEN], 10.0)
    cheap = 0.5 * float(day.price_gbp_per_kwh.min())
    answer = solved(day, Terminal(0.5, cheap), method)
    assert answer.dispatch.soc[-1, 0] == pytest.approx(0.15, abs=1e-5)
    # 35 kWh are missing, and so they are paid for.
    imported = float(day.price_gbp_per_kwh @ answer.dispatch.p_grid_kw)
    assert answer.terms.f2 == pytest.approx(imported + 35.0 * cheap, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_no_service_is_given_up_for_the_end(method: str) -> None:
    """An outage until the end: the customer is served although the battery ends empty."""
    day = stored(100.0, 0.5, [DARK, DARK], 15.0)
    answer = solved(day, Terminal(0.85, 100.0), method)
    assert answer.dispatch.served.all()
    assert answer.dispatch.soc[-1, 0] == pytest.approx(0.5 - 30.0 / 0.95 / 100.0, abs=1e-5)


@pytest.mark.monolith
@pytest.mark.parametrize("physical", [False, True])
def test_certificates_hold_against_the_monolith(nightly: bool, physical: bool) -> None:
    """Prices below and above those of the import, batteries alike and not, weak feeders too."""
    for seed in range(8 if nightly else 4):
        scenario, data = random_window(seed, stressed=seed % 2 == 1)
        site = Site.of(scenario)
        if not len(site.batteries):
            continue
        price = (0.05, 0.7, 2.0)[seed % 3]
        data = replace(data, terminal=Terminal(0.3 + 0.1 * (seed % 5), price))
        if physical:
            data = lossless(data, physics_of(site, data, 0.1))
        assert_certified(site, data)


def last_hours(tiny: Scenario) -> Scenario:
    """The tiny day with a grid in its last hours, and batteries that are nearly empty."""
    return replace(tiny, batteries=replace(tiny.batteries, soc_initial=[0.2, 0.2]))


def stored_at_end(run: Trajectory) -> list[float]:
    return run.batteries["soc_end"].to_numpy()[-2:].tolist()


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "mode"), [("mpc", "physical"), ("full-horizon", "paper")])
def test_batteries_are_full_enough_at_the_end_of_a_run(
    tiny: Scenario, kind: str, mode: str
) -> None:
    forming = replace(tiny.batteries, grid_forming=[True, True])
    day = replace(last_hours(tiny), batteries=forming)
    # Two steps without grid, so that there is something to charge for twice over.
    options = RunOptions(controller=kind, mode=mode, horizon_h=3.0)
    empty = run_day(day, options)
    kept = run_day(day, replace(options, soc_end=0.4))
    assert max(stored_at_end(empty)) < 0.2
    assert stored_at_end(kept) == pytest.approx([0.4, 0.4], abs=0.01)
    served = [run.customers["served"].to_numpy(bool) for run in (empty, kept)]
    assert (served[0] == served[1]).all()


@pytest.mark.nightly
def test_without_it_a_run_is_what_it_was(tiny: Scenario) -> None:
    """The last window only is another one; none of the earlier ones sees the end."""
    options = RunOptions(horizon_h=1.0)
    free = run_day(tiny, options)
    kept = run_day(tiny, replace(options, soc_end=0.5))
    early = slice(0, 4 * 2)
    assert free.batteries["soc_end"].iloc[early].equals(kept.batteries["soc_end"].iloc[early])
    assert not free.batteries["soc_end"].equals(kept.batteries["soc_end"])


def test_a_controller_keeps_it_where_it_knows_no_more(tiny: Scenario) -> None:
    """Fed until midnight it holds energy for the morning; told of the morning it does not."""
    last = tiny.grid.times[5]
    soc = {"big": 0.6, "small": 0.6}
    options = RunOptions(horizon_h=1.0, soc_end=0.5, isolate=False)
    cut = Controller.of(tiny, options).step(Measurement(last, soc))
    assert cut.batteries["soc_end"].tolist() == pytest.approx([0.5, 0.5], abs=1e-4)
    rolling = Controller.of(tiny, options)
    later = replace(tiny, grid=replace(tiny.grid, start=tiny.grid.end))
    cheap = replace(later, price_gbp_per_kwh=0.2 * later.price_gbp_per_kwh)
    rolling.extend(cheap)
    assert rolling.step(Measurement(last, soc)).batteries["soc_end"].max() < 0.5


def test_the_price_is_above_every_import_and_export() -> None:
    row = np.zeros((2, 1))
    nothing = OutOfService(np.zeros((2, 0), dtype=bool), np.zeros((2, 1), dtype=bool))
    for prices, export, expected in (
        ([0.2, 0.5], None, 1.0),
        ([-0.2, 0.0], None, 0.01),
        ([0.2, 0.3], Export([1.0, 1.0], [0.1, 0.4]), 0.8),
    ):
        forecast = Forecast(row, row, prices, [np.inf, 0.0], [20.0, 20.0], export, out=nothing)
        terminal = Terminal.of(0.5, forecast, ends=True)
        assert terminal.price_gbp_per_kwh == pytest.approx(expected)
        assert Terminal.of(0.5, forecast, ends=False) is None
        assert Terminal.of(None, forecast, ends=True) is None


def test_a_scenario_may_ask_for_it(tiny: Scenario, tmp_path: Path) -> None:
    asked = replace(
        tiny,
        controller=ControllerDefaults(
            mode="paper", voltage_limits=HARD, ratings=REPORT, soc_end=0.35
        ),
    )
    write_scenario(asked, tmp_path / "asked")
    read = read_scenario(tmp_path / "asked")
    assert read.controller.soc_end == 0.35
    assert RunOptions().on(read).soc_end == 0.35
    assert RunOptions(soc_end=0.7).on(read).soc_end == 0.7
    # A folder that asks for nothing keeps its digest.
    assert scenario_digest(read) != scenario_digest(replace(read, controller=tiny.controller))
    with pytest.raises(InputError, match="must lie between 0 and 1"):
        RunOptions(soc_end=1.5)


def test_explanations_know_of_the_end(tiny: Scenario) -> None:
    """In the last hour a stored kWh is worth the price of a missing one."""
    run = explain_day(run_day(last_hours(tiny), RunOptions(horizon_h=1.0, soc_end=0.85)))
    prices = run.shadow_prices
    stored_kwh = prices[prices["constraint"] == "stored_energy"]
    worth = stored_kwh[stored_kwh["time"] == tiny.grid.times[5]]["gbp"].max()
    assert worth == pytest.approx(2 * 0.45, rel=0.02)
