"""A connection that exports: by hand, against the whole problem, in the plant, and import only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frame.random_feeders import random_state
from tests.support.agreement import assert_agree, assert_holds, both_methods
from tests.support.exporting import exporting_window
from tests.support.refusals import refusal
from tests.support.set_points import decision
from tests.support.small_windows import DARK, OPEN, battery, two_buses, window, with_pv
from vppres.contract.forecast import ForecastErrors
from vppres.control.converged import physics_of
from vppres.core.errors import InputError
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.explain.day import explain_day
from vppres.io import find_scenario, read_scenario, scenario_digest, write_scenario
from vppres.kinds.customer.physics import SwitchingState
from vppres.kinds.export import data as words_of
from vppres.kinds.export.physics import Export
from vppres.kinds.export.plant import LIMIT_TOLERANCE_KW
from vppres.kinds.export.rows import ExportToGrid
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.model.statement import Statement
from vppres.physics.powerflow import ACPowerFlow
from vppres.plant.collapse import realise
from vppres.plant.plant import Plant
from vppres.report.plots.figures import import_load_pv
from vppres.scenario.remarks import remarks
from vppres.scenario.scenario import ObjectiveWeights, Scenario
from vppres.solve.ladder import METHODS, WindowSolver
from vppres.solve.result import WindowSolution

ANY_STEPS = [(seed, stressed) for stressed in (False, True) for seed in range(16)]


def exporting(
    day: Scenario, limit_kw: float | Sequence[float] = np.inf, price: float | Sequence[float] = 0.0
) -> Scenario:
    """The day on a connection that exports."""
    return replace(
        day, export_limit_kw=np.array(limit_kw), export_price_gbp_per_kwh=np.array(price)
    )


def solve(day: Scenario, method: str = "decomposed") -> WindowSolution:
    """All steps of a day as one window, checked."""
    data = window(day)
    answer = WindowSolver(Site.of(day), method).solve(data)
    assert_holds(day, data, answer)
    return answer


# By hand.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("limit_kw", "exported_kw", "curtailed_kw"),
    [(np.inf, 60.0, 0.0), (40.0, 40.0, 20.0), (0.0, 0.0, 60.0)],
)
def test_only_what_is_beyond_the_limit_is_curtailed(
    method: str, limit_kw: float, exported_kw: float, curtailed_kw: float
) -> None:
    # 80 kW of sun, 20 kW of demand: 60 kW are left.
    day = with_pv(two_buses([[20.0]], [1.0], [OPEN]), [80.0])
    answer = solve(exporting(day, limit_kw, 0.1), method)
    assert answer.dispatch.p_grid_kw == pytest.approx([-exported_kw], abs=1e-4)
    assert answer.dispatch.pv_curtailed_kw[0, 0] == pytest.approx(curtailed_kw, abs=1e-4)
    assert answer.terms.f2 == pytest.approx(-0.1 * exported_kw, abs=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_battery_sells_where_the_price_pays_its_losses(method: str) -> None:
    # 50 kWh bought at 0.05 come back as 45.125 kWh: 10 for the customer, 35.125 sold at 0.4.
    day = replace(two_buses([[10.0]] * 3, [1.0], [OPEN] * 3, [0.05, 0.5, 0.1]), batteries=battery())
    answer = solve(exporting(day, price=[0.04, 0.4, 0.04]), method)
    assert answer.dispatch.charge_kw[:, 0] == pytest.approx([50.0, 0.0, 0.0], abs=1e-3)
    assert answer.dispatch.p_grid_kw == pytest.approx([60.0, -35.125, 10.0], abs=1e-3)
    cost_gbp = 0.05 * 60.0 - 0.4 * 35.125 + 0.1 * 10.0
    assert answer.terms.f2 == pytest.approx(cost_gbp, abs=1e-4)
    worthless = solve(exporting(day), method).dispatch
    assert worthless.p_grid_kw.min() >= -1e-4


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("price", "earned"), [(0.3, 0.5), (-0.2, 0.0)], ids=["dear export", "paid import"]
)
def test_nobody_buys_and_sells_at_once(method: str, price: float, earned: float) -> None:
    # Buying at 0.3 to sell at 0.5, or at -0.2 to give away, would earn without end.
    day = two_buses([[10.0]], [1.0], [OPEN], price)
    answer = solve(exporting(day, price=earned), method)
    assert answer.dispatch.p_grid_kw == pytest.approx([10.0], abs=1e-4)
    assert answer.terms.f2 == pytest.approx(10.0 * price, abs=1e-4)
    if method == "decomposed":  # the whole problem proves no cost by itself
        assert answer.cost_gap_gbp <= 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_exported_in_an_outage(method: str) -> None:
    day = with_pv(two_buses([[20.0]], [1.0], [DARK]), [80.0])
    answer = solve(exporting(day, price=0.5), method)
    assert answer.dispatch.p_grid_kw == pytest.approx([0.0])
    assert answer.dispatch.pv_curtailed_kw[0, 0] == pytest.approx(60.0, abs=1e-4)


def test_a_battery_does_not_charge_from_another_by_way_of_the_meter() -> None:
    # The full one has what the good one could keep, but only import and PV may charge.
    fleet = replace(battery(soc=0.5, count=2), eta_discharge=np.array([0.95, 0.6]))
    fleet = replace(fleet, soc_initial=np.array([0.85, 0.15]))
    day = replace(two_buses([[1.0]] * 2, [1.0], [OPEN] * 2, 0.3), batteries=fleet)
    for price in (0.3, 0.29, 0.0):
        answer = solve(exporting(day, price=price))
        charged = answer.dispatch.charge_kw.sum(axis=1)
        assert (charged <= np.maximum(answer.dispatch.p_grid_kw, 0.0) + 1e-3).all()


# Against the whole problem.


def assert_methods_agree(
    scenario: Scenario, data: WindowData, state: SwitchingState | None = None
) -> None:
    assert_agree(scenario, data, both_methods(Site.of(scenario), data), state)


@pytest.mark.monolith
@pytest.mark.parametrize(("seed", "stressed"), ANY_STEPS)
def test_masters_agree_with_the_whole_problem(seed: int, stressed: bool) -> None:
    assert_methods_agree(*exporting_window(seed, stressed))


@pytest.mark.monolith
@pytest.mark.parametrize("seed", [4, 8, 22])
def test_masters_agree_with_switching_rules(seed: int) -> None:
    scenario, data = exporting_window(seed)
    state = random_state(seed, scenario)
    data = replace(data, switching=state.window(data.n_steps))
    assert_methods_agree(scenario, data, state)


@pytest.mark.monolith
@pytest.mark.parametrize("seed", [2, 4, 6])
def test_masters_agree_with_losses_and_headroom(seed: int) -> None:
    scenario, data = exporting_window(seed)
    physics = physics_of(Site.of(scenario), data, headroom=0.1)
    shape = (data.n_steps, scenario.network.n_lines)
    loss_kw = np.random.default_rng([seed, 9]).uniform(0.0, 0.5, shape)
    physics = replace(physics, loss_kw=loss_kw, loss_kvar=0.5 * loss_kw)
    assert_methods_agree(scenario, replace(data, physics=physics))


# Import only.


def test_an_import_only_window_has_the_problem_from_before(tiny: Scenario) -> None:
    assert not tiny.exports
    assert Export.of(tiny, slice(None)) is None
    site = Site.of(tiny)
    paper, other = Statement(site, 2), Statement(site, 2, ((ExportToGrid, True),))
    assert "grid_export_limit" not in paper.families
    assert set(other.letters) - set(paper.letters) == {"P_out", "importing"}


@pytest.mark.parametrize("name", ["uk-heatwave-2022", "two-outages-cigre-mv"])
def test_packaged_scenarios_import_only(name: str) -> None:
    day = read_scenario(find_scenario(name))
    assert (float(day.export_limit_kw), day.exports) == (0.0, False)


# Files.


def test_limit_is_one_number_or_a_series_and_reads_back(tiny: Scenario, tmp_path: Path) -> None:
    days = {
        "none": exporting(tiny),
        "one": exporting(tiny, 500.0, 0.05),
        "series": exporting(tiny, [np.inf, 1.0, 0.0, 5.0, 5.0, 5.0], [0.1] * 5 + [-0.1]),
    }
    for name, day in days.items():
        write_scenario(day, tmp_path / name)
        again = read_scenario(tmp_path / name)
        assert again.export_max_kw.tolist() == day.export_max_kw.tolist()
        assert again.export_price.tolist() == day.export_price.tolist()
        assert again.export_max_kw[3:5].tolist() == [0.0, 0.0]  # the outage
    digests = {scenario_digest(day) for day in (*days.values(), tiny)}
    assert len(digests) == len(days) + 1


def test_a_folder_without_a_limit_exports(tiny_folder: Path) -> None:
    file = tiny_folder / "scenario.toml"
    file.write_text(file.read_text().replace("export_limit_kw = 0.0\n", ""))
    assert read_scenario(tiny_folder).export_max_kw[0] == np.inf


def test_two_limits_are_refused(tiny_folder: Path) -> None:
    file = tiny_folder / "system.csv"
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([head + ",export_limit_kw", *(row + ",5" for row in rows)]) + "\n")
    assert refusal(read_scenario, tiny_folder) == (
        "scenario.toml, network.export_limit_kw = 0.0: is also a column of system.csv. "
        "Keep the key for one limit of all steps, or the column for one of each step."
    )


# The plant.


def ac_export_kw(day: Scenario, battery_kw: Sequence[float]) -> tuple[float, float, float]:
    """AC export, curtailment and discharge where set-points curtail nothing."""
    plant = Plant(day)
    state = plant.initial_state()
    wanted = decision(day, battery_kw=battery_kw)
    done = realise(plant, ACPowerFlow(day.network), 0, wanted, state)
    return (
        -done.ac.p_slack_kw,
        float(done.pv_curtailed_kw.sum()),
        float(done.discharge_kw.sum()),
    )


def test_surplus_leaves_up_to_the_limit_at_the_meter() -> None:
    # 80 kW of sun for 20 kW of demand; the line takes its losses, 0.01 ohm times (60 / 11)².
    day = with_pv(two_buses([[20.0]], [1.0], [OPEN]), [80.0])
    exported, curtailed, _ = ac_export_kw(exporting(day), [])
    assert exported == pytest.approx(60.0 - 0.01 * (60.0 / 11.0) ** 2 / 1000.0, abs=1e-5)
    assert curtailed == 0.0
    exported, curtailed, _ = ac_export_kw(exporting(day, 40.0), [])
    assert exported <= 40.0 + LIMIT_TOLERANCE_KW
    assert curtailed == pytest.approx(20.0, abs=2e-3)


def test_batteries_are_held_back_before_sun_is_lost() -> None:
    day = with_pv(two_buses([[20.0]], [1.0], [OPEN]), [50.0])
    day = replace(day, batteries=battery(soc=0.8))
    exported, curtailed, discharged = ac_export_kw(exporting(day, 35.0), [-20.0])
    assert exported <= 35.0 + LIMIT_TOLERANCE_KW
    assert (curtailed, discharged) == (0.0, pytest.approx(5.0, abs=2e-3))


def test_an_import_only_plant_is_the_papers() -> None:
    day = with_pv(two_buses([[20.0]], [1.0], [OPEN]), [80.0])
    exported, curtailed, _ = ac_export_kw(day, [])
    assert exported == pytest.approx(60.0, abs=1e-3)
    assert curtailed == 0.0


# Days.


def sunny(tiny: Scenario, limit_kw: float = 60.0, price: float = 0.1) -> Scenario:
    """The tiny day with nine times its sun, and 60 kW that the grid takes."""
    pv = replace(tiny.pv, p_max_kw=9 * tiny.pv.p_max_kw, s_max_kva=9 * tiny.pv.s_max_kva)
    return exporting(replace(tiny, pv=pv, pv_kw=9 * tiny.pv_kw), limit_kw, price)


BY_DAY = {("full-horizon", "paper"), ("perfect", "paper"), ("mpc", "physical")}
BY_DAY |= {("idle", "physical"), ("reserve", "physical")}


@pytest.mark.parametrize(
    ("controller", "mode"),
    [
        pytest.param(*case, marks=() if case in BY_DAY else pytest.mark.nightly)
        for case in product(
            ("mpc", "full-horizon", "perfect", "idle", "reserve"), ("paper", "physical")
        )
    ],
)
def test_every_controller_keeps_the_limit_at_the_meter(
    tiny: Scenario, controller: str, mode: str
) -> None:
    day = sunny(tiny)
    run = run_day(day, RunOptions(controller=controller, horizon_h=2.0, mode=mode))
    steps = run.steps
    out = steps["outage"].to_numpy(bool)
    exported = run.exported_kw
    assert exported.max() <= 60.0 + LIMIT_TOLERANCE_KW
    assert exported[~out].min() > 55.0  # there is sun for it in every connected step
    assert (steps["fallback"] == "none").all()
    reasons = steps.loc[steps["corrected"], "correction_reason"]
    assert reasons.str.startswith("battery energy").all()  # full, never the meter
    curtailed = run.pv["curtailed_kw"].to_numpy().reshape(len(steps), -1).sum(axis=1)
    charged = (run.batteries["charge_kw"] - run.batteries["discharge_kw"]).to_numpy()
    left = (
        run.pv["available_kw"].to_numpy().reshape(len(steps), -1).sum(axis=1)
        - (run.customers["p_load_kw"] * run.customers["served"]).to_numpy().reshape(6, -1).sum(1)
        - charged.reshape(len(steps), -1).sum(axis=1)
    )
    # With grid no more is curtailed than the limit and a kilowatt of losses force.
    assert (curtailed[~out] <= np.maximum(left - 60.0, 0.0)[~out] + 1.0).all()
    summary = summarise(run)
    assert summary["export_kwh"] == pytest.approx(exported.sum())
    assert summary["export_revenue_gbp"] == pytest.approx(0.1 * exported.sum())
    assert summary["import_kwh"] == 0.0
    assert summary["net_cost_gbp"] == pytest.approx(-0.1 * exported.sum())


def test_forecast_errors_do_not_pass_the_limiter(tiny: Scenario) -> None:
    errors = ForecastErrors(load_bias=0.5, pv_bias=-0.5)
    run = run_day(sunny(tiny), RunOptions(controller="full-horizon", errors=errors))
    assert run.exported_kw.max() <= 60.0 + LIMIT_TOLERANCE_KW


def test_the_report_and_the_reasons_name_the_limit(tiny: Scenario) -> None:
    run = explain_day(run_day(sunny(tiny), RunOptions(horizon_h=2.0)))
    reasons = run.explanations.query("action == 'curtail' and phase != 'island'")
    first = reasons[reasons["time"] == run.steps["time"].iloc[0]].iloc[0]
    assert (first["driver"], first["words"]) == (
        "grid",
        "Curtailed: export is at its limit of 60 kW.",
    )
    panel = import_load_pv({"run": run}).panels[0]
    assert min(np.nanmin(curve.values) for curve in panel.curves) == pytest.approx(-60.0)


def test_a_dear_export_is_said() -> None:
    day = exporting(two_buses([[10.0]] * 2, [1.0], [OPEN] * 2, [0.3, -0.1]), 50.0)
    assert words_of.words(day) == "exports up to 50 kW"
    (words,) = remarks(day)
    assert words.startswith(
        "In 1 of 2 steps export earns more than import costs. No plan does both"
    )
    assert remarks(exporting(day, 0.0)) == []


def test_a_measured_limit_holds_from_its_step_on(tiny: Scenario) -> None:
    controller = Controller.of(sunny(tiny, np.inf), RunOptions(horizon_h=1.0))
    soc = dict.fromkeys(tiny.batteries.id, 0.85)
    free = controller.step(Measurement(tiny.grid.times[0], soc=soc))
    held = controller.step(Measurement(tiny.grid.times[1], soc=soc, export_limit_kw=20.0))
    assert free.import_kw < -100.0
    assert held.import_kw == pytest.approx(-20.0, abs=0.1)
    with pytest.raises(InputError, match="export_limit_kw"):
        controller.step(Measurement(tiny.grid.times[2], soc=soc, export_limit_kw=-1.0))


@pytest.mark.parametrize("price", [-0.5, 0.5])
def test_without_a_weight_the_price_decides_on_curtailment(price: float) -> None:
    day = with_pv(two_buses([[20.0]], [1.0], [OPEN]), [80.0])
    day = replace(day, objective=ObjectiveWeights(lambda_curt=0.0))
    answer = solve(exporting(day, price=price))
    exported = 60.0 if price > 0 else 0.0
    assert answer.dispatch.p_grid_kw == pytest.approx([-exported], abs=1e-3)
