"""The experiments' machinery: jobs, cache, restart, report. The numbers are in test_published."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import experiments.__main__ as command
from benchmarks.frame.terminal import INTERRUPTED
from experiments import runner
from experiments.catalogue import ALL, EXPERIMENTS
from experiments.config import FOLDER, read_config
from experiments.forecast_errors import Point
from experiments.jobs import Day, Job, scenario
from experiments.published import STATEMENTS, Statement
from experiments.results import DayResult
from experiments.rows import asserted, measured, measured_all, order
from experiments.runner import run_jobs
from vppres.contract.forecast import ForecastErrors
from vppres.core.errors import SolveError
from vppres.day.options import RunOptions

ROOT = Path(__file__).parents[2]
SHORT = Job(options=RunOptions(horizon_h=0.0))
PLAN = Job(options=RunOptions(controller="full-horizon"))


@pytest.fixture(scope="module")
def real_days() -> dict[str, DayResult]:
    """One real day of each controller."""
    return {job.options.controller: runner.simulate(job)[1] for job in (SHORT, PLAN)}


@pytest.fixture
def counted(real_days: dict[str, DayResult], monkeypatch: pytest.MonkeyPatch) -> list[Job]:
    """Jobs that were simulated, with real days in the place of simulations."""
    done: list[Job] = []

    def simulate(job: Job) -> tuple[Job, DayResult]:
        done.append(job)
        return job, real_days[job.options.controller]

    monkeypatch.setattr(runner, "simulate", simulate)
    return done


def jobs_of(count: int) -> list[Job]:
    return [Job(options=RunOptions(seed=seed)) for seed in range(count)]


# Jobs


def test_digest_is_the_same_in_another_process() -> None:
    script = "from experiments.jobs import Job; print(Job().digest())"
    printed = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    assert printed.strip() == Job().digest()


@pytest.mark.parametrize("changed", [
    Job(day=Day(seed=1)),
    Job(day=Day(critical_share=0.34)),
    Job(day=Day(price="A")),
    Job(day=Day(outage_steps=7)),
    Job(day=Day(zone_pairing=(0, 1, 2, 3))),
    Job(options=RunOptions(horizon_h=4.0)),
    Job(options=RunOptions(seed=1)),
    Job(options=RunOptions(errors=ForecastErrors(pv_bias=0.1))),
    Job(options=RunOptions(thermal="exact")),
], ids=lambda job: job.text())  # fmt: skip
def test_digest_tells_inputs_apart(changed: Job) -> None:
    assert changed.digest() != Job().digest()


# Results


def test_short_result_agrees_with_the_summary(real_days: dict[str, DayResult]) -> None:
    for day in real_days.values():
        connected = day.series("outage") == 0
        assert day.series("p_grid_kw")[connected].sum() == pytest.approx(day.summary["import_kwh"])
        assert day.series("v_min_ac_pu").min() == day.summary["v_min_ac_pu"]
        assert len(day.corrected_hours) == day.summary["corrections"]
        assert (day.series("served_kw") <= day.series("load_kw") + 1e-9).all()


def test_stored_energy_follows_the_battery_power(real_days: dict[str, DayResult]) -> None:
    day = real_days["mpc"]
    change_kwh, charge_kw = np.diff(day.series("energy_kwh")), day.series("charge_kw")
    batteries = scenario(Day()).batteries
    start_kwh = batteries.energy_kwh @ batteries.soc_initial
    assert day.series("energy_kwh")[0] == pytest.approx(start_kwh)
    # At 0.95 a kWh charged stores at most 0.95, and one delivered takes at least 1 / 0.95.
    assert (change_kwh <= np.where(charge_kw > 0, 0.95, 1.0) * charge_kw + 1e-6).all()


def test_result_survives_json(real_days: dict[str, DayResult]) -> None:
    day = real_days["full-horizon"]
    assert DayResult.from_json(day.to_json()) == day


# Cache


def test_second_run_takes_everything_from_the_cache(counted: list[Job], tmp_path: Path) -> None:
    jobs = jobs_of(3)
    first, computed = run_jobs(jobs, tmp_path, 1)
    again, recomputed = run_jobs(jobs, tmp_path, 1)
    assert (computed, recomputed, len(counted)) == (3, 0, 3)
    assert again == first
    assert list(again) == jobs


def test_only_what_is_missing_is_run(counted: list[Job], tmp_path: Path) -> None:
    jobs = jobs_of(3)
    run_jobs(jobs, tmp_path, 1)
    (tmp_path / f"{jobs[1].digest()}.json").unlink()
    counted.clear()
    run_jobs(jobs, tmp_path, 1)
    assert counted == [jobs[1]]


@pytest.mark.parametrize("error", [KeyboardInterrupt, SolveError])
def test_finished_days_outlive_an_interrupt(
    error: type[BaseException], counted: list[Job], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, simulate = jobs_of(4), runner.simulate

    def stopped(job: Job) -> tuple[Job, DayResult]:
        if len(counted) == 2:
            raise error
        return simulate(job)

    monkeypatch.setattr(runner, "simulate", stopped)
    with pytest.raises(error):
        run_jobs(jobs, tmp_path, 1)
    assert len(list(tmp_path.glob("*.json"))) == 2
    monkeypatch.setattr(runner, "simulate", simulate)
    run_jobs(jobs, tmp_path, 1)
    assert sorted(job.options.seed for job in counted) == [0, 1, 2, 3]


def test_long_days_come_first(counted: list[Job], tmp_path: Path) -> None:
    long = Job(options=RunOptions(horizon_h=12.0))
    run_jobs([SHORT, long, PLAN], tmp_path, 1)
    assert counted == [long, PLAN, SHORT]


def test_two_processes_give_what_one_gives(real_days: dict[str, DayResult], tmp_path: Path) -> None:
    other = dataclasses.replace(SHORT, day=Day(seed=1))
    results, computed = run_jobs([SHORT, other], tmp_path, 2)
    assert computed == 2
    assert results[SHORT].resilience == real_days["mpc"].resilience
    assert results[SHORT].steps["p_grid_kw"] == pytest.approx(
        real_days["mpc"].steps["p_grid_kw"], abs=1e-6
    )
    assert results[other].steps["p_grid_kw"] != results[SHORT].steps["p_grid_kw"]


# Statements and rows


def test_every_number_of_the_paper_has_a_statement() -> None:
    numbers = {int("".join(c for c in id if c.isdigit())) for id in STATEMENTS}
    assert numbers == set(range(1, 25))


@pytest.mark.parametrize(("ours", "difference", "holds"), [
    (0.91, 0.0, True),
    (0.90, 0.0, True),
    (0.89, -0.01, True),
    (0.93, 0.01, True),
    (0.889, -0.011, False),
    (0.931, 0.011, False),
])  # fmt: skip
def test_difference_is_the_distance_to_the_range(
    ours: float, difference: float, holds: bool
) -> None:
    statement = Statement("R0", "", "", "", 0.90, 0.92, 0.01)
    assert statement.difference(ours) == pytest.approx(difference)
    assert statement.holds(ours) is holds


def test_half_open_ranges() -> None:
    at_least = Statement("R0", "", "", "", 0.94, None)
    assert at_least.holds(1.2) and not at_least.holds(0.93)
    at_most = Statement("R0", "", "", "", None, 0.005)
    assert at_most.holds(-3.0) and not at_most.holds(0.0051)


def test_row_of_a_number_gives_a_reason_only_where_it_misses() -> None:
    inside = measured("R1", 0.915, reason="never asked for")
    assert (inside.ours, inside.difference, inside.verdict, inside.reason) == (
        "0.915",
        "-0.005",
        "yes",
        "",
    )
    outside = measured("R1", 0.80, reason=lambda: "too little")
    assert (outside.difference, outside.verdict, outside.reason) == ("-0.120", "no", "too little")


def test_row_of_several_numbers_is_judged_by_the_worst() -> None:
    row = measured_all("R13", [0.91, 0.88, 0.925])
    assert (row.ours, row.difference, row.holds) == ("0.910, 0.880, 0.925", "-0.020", False)


def test_row_of_words_names_what_fails() -> None:
    row = asserted("R8", {"charges": True, "most at hour 2": False}, "1, 2, 1 kW", "MPC", "Why.")
    assert (row.quantity, row.verdict) == ("Charging in hours 0 to 2: MPC", "no")
    assert row.reason == "Not met: most at hour 2. Why."


def test_rows_are_ordered_by_number() -> None:
    rows = [asserted(id, {}, "") for id in ("R10", "R9", "R3b", "R3a")]
    assert [row.id for row in sorted(rows, key=order)] == ["R3a", "R3b", "R9", "R10"]


def test_confidence_interval_of_three_values() -> None:
    # Mean 2, standard error 1 / sqrt 3, quantile of Student's t with two degrees of freedom 4.303.
    days = [DayResult({"resilience": value}, {}, {}) for value in (1.0, 2.0, 3.0)]
    point = Point(0.02, days, days)
    assert point.mean(lambda day: day.resilience) == 2.0
    assert point.half_width(lambda day: day.resilience) == pytest.approx(4.3027 / 3**0.5, rel=1e-4)
    assert Point(0.1, days[:1], days).half_width(lambda day: day.resilience) == 0.0


# Configurations


def test_every_experiment_has_its_configuration() -> None:
    assert {file.stem for file in FOLDER.glob("*.toml")} == set(ALL)


@pytest.mark.parametrize("name", ALL)
def test_quick_is_a_smaller_study(name: str) -> None:
    few, all_jobs = (set(ALL[name].jobs(read_config(name, quick))) for quick in (True, False))
    assert 0 < len(few) <= len(all_jobs)
    assert few <= all_jobs


# Report


@pytest.fixture
def report(counted: list[Job], tmp_path: Path) -> Path:
    """The whole quick study with two real days in the place of all."""
    command.reproduce([], tmp_path, quick=True, processes=1)
    return tmp_path


@pytest.mark.nightly
def test_report_has_every_figure_and_statement(report: Path) -> None:
    html = (report / "report.html").read_text(encoding="utf-8")
    markdown = (report / "report.md").read_text(encoding="utf-8")
    for label in ("1a", "1b", "1c", "1d", "2a", "2b", "2c", "2d", "3"):
        assert f"fig:{label}" in html and f"fig:{label}" in markdown
    assert "tab:eff" in html
    for id in STATEMENTS:
        assert f"<td>{id}</td>" in html
        assert f"\n| {id} |" in markdown
    assert html.count("data:image/svg+xml;base64,") == len(EXPERIMENTS)
    assert "http" not in html.replace("http://www.w3.org", "")  # nothing to fetch
    for name in EXPERIMENTS:
        for suffix in (".png", ".svg"):
            assert (report / "figures" / name).with_suffix(suffix).stat().st_size > 5000


def test_every_miss_has_a_measured_reason(counted: list[Job], tmp_path: Path) -> None:
    jobs = [job for name in EXPERIMENTS for job in EXPERIMENTS[name].jobs(read_config(name, True))]
    results, _ = run_jobs(jobs, tmp_path, 1)
    rows = [
        row
        for name in EXPERIMENTS
        for row in EXPERIMENTS[name].rows(read_config(name, True), results)
    ]
    # With H = 0 in the place of every MPC day, much must miss.
    missed = [row for row in rows if not row.holds]
    assert {"R1", "R2", "R13"} <= {row.id for row in missed}
    assert [row.id for row in missed if not any(c.isdigit() for c in row.reason)] == []


# Command line


@pytest.fixture
def invoke(tmp_path: Path) -> Callable[..., tuple[int, str]]:
    """Run the command line into a temporary folder; exit status and all output."""
    app = command.typer.Typer()
    app.command()(command.main)

    def run(*arguments: str) -> tuple[int, str]:
        done = CliRunner().invoke(app, [*arguments, "--results", str(tmp_path), "--jobs", "1"])
        return done.exit_code, done.output

    return run


def test_only_one_experiment(
    counted: list[Job], invoke: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    status, output = invoke("--only", "voltage", "--quick")
    assert status == 0
    assert f"Written to {tmp_path / 'report.html'}" in output.replace("\n", "")
    assert len(counted) == 2
    assert [file.name for file in (tmp_path / "figures").glob("*.png")] == ["voltage.png"]
    assert "0.9607" in output


def test_interrupt_says_that_finished_days_are_kept(
    invoke: Callable[..., tuple[int, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(job: Job) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "simulate", interrupted)
    status, output = invoke("--only", "voltage")
    assert status == INTERRUPTED
    assert "Days that were finished are kept: run again to go on." in output
