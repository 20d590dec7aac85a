"""The benchmarks' machinery: instances, a tiny run end to end, and the arithmetic of the tables."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import typer
from matplotlib.figure import Figure
from typer.testing import CliRunner

import benchmarks.__main__ as command
from benchmarks import deadlines, make_instances, profiles
from benchmarks.clock import in_fresh_process, peak_memory_mb
from benchmarks.deadlines import by_processor, deadline_table, measure, windows
from benchmarks.feeders import FEEDERS, feeder_scenario, with_days, with_step
from benchmarks.findings import deadline_bars, scaling_bars
from benchmarks.frame.store import Store
from benchmarks.instances import Instance, packaged, read_instances, window_data
from benchmarks.report import BEGIN, END, Section, publish
from benchmarks.scaling import exponent
from benchmarks.throughput import rates, throughput_table
from benchmarks.windows import NOT_ADMITTED
from benchmarks.worker import summary
from vppres.physics.powerflow import ACPowerFlow
from vppres.solve.deadline import Stopwatch

INSTANCES = read_instances()


# Instances


def test_table_is_what_its_generator_writes() -> None:
    assert make_instances.draw() == INSTANCES


@pytest.mark.parametrize("instance", INSTANCES[::17], ids=lambda instance: instance.name)
def test_a_row_determines_its_window(instance: Instance) -> None:
    one, other = window_data(instance), window_data(instance)
    for name in ("load_kw", "pv_kw", "soc", "delta_pu2", "grid_limit_kw"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert one.n_steps == instance.steps
    assert one.load_kw[0] == pytest.approx(packaged().load_kw[instance.t0] * instance.load_factor)
    assert ((one.soc >= 0.15) & (one.soc <= 0.85)).all()


# Tables, on data worked out by hand


def rows_of(seconds: dict[str, list[float | None]], limit_s: float = 60.0) -> pd.DataFrame:
    """Rows of methods; a time at the limit is unsolved, None is not admitted."""
    status = {True: "time_limit", False: "optimal"}
    return pd.DataFrame(
        [
            {
                "instance": f"i{k}",
                "method": method,
                "limit_s": limit_s,
                "solve_s": np.nan if s is None else s,
                "status": NOT_ADMITTED if s is None else status[s >= limit_s],
            }
            for method, values in seconds.items()
            for k, s in enumerate(values)
        ]
    )


def test_profile_by_hand() -> None:
    # Ratios to the best: a is 1, 2, 1, inf; b is 3, 1, inf, inf (nobody solves the last one).
    rows = rows_of({"a": [1.0, 2.0, 5.0, 60.0], "b": [3.0, 1.0, 60.0, 60.0]})
    shares = profiles.profile(profiles.times(rows), np.array([1.0, 2.0, 3.0, 100.0]))
    assert shares["a"].tolist() == [0.5, 0.75, 0.75, 0.75]
    assert shares["b"].tolist() == [0.25, 0.25, 0.5, 0.5]


def test_instances_that_a_licence_refuses_are_no_loss() -> None:
    rows = rows_of({"a": [1.0, 1.0], "b": [4.0, None]})
    assert profiles.profile(profiles.times(rows), np.array([4.0]))["b"].tolist() == [1.0]
    (table,) = profiles.ratios(rows, base="a").to_dict("records")
    assert (table["instances"], table["not admitted"], table["unsolved"]) == (1, 1, 0)
    assert table["ratio median"] == 4.0


def test_unsolved_instances_enter_the_ratios_with_their_limit() -> None:
    rows = rows_of({"a": [1.0, 2.0, 4.0], "b": [10.0, 60.0, 60.0]})
    (table,) = profiles.ratios(rows, base="a").to_dict("records")
    assert table["ratio median"] == 15.0  # of 10, 30 and 15
    assert table["median at most"] == np.inf  # 10 and twice no end
    assert table["unsolved"] == 2
    assert table["share slower"] == 1.0


def test_long_solves_are_split_from_short_ones_by_the_method_in_question() -> None:
    rows = rows_of({"a": [9.0, 0.1, 0.1], "b": [0.5, 1.5, 1.0]})
    long, short = profiles.split_by_time(rows, "b", 1.0)
    assert long["solve_s"].tolist() == [0.1, 1.5]
    assert short["solve_s"].tolist() == [9.0, 0.1, 0.5, 1.0]


def test_certificate_needs_both_gaps_and_the_time() -> None:
    rows = pd.DataFrame(
        {
            "gap": [1e-4, 2e-4, 1e-5, 1e-5, np.nan],
            "gap_abs": [5e-3, 1e-3, 6e-3, 1e-3, np.nan],
            "solve_s": [10.0, 1.0, 1.0, 11.0, 60.0],
        }
    )
    assert profiles.certified(rows).tolist() == [True, False, False, False, False]


def test_agreement_is_one_sided() -> None:
    base = profiles.BASE
    rows = pd.DataFrame(
        [
            {"instance": "i", "method": method, "status": "optimal", "value": value, "bound": bound}
            for method, value, bound in (
                (base, 50.0, 50.0),
                ("monolithic/x", 49.9, 49.95),
                ("monolithic/y", 50.01, 50.01),
            )
        ]
    )
    x, y = profiles.agreement(rows).to_dict("records")
    assert (x["agree"], y["agree"]) == (1, 0)
    assert x["above"] == pytest.approx(0.1 / 49.9)
    assert x["above bound"] == pytest.approx(0.05 / 49.9)
    assert y["below"] == pytest.approx(0.01 / 50.01)


def test_exponent_and_its_interval() -> None:
    size = np.array([1.0, 2.0, 4.0, 8.0])
    fit = exponent(size, 3.0 * size**1.25 * np.array([1.1, 0.9, 0.9, 1.1]))
    # The disturbance is orthogonal to a line in log(size): the slope is unharmed.
    assert fit.value == pytest.approx(1.25)
    assert fit.low < 1.25 < fit.high
    assert fit.high - fit.value == pytest.approx(fit.value - fit.low)


def test_throughput_by_hand() -> None:
    # Two processes start and compile for 10 s; then ten days end, one each second.
    row = rates([10.0, 10.0, *np.arange(11.0, 21.0)], [2.0] * 12, processes=2)
    assert row["days_per_min"] == pytest.approx(60.0 * 12 / 20.0)
    assert row["days_per_min_warm"] == pytest.approx(60.0)
    (table,) = throughput_table({**row, "days": 12, "processes": 2}).to_dict("records")
    assert table["min for 1,000 days (extrapolated)"] == pytest.approx(8.0 / 60.0 + 1000 / 60.0)


# Feeders and days


@pytest.mark.parametrize("n_buses", [n for n in FEEDERS if n < 300])
def test_feeders_have_the_packaged_density(n_buses: int) -> None:
    day, ours = packaged(), feeder_scenario(n_buses)
    assert ours.network.n_buses == n_buses
    for table in ("pv", "batteries"):
        mine, theirs = (getattr(s, table).p_max_kw.sum() / s.load_kw.sum() for s in (ours, day))
        assert mine == pytest.approx(theirs, rel=1e-3)
    share = [np.mean(s.customers.tier == "critical") for s in (ours, day)]
    assert share[0] == pytest.approx(share[1], abs=1 / len(ours.customers) + 0.03)
    assert (ours.pv.s_max_kva >= ours.pv.p_max_kw).all()


def test_every_feeder_is_as_weak_as_the_packaged_one() -> None:
    lowest = []
    for day in (packaged(), feeder_scenario(33), feeder_scenario(115)):
        at, t = day.network.place(day.customers.bus), int(day.load_kw.sum(axis=1).argmax())
        flow = ACPowerFlow(day.network).solve(-(at @ day.load_kw[t]), -(at @ day.load_kvar[t]))
        lowest.append(flow.v_pu.min())
    # Equal lossless drops; the AC losses differ a little with the tree.
    assert lowest == pytest.approx([lowest[0]] * 3, abs=0.004)


def test_days_and_finer_steps_keep_the_energy() -> None:
    day = packaged()
    energy = day.load_kw.sum()
    assert with_days(day, 2).load_kw.sum() == pytest.approx(2 * energy)
    fine = with_step(day, 15)
    assert fine.load_kw.sum() * fine.grid.dt_h == pytest.approx(energy)
    assert fine.outage.sum() == 4 * day.outage.sum()


def test_bars_of_size_need_proofs_and_enough_windows() -> None:
    """1,021 buses with one window open miss their bar; a large gap of 3,000 buses does too."""
    row = {"axis": "buses", "windows": 24, "certified": 24, "p95_s": 2.0, "max_s": 4.0}
    row |= {"gap_max": 1e-5, "median_s": 1.0, "mean_s": 1.0, "first_s": 1.0, "memory_mb": 500.0}
    sizes = (33, 1021, 2993, 9997)
    rows = pd.DataFrame([row | {"size": size, "n_steps": 6} for size in sizes])
    steps = rows.head(2).assign(axis="steps", size=[1, 6], n_steps=[1, 6])
    rows = pd.concat([rows, steps], ignore_index=True)
    assert [bar.met for bar in scaling_bars(rows)] == [True] * 7
    rows.loc[rows["size"] == 1021, "certified"] = 23
    rows.loc[rows["size"] == 2993, "gap_max"] = 2e-3
    rows.loc[rows["size"] == 9997, "memory_mb"] = 5000.0
    rows.loc[rows["size"] == 33, "windows"] = 6
    met = [bar.met for bar in scaling_bars(rows)]
    assert met == [True, True, False, False, True, False, False]


# Runs


def test_finished_rows_are_not_measured_again(tmp_path: Path) -> None:
    calls: list[int] = []

    def measure() -> dict[str, float]:
        calls.append(1)
        return {"solve_s": 1.5}

    first, second = (Store(tmp_path).row({"instance": "o001"}, measure) for _ in range(2))
    assert first == second == {"instance": "o001", "solve_s": 1.5}
    assert len(calls) == 1
    Store(tmp_path).row({"instance": "o002"}, measure)
    assert len(calls) == 2


@pytest.mark.nightly
def test_tiny_run_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = [i for i in INSTANCES if i.steps == 1][:2]
    monkeypatch.setattr(command.Plan, "instances", lambda plan: tiny)
    result = CliRunner().invoke(
        app(), ["--quick", "--only", "windows", "--jobs", "1", "--results", str(tmp_path)]
    )
    assert result.exit_code == 0, result.output
    rows = pd.read_parquet(tmp_path / "windows.parquet")
    solved = rows[rows["status"] == "optimal"].groupby("method")["instance"].count()
    for method in (
        "decomposed/highs",
        "decomposed/scip",
        "monolithic/highs/16-gon",
        "monolithic/scip/16-gon",
        "monolithic/scip/cones",
    ):
        assert solved[method] == 2
    assert (profiles.agreement(rows)["below"] <= 1e-4).all()
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| ordinary instances certified within 10 s: 100% | 100.0% of 2 | yes |" in report
    assert (tmp_path / "report.html").is_file()
    assert {"profile.png", "profile.svg"} <= {f.name for f in (tmp_path / "figures").iterdir()}


@pytest.mark.nightly
def test_isolation_is_measured_on_equal_answers(tmp_path: Path) -> None:
    result = CliRunner().invoke(app(), ["--only", "worker", "--quick", "--results", str(tmp_path)])
    assert result.exit_code == 0, result.output
    (row,) = pd.read_parquet(tmp_path / "worker.parquet").to_dict("records")
    assert row["equal"] == row["steps"] == 24
    # The processor's time does not depend on what else the machine does, but for its caches.
    assert 0.5 < row["cpu_ratio_of_sums"] < 1.5
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "| the same answers in both | 24 of 24 steps | yes |" in report


def test_isolation_by_hand() -> None:
    steps = pd.DataFrame(
        {
            "here_s": [1.0, 2.0, 4.0],
            "there_s": [1.1, 2.0, 4.9],
            "here_cpu_s": [1.0, 1.0, 2.0],
            "there_cpu_s": [1.0, 2.0, 3.0],
            "equal": [True, True, False],
        }
    )
    row = summary(steps)
    assert (row["steps"], row["equal"], row["here_median_s"]) == (3, 2, 2.0)
    assert row["ratio_median"] == pytest.approx(1.1)
    assert row["ratio_of_sums"] == pytest.approx(8.0 / 7.0)
    assert (row["cpu_ratio_median"], row["cpu_ratio_of_sums"]) == (1.5, 1.5)


def app() -> typer.Typer:
    """The command as a typer application."""
    application = typer.Typer()
    application.command()(command.main)
    return application


def test_tables_take_the_place_of_older_ones(tmp_path: Path) -> None:
    document = tmp_path / "benchmarks.md"
    document.write_text(f"Before.\n\n{BEGIN}\nold\n{END}\n\nAfter.\n", encoding="utf-8")
    figure = Figure(figsize=(2.0, 1.0))
    figure.subplots().plot([0.0, 1.0])
    section = Section(
        "Windows",
        "Words.",
        (pd.DataFrame({"steps": [6], "share": [0.5]}),),
        {"all_windows": figure},
    )
    publish([section], document, "A run.")
    text = document.read_text(encoding="utf-8")
    assert text.startswith(f"Before.\n\n{BEGIN}\nA run. ")
    assert (
        "### Windows\n\nWords.\n\n```{csv-table}\n:file: _static/benchmarks/windows-1.csv" in text
    )
    assert "\n\n![all windows](_static/benchmarks/all_windows.svg)\n" in text
    folder = tmp_path / "_static" / "benchmarks"
    assert {file.name for file in folder.iterdir()} == {"all_windows.svg", "windows-1.csv"}
    assert (folder / "windows-1.csv").read_text() == "steps,share\n6,0.5\n"
    assert text.endswith(f"{END}\n\nAfter.\n")
    assert "old" not in text


def test_stressed_answers_are_counted_by_what_binds() -> None:
    rows = pd.DataFrame(
        {
            "method": [profiles.BASE] * 5 + ["other"],
            "group": ["stressed"] * 4 + ["ordinary", "stressed"],
            "v_min_pu": [0.947, 0.96, 0.947, 0.96, 0.947, 0.947],
            "curtailed_kwh": [0.0, 5.0, 5.0, 0.0, 5.0, 5.0],
        }
    )
    assert profiles.stress(rows).to_dict("records") == [
        {"stressed instances": 4, "at the voltage limit": 2, "curtailed": 2, "either": 3}
    ]


# Deadlines.


def solved_late(buses: int, first_s: float, again_s: float, ending: str) -> dict[str, object]:
    return {
        "window": "one", "buses": buses, "limit_s": 1.0, "load": 2.0, "first_ending": "LimitError",
        "first_late_s": first_s, "first_late_cpu_s": 0.1, "again_ending": ending,
        "again_late_s": again_s, "again_late_cpu_s": 0.0,
    }  # fmt: skip


def test_deadlines_by_hand() -> None:
    rows = pd.DataFrame(
        [solved_late(33, 0.5, 0.51, "optimal"), solved_late(1021, 2.0, 0.0, "NumericalError")]
    )
    small, large, named = deadline_bars(rows)
    assert (small.measured, small.met) == ("1 of 2, latest 0.51 s, 0.10 s of processor", False)
    assert (large.measured, large.met) == ("2 of 2, latest 2.00 s, 0.10 s of processor", True)
    assert (named.measured, named.met) == ("NumericalError", False)
    assert len(deadline_table(rows)) == 4


def test_deadlines_are_shown_by_limit_and_turn(capsys: pytest.CaptureFixture[str]) -> None:
    """The windows had been measured for minutes when the table lacked their names."""
    deadlines.main(every=len(read_instances()), large=0, limit=[1.0, 10.0])
    head, *lines = filter(str.strip, capsys.readouterr().out.splitlines())
    assert head.split()[:2] == ["buses", "limit"]
    shown = [tuple(line.split()[2:4]) for line in lines]
    assert shown == [("1.0", "again"), ("1.0", "first"), ("10.0", "again"), ("10.0", "first")]


def test_windows_are_measured_in_both_turns() -> None:
    (window,) = windows(read_instances()[:1], large=0)
    with by_processor():
        watch = Stopwatch()
        time.sleep(0.2)
        assert watch.spent_s < 0.1
        row = measure(window, 10.0)
    assert (row["buses"], row["steps"]) == (33, window.data.n_steps)
    assert row["first_ending"] == row["again_ending"] == "optimal"
    assert row["first_late_s"] == row["again_late_s"] == 0.0


@pytest.mark.nightly
def test_a_process_is_told_its_own_memory() -> None:
    held = np.ones(100_000_000)
    assert peak_memory_mb() > held.nbytes / 1e6
    assert in_fresh_process(peak_memory_mb) < peak_memory_mb() - 300.0
