"""The record of a run: contract columns, order, shapes, and what the files bring back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.made_up_runs import (
    OPTIONS,
    SERVED,
    changed,
    day_run,
    day_scenario,
    record,
    small_run,
    small_scenario,
    without_devices,
)
from tests.support.refusals import refusal
from vppres.day.recorder import Recorder, voltage_figures
from vppres.day.run_files import read_run, write_tables
from vppres.day.trajectory import Trajectory
from vppres.io.scenario_writer import write_scenario

# Columns of each table, in their order.
CONTRACT = {
    "steps": (
        "time outage price_gbp_per_kwh p_grid_kw q_grid_kvar losses_kw v_min_ac_pu v_max_ac_pu "
        "v_error_pu objective bound gap status solve_s corrected correction_reason fallback "
        "fallback_reason estimated ac_failed phase"),
    "customers": "time id bus tier weight p_load_kw q_load_kvar served shed",
    "pv": "time id customer bus available_kw self_kw export_kw curtailed_kw q_kvar",
    "batteries": (
        "time id bus charge_kw discharge_kw q_kvar soc_start soc_end eta_charge eta_discharge "
        "temperature_c mismatch_kw"),
    "buses": "time bus v_model_pu v_ac_pu",
    "lines": "time from_bus to_bus p_model_kw q_model_kvar p_ac_kw q_ac_kvar",
}  # fmt: skip


@pytest.mark.parametrize(
    "scenario",
    [small_scenario(), without_devices(small_scenario())],
    ids=["all devices", "no devices"],
)
def test_tables_have_exactly_the_columns_of_the_contract(scenario):
    run = small_run(scenario)
    assert {name: " ".join(table.columns) for name, table in run.tables.items()} == CONTRACT


def test_tables_have_a_row_per_step_and_item():
    assert {name: len(t) for name, t in small_run().tables.items()} == {
        "steps": 4, "customers": 12, "pv": 4, "batteries": 4, "buses": 16, "lines": 12,
    }  # fmt: skip


def test_rows_are_ordered_by_time_then_item():
    customers = small_run().customers
    assert customers["id"].tolist() == ["a", "b", "c"] * 4
    assert customers["time"].is_monotonic_increasing
    assert customers["served"].to_numpy().reshape(4, 3).tolist() == SERVED


def test_times_are_beginnings_of_steps_with_zone():
    times = small_run().steps["time"]
    assert times[1] == pd.Timestamp("2022-07-19 00:30", tz="UTC")
    assert times.dt.tz is not None


def test_voltage_figures_of_a_step_cover_all_buses():
    step = small_run().steps.iloc[3]
    # Bus 1 of the arrays: 0.99 pu in the model, 0.95 pu in the AC power flow; all others at 1.
    assert step["v_min_ac_pu"] == pytest.approx(0.95)
    assert step["v_max_ac_pu"] == 1.0
    assert step["v_error_pu"] == pytest.approx(0.04)


def test_voltage_error_counts_in_both_directions():
    model = np.array([1.0, 0.97, 1.0, 1.0])
    figures = voltage_figures(model, np.array([1.0, 0.99, 1.0, 0.995]))
    assert figures["v_error_pu"] == pytest.approx(0.02)
    figures = voltage_figures(model, np.array([1.0, 0.96, 1.0, 1.03]))
    assert figures["v_error_pu"] == pytest.approx(0.03)


def test_the_bus_of_a_pv_system_is_its_owners():
    assert small_run().pv["bus"].tolist() == [3] * 4


def test_demand_is_recorded_whether_served_or_not():
    customers = small_run().customers
    assert customers["p_load_kw"].tolist() == [10.0, 20.0, 40.0] * 4


def test_notes_become_columns():
    scenario = small_scenario()
    recorder = Recorder(scenario)
    recorder.add(changed(record(scenario, 0, SERVED[0]), steps={"gap_cost_gbp": 0.5}))
    recorder.add(record(scenario, 1, SERVED[1]))
    steps = recorder.finish(OPTIONS).steps
    assert steps["gap_cost_gbp"].iloc[0] == 0.5
    assert np.isnan(steps["gap_cost_gbp"].iloc[1])


def test_the_record_keeps_nothing_of_a_callers_arrays():
    scenario, served = small_scenario(), np.array(SERVED[0])
    recorder = Recorder(scenario)
    recorder.add(changed(record(scenario, 0, SERVED[0]), customers={"served": served}))
    run = recorder.finish(OPTIONS)
    served[:] = False
    assert run.customers["served"].all()


def test_a_step_out_of_order_is_refused():
    with pytest.raises(ValueError, match=r"^step 1 recorded, expected step 0$"):
        Recorder(small_scenario()).add(record(small_scenario(), 1, SERVED[1]))


def test_an_array_of_the_wrong_length_is_refused():
    step = changed(record(small_scenario(), 0, SERVED[0]), customers={"served": np.ones(2, bool)})
    with pytest.raises(
        ValueError,
        match=r"^served has shape \(2,\), the scenario's customers need "
        r"\(3,\)$",
    ):
        Recorder(small_scenario()).add(step)


def test_a_run_needs_a_step_and_its_options():
    recorder = Recorder(small_scenario())
    with pytest.raises(ValueError, match=r"^no step was recorded$"):
        recorder.finish(OPTIONS)
    recorder.add(record(small_scenario(), 0, SERVED[0]))
    with pytest.raises(ValueError, match=r"^missing in options: solver, method, seed$"):
        recorder.finish({"controller": "mpc", "horizon_h": 5.0})


def write(run: Trajectory, folder: Path) -> None:
    write_tables(run, folder)
    write_scenario(run.scenario, folder / "scenario")


@pytest.mark.parametrize("run", [
    small_run(planned={"served": SERVED, "energy_kwh": [15.0] * 5}),
    small_run(without_devices(small_scenario())),
    day_run(day_scenario()),
], ids=["planned", "no devices", "day"])  # fmt: skip
def test_a_run_comes_back_from_its_folder(run, tmp_path):
    write(run, tmp_path)
    back = read_run(tmp_path)
    for name, table in run.tables.items():
        pd.testing.assert_frame_equal(back.tables[name], table)
    assert (back.options, back.planned) == (run.options, run.planned)
    np.testing.assert_array_equal(back.scenario.load_kw, run.scenario.load_kw)


def test_buses_named_by_numbers_and_words_survive_the_files(tmp_path):
    scenario = small_scenario()
    mixed = replace(
        scenario,
        network=replace(scenario.network, from_bus=[1, 2, "north"], to_bus=[2, "north", 4]),
        customers=replace(scenario.customers, bus=[2, "north", 4]),
    )
    write_tables(small_run(mixed), tmp_path)
    assert (
        pd.read_parquet(tmp_path / "buses.parquet")["bus"].tolist() == ["1", "2", "north", "4"] * 4
    )


def test_missing_files_are_all_named(tmp_path):
    write(small_run(), tmp_path)
    (tmp_path / "pv.parquet").unlink()
    (tmp_path / "options.json").unlink()
    assert refusal(read_run, str(tmp_path)) == (
        f"{tmp_path}: has no options.json, no pv.parquet. Give a folder written by a run."
    )


def edited(file: Path, change: Any) -> None:
    change(pd.read_parquet(file)).to_parquet(file)


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda d: edited(d / "steps.parquet", lambda t: t.drop(columns=["gap", "phase"])),
        "steps.parquet: has no column gap, no column phase."),
    (lambda d: edited(d / "customers.parquet", lambda t: t[t["id"] != t["id"][0]]),
        "customers.parquet: has 8 rows, and not 3 in each of the 4 steps."),
    (lambda d: edited(d / "steps.parquet", lambda t: t.iloc[:0]),
        "steps.parquet: has 0 rows for 4 steps."),
    (lambda d: (d / "options.json").write_text('{"options": {"seed": 0}, "planned": null}'),
        "options.json: has no controller, no horizon_h, no solver, no method."),
])  # fmt: skip
def test_a_folder_that_no_run_wrote_so_is_refused(tmp_path: Path, spoil: Any, words: str) -> None:
    write(small_run(), tmp_path)
    spoil(tmp_path)
    cure = "Run the scenario again, or give a folder as a run wrote it."
    assert f"{words} {cure}" in refusal(read_run, tmp_path)
