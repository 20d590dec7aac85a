"""Runs of more than one day: figures by the day, days of 23 and 25 hours, rules that begin anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tests.support.long_days import repeated
from tests.support.made_up_runs import OPTIONS, record, small_scenario
from vppres.cli import commands
from vppres.day.daily import daily_figures, spans_days
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.recorder import Recorder
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer.data import SwitchingRules
from vppres.report.run_folder import DAYS_FILE, write_run
from vppres.scenario.scenario import Scenario


def made_up(start: str) -> Trajectory:
    """Four half-hours, the middle two dark; the first customer is off in the second."""
    day = small_scenario()
    day = replace(day, grid=replace(day.grid, start=pd.Timestamp(start)))
    recorder = Recorder(day)
    for t in range(4):
        recorder.add(record(day, t, [t != 1, True, True]))
    return recorder.finish(OPTIONS)


def test_days_by_hand() -> None:
    """Midnight between the two dark half-hours of four."""
    run = made_up("2022-07-18T23:00Z")
    days = daily_figures(run).set_index("day")
    assert days.index.tolist() == ["2022-07-18", "2022-07-19"]
    assert days["hours"].tolist() == [1.0, 1.0]
    assert days["outage_h"].tolist() == [0.5, 0.5]
    # Weights are 1, 0.1 and 0.2: without the first customer 0.3 of 1.3.
    assert days["resilience"].tolist() == pytest.approx([0.3 / 1.3, 1.0])
    assert days["unserved_customer_h"].tolist() == [0.5, 0.0]
    assert days["demand_kwh"].tolist() == [70.0, 70.0]
    assert days["unserved_kwh"].tolist() == [5.0, 0.0]
    # 100 kW at 0.1 GBP/kWh before the outage, 103 kW at 0.4 after it.
    assert days["import_kwh"].tolist() == [50.0, 51.5]
    assert days["cost_gbp"].tolist() == pytest.approx([5.0, 20.6])
    assert days["pv_curtailed_kwh"].tolist() == [1.0, 1.0]
    assert days["stored_end_kwh"].tolist() == [15.0, 15.0]
    assert days["v_min_ac_pu"].tolist() == pytest.approx([0.97, 0.95])
    # Off at the second step, on again at the third, which is another day's.
    assert days["switching_actions"].tolist() == days["actions_max"].tolist() == [1, 1]


@pytest.mark.parametrize(
    ("start", "n_steps", "hours"),
    [
        # The clocks go forward on 30 March and back on 26 October.
        ("2025-03-29T00:00Z", 48, {"2025-03-29": 24.0, "2025-03-30": 23.0, "2025-03-31": 1.0}),
        ("2025-10-24T23:00Z", 73, {"2025-10-25": 24.0, "2025-10-26": 25.0, "2025-10-27": 24.0}),
    ],
)
def test_days_are_those_of_the_clocks(start: str, n_steps: int, hours: dict[str, float]) -> None:
    day = repeated(small_scenario(step_minutes=60.0), n_steps, start)
    recorder = Recorder(day)
    for t in range(n_steps):
        recorder.add(record(day, t, [True] * 3))
    run = recorder.finish(OPTIONS)
    days = daily_figures(run, "Europe/London").set_index("day")
    assert days["hours"].to_dict() == hours
    assert days["demand_kwh"].tolist() == [70.0 * h for h in hours.values()]


def test_a_plan_of_the_day_outlives_what_its_losses_leave_open(tiny: Scenario) -> None:
    """The former of the first outage holds a few Wh more than planned; the second is ahead."""
    options = RunOptions(controller="full-horizon", mode="physical", isolate=False)
    run = run_day(repeated(tiny, 12), options)
    assert not run.steps["corrected"].any()
    assert run.customers["served"].tolist() == np.ravel(run.planned["served"]).tolist()


@pytest.mark.daily
def test_actions_are_limited_by_the_day_of_the_run(tiny: Scenario) -> None:
    """Two outages of two days: who may act twice a day is let go and restored in both."""
    day = repeated(tiny, 48)
    day = replace(day, grid_limit_kw=np.where(np.isin(np.arange(48) % 24, (3, 4)), 0.0, np.inf))
    rules = SwitchingRules(max_actions_per_customer=2)
    run = run_day(day, RunOptions(horizon_h=3.0, switching=rules))
    days, summary = daily_figures(run), summarise(run)
    assert (days["actions_max"] <= 2).all()
    served = run.customers["served"].to_numpy(bool).reshape(48, -1)
    before = np.vstack([np.ones((1, 3), dtype=bool), served[:-1]])
    by_24_h = (served != before).reshape(2, 24, 3).sum(axis=1)
    assert by_24_h.max() == 2
    assert by_24_h.sum(axis=0).max() == 4  # more than two in the run
    # Days add up to the summary.
    assert days["hours"].tolist() == [14.0, 24.0, 10.0]
    for name in ("cost_gbp", "import_kwh", "pv_curtailed_kwh", "switching_actions"):
        assert days[name].sum() == pytest.approx(summary[name], rel=1e-12), name
    weighted = (days["resilience"] * days["outage_h"])[days["outage_h"] > 0.0]
    assert weighted.sum() / days["outage_h"].sum() == pytest.approx(summary["resilience"])
    assert days["stored_start_kwh"].tolist()[1:] == days["stored_end_kwh"].tolist()[:-1]


def test_a_run_of_days_has_a_table_and_a_section_of_them(tmp_path: Path) -> None:
    run = made_up("2022-07-18T23:00Z")
    write_run(run, tmp_path / "two")
    assert pd.read_parquet(tmp_path / "two" / DAYS_FILE).equals(daily_figures(run))
    page = (tmp_path / "two" / "report.html").read_text()
    assert "Day by day" in page and "2022-07-18</td>" in page
    one = made_up("2022-07-19T00:00Z")
    assert spans_days(run) and not spans_days(one)
    write_run(one, tmp_path / "one", figures=False)
    assert not (tmp_path / "one" / DAYS_FILE).exists()


def test_a_run_too_long_for_a_page_gets_its_tables(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(commands, "MOST_DRAWN", 5)
    arguments = ["run", str(tiny_folder), "--no-explain", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(commands.app, arguments, env={"COLUMNS": "80"})
    assert result.exit_code == 0, result.output
    assert "Without figures and report: 6 steps are more than the 5" in result.output
    assert (tmp_path / "run" / "steps.parquet").is_file()
    assert not (tmp_path / "run" / "report.html").exists()
