"""The engineer's commands: validate, report, compare, sweep, their JSON and their messages."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from doctest import ELLIPSIS, OutputChecker
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tests.support.command_line import call
from tests.support.made_up_runs import small_run, small_scenario
from vppres.cli.commands import app
from vppres.core.errors import InfeasibleError, InputError
from vppres.day.options import RunOptions
from vppres.day.trajectory import Trajectory
from vppres.io import read_scenario, write_scenario
from vppres.report.plots.figures import FIGURES
from vppres.report.run_folder import write_run
from vppres.scenario.scenario import Scenario
from vppres.studies import sweep
from vppres.studies.compare import read_runs
from vppres.studies.sweep_page import sweep_figure
from vppres.studies.sweep_parameters import (
    changed,
    find_parameter,
    read_range,
    read_values,
    value_text,
)

# What a browser would fetch: any source or link that leaves the file, but for links between runs.
OUTWARD = re.compile(r"""(?:src|href)=["'](?!data:|#)([^"']+)|url\((?!#)|@import""")


def better(run: Trajectory) -> Trajectory:
    """The small run with everybody served in its second step and 8 kW more import in the first."""
    customers = run.customers.assign(
        served=run.customers["served"] | (run.customers["time"] == run.steps["time"][1])
    )
    steps = run.steps.assign(p_grid_kw=run.steps["p_grid_kw"] + [8.0, 0.0, 0.0, 0.0])
    return replace(
        run,
        customers=customers,
        steps=steps,
        options={**run.options, "horizon_h": 6.0, "errors": {"load_bias": 0.2}},
    )


@pytest.fixture(scope="module")
def written_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two run folders of the small day that are made up, not solved."""
    home = tmp_path_factory.mktemp("runs")
    write_run(small_run(), home / "plain")
    write_run(better(small_run()), home / "more")
    return home


@pytest.fixture
def two_runs(written_runs: Path, tmp_path: Path) -> list[Path]:
    """Copies of the two run folders, to be spoiled."""
    return [shutil.copytree(written_runs / name, tmp_path / name) for name in ("plain", "more")]


def without_solving(scenario: Scenario, options: RunOptions) -> Trajectory:
    """A made-up run that has the options it was asked for; a horizon of 4 has no answer."""
    if options.horizon_h == 4:
        raise InfeasibleError("Step 2 has no feasible dispatch.")
    run = small_run(scenario)
    return replace(run, options={**run.options, "horizon_h": options.horizon_h})


@pytest.fixture
def small_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The small day as a scenario folder, and runs of it that are not solved."""
    monkeypatch.setattr(sweep, "run_day", without_solving)
    folder = tmp_path / "small"
    write_scenario(small_scenario(), folder)
    return folder


# validate


def test_valid_scenario(tiny_folder: Path) -> None:
    result = call("validate", tiny_folder)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout == (
        "tiny is valid: 4 buses, 3 customers, 2 PV systems, 2 batteries, "
        "6 steps of 60 min, 2 of them without grid; imports only; islands in paper mode.\n"
    )


@pytest.mark.parametrize(
    "options", [["--forecasts", "none.csv"], ["--warnings", "none.csv", "--outages", "none.csv"]]
)
def test_a_missing_file_of_an_option_is_not_looked_for_in_a_scenario(
    tiny_folder: Path, options: list[str]
) -> None:
    told = call("backtest", tiny_folder, *options).stderr
    assert "none.csv: the file is missing. Check the path that was given.\n" in told


def test_one_battery_is_no_batteries(tiny_folder: Path) -> None:
    table = tiny_folder / "batteries.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:2]))
    assert "2 PV systems, 1 battery, 6 steps" in call("validate", tiny_folder).stdout


@pytest.mark.nightly
def test_a_run_folder_has_the_name_of_the_scenario_folder(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Copies of a scenario hold the same name inside: their runs must not replace each other."""
    monkeypatch.chdir(tmp_path)
    for name in ("a", "b"):
        shutil.copytree(tiny_folder, name)
        assert call("validate", name).stdout.startswith(f"{name} is valid: 4 buses")
        told = call("run", name, "--controller", "idle", "--no-figures", "--no-explain").stdout
        assert f"Written to results/{name}-idle" in told
    monkeypatch.chdir("a")  # a folder without a name of its own
    assert "Written to results/a-mpc" in call("run", ".", "--no-figures").stdout


def test_valid_scenario_as_json(tiny_folder: Path) -> None:
    result = call("validate", tiny_folder, "--json")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert (record["folder"], record["valid"], record["problems"]) == (str(tiny_folder), True, [])
    assert record["content"] == {
        "name": "tiny",
        "title": "Four buses, six hours",
        "buses": 4,
        "customers": 3,
        "pv_systems": 2,
        "generators": "2 PV systems",
        "batteries": 2,
        "chargers": 0,
        "ev_sessions": 0,
        "thermal_loads": 0,
        "gensets": 0,
        "steps": 6,
        "step_minutes": 60.0,
        "outage_steps": 2,
        "faults": 0,
        "export": "imports only",
        "mode": "paper",
        "source": {
            "name": "",
            "kind": "",
            "notes": [],
            "unbalanced": "",
            "deviation": {
                "no_load_pu": None,
                "as_given_pu": None,
                "worst_hour_pu": None,
                "opened_pu": None,
            },
        },
        "remarks": [],
    }


def spoil(folder: Path) -> None:
    """Three mistakes in two files, the later row first."""
    (folder / "lines.csv").write_text(
        "from_bus,to_bus,r_ohm,x_ohm\n1,2,0.3,0.2\n2,3,0.4,none\n2,4,-0.5,0.4\n", encoding="utf-8"
    )
    toml = folder / "scenario.toml"
    toml.write_text(
        toml.read_text(encoding="utf-8").replace("steps = 6", "steps = 0"), encoding="utf-8"
    )


def test_all_problems_by_file_and_row(tiny_folder: Path) -> None:
    spoil(tiny_folder)
    result = call("validate", tiny_folder)
    assert (result.exit_code, result.stderr) == (2, "")
    assert result.stdout.splitlines() == [
        "scenario.toml, time.steps = 0: must be at least 1. Give the number of steps.",
        "lines.csv, row 3, x_ohm = none: is not a number. Give the series reactance "
        "(negative: a series capacitor, or a winding of a star) in ohm.",
        "lines.csv, row 4, r_ohm = -0.5: must be at least 1e-07. "
        "Give the series resistance in ohm.",
        "3 problems.",
    ]


def test_problems_as_json(tiny_folder: Path) -> None:
    spoil(tiny_folder)
    result = call("validate", tiny_folder, "--json")
    record = json.loads(result.stdout)
    assert (result.exit_code, record["valid"], record["content"]) == (2, False, None)
    assert [(p["file"], p["row"], p["field"]) for p in record["problems"]] == [
        ("scenario.toml", None, "time.steps"),
        ("lines.csv", 3, "x_ohm"),
        ("lines.csv", 4, "r_ohm"),
    ]
    assert record["problems"][2] == {
        "file": "lines.csv",
        "row": 4,
        "field": "r_ohm",
        "value": "-0.5",
        "message": "must be at least 1e-07",
        "cure": "Give the series resistance in ohm.",
        "more": 0,
        "rows": [],
    }


def test_single_problem_is_counted_in_words(tiny_folder: Path) -> None:
    (tiny_folder / "lines.csv").unlink()
    lines = call("validate", tiny_folder).stdout.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("lines.csv: the file is missing.")
    assert lines[1] == "1 problem."


def test_validate_names_tables_that_no_scenario_has(tiny_folder: Path) -> None:
    (tiny_folder / "tanks.csv").write_text("id,bus\nboiler,3\n", encoding="utf-8")
    said = " ".join(call("validate", tiny_folder).stdout.split())
    assert said.endswith("- tanks.csv is not read: no file of a scenario has this name.")


def test_validate_of_nothing_is_an_error() -> None:
    result = call("validate", "nowhere", "--json")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("scenario nowhere: is neither a packaged scenario nor ")


# What is wrong with options

# Each paragraph is a command and all that it says.
BAD_COMMANDS = (
    (Path(__file__).parent / "bad_commands.txt").read_text(encoding="utf-8").split("\n\n")
)


@pytest.fixture(scope="module")
def two_scenarios(written_tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the scenarios of bad_commands.txt."""
    folder = tmp_path_factory.mktemp("scenarios")
    shutil.copytree(written_tiny, folder / "tiny")
    write_scenario(small_scenario(), folder / "small")
    return folder


@pytest.mark.parametrize("told", BAD_COMMANDS, ids=lambda told: told.partition("\n")[0])
def test_wrong_options_are_told_in_sentences(
    two_scenarios: Path, monkeypatch: pytest.MonkeyPatch, told: str
) -> None:
    monkeypatch.chdir(two_scenarios)
    command, _, words = told.strip().partition("\n")
    result = call(command.removeprefix("$ vppres "), "--out", "out")
    assert (result.exit_code, result.stdout) == (2, "")
    assert OutputChecker().check_output(f"{words}\n", result.stderr, ELLIPSIS), result.stderr
    assert sorted(path.name for path in Path().iterdir()) == ["small", "tiny"]


# JSON of run and scenarios


def test_run_as_json(tiny_folder: Path, tmp_path: Path) -> None:
    result = call(
        "run", tiny_folder, "--horizon", 0, "--no-figures", "--out", tmp_path / "run", "--json"
    )
    assert (result.exit_code, result.stderr) == (0, "")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert json.loads(result.stdout) == {"folder": str(tmp_path / "run"), "summary": summary}


def test_scenarios_as_json() -> None:
    records = json.loads(call("scenarios", "--json").stdout)
    assert [r["name"] for r in records] == [
        "two-outages-cigre-mv",
        "uk-heatwave-2022",
        "village-hot-week",
    ]
    assert all(read_scenario(r["folder"]).name == r["name"] for r in records)


# report


def test_report_is_drawn_again(two_runs: list[Path]) -> None:
    file = two_runs[0] / "report.html"
    old = file.read_text(encoding="utf-8")
    file.unlink()
    result = call("report", two_runs[0])
    assert (result.exit_code, result.stdout) == (0, f"Written to {file}\n")
    assert file.read_text(encoding="utf-8") == old


def test_report_keeps_recorded_figures_and_adds_missing_ones(
    two_runs: list[Path], tmp_path: Path
) -> None:
    summary_file = two_runs[0] / "summary.json"
    summary = json.loads(summary_file.read_text(encoding="utf-8"))
    del summary["v_mean_of_min_ac_pu"]  # as if an older version had written it
    summary["versions"]["vppres"] = "0.0.1"
    summary_file.write_text(json.dumps(summary), encoding="utf-8")
    out = tmp_path / "pages" / "report.html"
    assert call("report", two_runs[0], "--out", out).exit_code == 0
    text = out.read_text(encoding="utf-8")
    assert "vppres 0.0.1," in " ".join(text.split())
    assert '<td class="n">0.9650</td><td>pu</td>' in text  # mean of 0.98, 0.97, 0.96, 0.95
    # The scripts are tried in a browser: tests/report/test_report_browser.py.
    assert OUTWARD.findall(re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)) == []


@pytest.mark.parametrize(("spoiled", "message"), [
    (lambda run: shutil.rmtree(run), "there is no such folder. Give a folder written by a run."),
    (lambda run: (run / "pv.parquet").unlink(), "has no pv.parquet. Give a folder written by"),
    (lambda run: (run / "summary.json").unlink(), "has no summary.json. Give a folder written by"),
    (lambda run: (run / "summary.json").write_text("{"), "summary.json: is not valid JSON (Expec"),
    (lambda run: (run / "summary.json").write_text("[]"), "summary.json: is not a table of fig"),
    (lambda run: (run / "options.json").write_text("{"), "cannot be read (Expecting property"),
    (lambda run: (run / "pv.parquet").write_text("id"), "cannot be read ("),
])  # fmt: skip
def test_broken_run_folder(two_runs: list[Path], spoiled: Any, message: str) -> None:
    spoiled(two_runs[0])
    result = call("report", two_runs[0])
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith(str(two_runs[0]))
    assert message in result.stderr


def test_report_of_a_file(two_runs: list[Path]) -> None:
    file = two_runs[0] / "summary.json"
    assert call("report", file).stderr == (
        f"{file}: is not a folder. Give a folder written by a run.\n"
    )


@pytest.mark.parametrize("name", ["x.txt", "report.pdf", "report"])
def test_a_report_of_another_format_is_refused(
    two_runs: list[Path], tmp_path: Path, name: str
) -> None:
    result = call("report", two_runs[0], "--out", tmp_path / name)
    assert result.exit_code == 2 and not (tmp_path / name).exists()
    assert result.stderr.endswith(
        f"{name}: does not end in .html, the format of the file. Give a name that ends in .html.\n"
    )


def test_page_that_cannot_be_written(two_runs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "letter").write_text("keep", encoding="utf-8")
    result = call("report", two_runs[0], "--out", tmp_path / "letter" / "report.html")
    assert result.exit_code == 2
    assert "cannot be written (" in result.stderr
    assert (tmp_path / "letter").read_text(encoding="utf-8") == "keep"


# compare


def test_compare_by_hand(two_runs: list[Path], tmp_path: Path) -> None:
    result = call("compare", *two_runs, "--out", tmp_path / "both.html", "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    record = json.loads(result.stdout)
    assert record["report"] == str(tmp_path / "both.html")
    assert record["same_scenario"] is True
    assert [run["label"] for run in record["runs"]] == ["plain", "more"]
    figures = {row["key"]: row for row in record["figures"]}
    # Weights 1, 0.1, 0.2 over two outage steps; b and c, weights 0.3, come on in one of them.
    assert figures["resilience"]["values"] == pytest.approx([1.1 / 2.6, 1.4 / 2.6])
    assert figures["resilience"]["differences"] == pytest.approx([0.0, 0.3 / 2.6])
    # 8 kW for half an hour at 0.1 GBP/kWh.
    assert figures["import_kwh"]["differences"] == pytest.approx([0.0, 4.0])
    assert figures["cost_gbp"]["differences"] == pytest.approx([0.0, 0.4])
    assert figures["served_share.low"]["values"] == pytest.approx([0.25, 0.75])


@pytest.mark.daily
def test_compare_prints_and_writes_one_page(two_runs: list[Path], tmp_path: Path) -> None:
    result = call("compare", *two_runs, "--out", tmp_path / "pages")
    assert result.exit_code == 0
    assert "(+0.1154)" in result.stdout
    page = tmp_path / "pages" / "comparison.html"
    assert result.stdout.endswith(f"Written to {page}\n")
    text = page.read_text(encoding="utf-8")
    assert OUTWARD.findall(text) == []
    assert text.count('<figure class="plot">') == len(FIGURES)
    assert text.count("draws up to 102.0 kW from the slack bus") == 2  # a finding of each run
    assert '<td class="n">0.5385</td><td class="n change">+0.1154</td>' in text
    assert "<tr><td>horizon h</td><td>5</td><td>6</td></tr>" in text
    assert "<tr><td>errors, load bias</td><td>0.1</td><td>0.2</td></tr>" in text
    assert "<td>seed</td>" not in text  # the same in both
    assert '<tr><td>b</td><td>low</td><td class="n">0.50</td><td class="n">0.00</td>' in text
    assert "The runs differ in their scenario." not in text


def test_compare_equal_runs(two_runs: list[Path], tmp_path: Path) -> None:
    shutil.copytree(two_runs[0], tmp_path / "copy")
    result = call("compare", two_runs[0], tmp_path / "copy", "--out", tmp_path / "both.html")
    assert result.output.splitlines()[0] == "All figures are equal."
    text = (tmp_path / "both.html").read_text(encoding="utf-8")
    assert "None: the runs had the same options." in text
    assert "None: every customer was off supply for the same time in each run." in text


def test_compare_says_that_scenarios_differ(two_runs: list[Path], tmp_path: Path) -> None:
    day = small_scenario()
    write_run(small_run(replace(day, load_kw=day.load_kw * 2)), tmp_path / "double", figures=False)
    call("compare", two_runs[0], tmp_path / "double", "--out", tmp_path / "both.html")
    assert "The runs differ in their scenario." in (tmp_path / "both.html").read_text("utf-8")


def test_runs_of_one_name_are_labelled_by_their_paths(two_runs: list[Path], tmp_path: Path) -> None:
    other = tmp_path / "b" / "plain"
    shutil.copytree(two_runs[0], other)
    assert list(read_runs([two_runs[0], other, two_runs[1]])) == [
        str(two_runs[0]),
        str(other),
        "more",
    ]


@pytest.mark.parametrize(("choose", "message"), [
    (lambda a, b: [a], "compare: needs two runs or more. Give another run folder.\n"),
    (lambda a, b: [a, b, a], "{a}: is given more than once. Give each run folder once.\n"),
    (lambda a, b: [a, b, b.parent / "more" / ".." / "more"],
        "{b}: is given more than once. Give each run folder once.\n"),
    (lambda a, b: [a, b, "c", "d", "e", "f"],
        "compare: can tell 5 runs apart in a figure, and was "
        "given 6. Leave some out, or compare them in parts.\n"),
    (lambda a, b: [a, b / "x"],
        "{b}/x: there is no such folder. Give a folder written by a run.\n"),
])  # fmt: skip
def test_runs_that_cannot_be_compared(two_runs: list[Path], choose: Any, message: str) -> None:
    result = call("compare", *choose(*two_runs))
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == message.format(a=two_runs[0], b=two_runs[1])


def test_runs_of_different_days(two_runs: list[Path], tmp_path: Path) -> None:
    write_run(small_run(small_scenario(step_minutes=15.0)), tmp_path / "quarters", figures=False)
    result = call("compare", two_runs[0], tmp_path / "quarters", "--out", tmp_path / "x.html")
    assert result.exit_code == 2
    assert result.stderr == (
        f"{tmp_path / 'quarters'}: has 4 steps of 15 min from 2022-07-19 00:00:00+00:00, "
        f"{two_runs[0]} has 4 of 30 min from 2022-07-19 00:00:00+00:00. "
        "Compare runs of the same day.\n"
    )
    assert not (tmp_path / "x.html").exists()


def test_runs_of_other_clocks_and_weights_are_laid_over_each_other(
    two_runs: list[Path], tmp_path: Path
) -> None:
    day = small_scenario()
    other = replace(
        day,
        grid=replace(day.grid, zone="Australia/Lord_Howe"),
        customers=replace(day.customers, weight=2.0 * day.customers.weight),
    )
    write_run(small_run(other), tmp_path / "far", figures=False)
    result = call("compare", two_runs[0], tmp_path / "far", "--out", tmp_path / "x.html")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "The runs differ in their scenario." in result.stdout
    assert "Lord_Howe" not in (tmp_path / "x.html").read_text(encoding="utf-8")


# sweep


@pytest.mark.nightly
def test_sweep_solves_in_parallel(tiny_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    result = call(
        "sweep --param horizon --values 2,0 --jobs 2 --load-bias 0.1", tiny_folder, "--out", out
    )
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout.endswith(f"Written to {out}\n")
    alone = tmp_path / "alone"
    assert (
        call("run", tiny_folder, "--horizon", 2, "--load-bias", 0.1, "--out", alone).exit_code == 0
    )
    runs = read_runs([alone, out / "horizon=2", out / "horizon=0"])
    assert [run.summary["horizon_h"] for run in runs.values()] == [2.0, 2.0, 0.0]
    assert [run.summary["options"]["errors"]["load_bias"] for run in runs.values()] == [0.1] * 3
    assert runs["alone"].summary["cost_gbp"] == runs["horizon=2"].summary["cost_gbp"]
    table = pd.read_csv(out / "summary.csv")
    assert table["value"].tolist() == [2.0, 0.0]
    assert table["folder"].tolist() == ["horizon=2", "horizon=0"]
    assert table["resilience"].tolist() == pytest.approx(
        [runs[name].summary["resilience"] for name in ("horizon=2", "horizon=0")]
    )


@pytest.mark.nightly
def test_sweep_writes_table_page_and_figure(small_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    result = call(
        "sweep --param scale.load --range 1:2:3 --jobs 1 --json", small_folder, "--out", out
    )
    assert (result.exit_code, result.stderr) == (0, "")
    record = json.loads(result.stdout)
    assert (record["folder"], record["parameter"]) == (str(out), "scale.load")
    assert [run["folder"] for run in record["runs"]] == [
        "scale.load=1",
        "scale.load=1.5",
        "scale.load=2",
    ]
    assert sorted(path.name for path in out.iterdir()) == [
        "scale.load=1", "scale.load=1.5", "scale.load=2", "summary.csv", "summary.json",
        "sweep.html", "sweep.png", "sweep.svg",
    ]  # fmt: skip
    loads = [
        read_scenario(out / run["folder"] / "scenario").load_kw[0, 0] for run in record["runs"]
    ]
    assert loads == pytest.approx([10.0, 15.0, 20.0])
    text = (out / "sweep.html").read_text(encoding="utf-8")
    links = [
        "scale.load%3D1/report.html",
        "scale.load%3D1.5/report.html",
        "scale.load%3D2/report.html",
    ]
    assert OUTWARD.findall(text) == links
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["runs"] == record["runs"]


@pytest.mark.daily
def test_failed_run_does_not_end_the_others(small_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    result = call(
        "sweep", small_folder, "--param", "horizon", "--values", "4,5", "--out", out, "--jobs", 1
    )
    assert result.exit_code == 1
    assert result.stderr == "horizon = 4.0: Step 2 has no feasible dispatch.\n"
    assert "failed" in result.stdout
    table = pd.read_csv(out / "summary.csv")
    assert table["error"].fillna("").tolist() == ["Step 2 has no feasible dispatch.", ""]
    assert table["resilience"].notna().tolist() == [False, True]
    assert not (out / "horizon=4").exists()
    text = (out / "sweep.html").read_text(encoding="utf-8")
    assert re.search(r'class="error" colspan="\d+">Step 2 has no feasible dispatch.<', text)


@pytest.mark.nightly
def test_sweep_replaces_a_sweep_and_nothing_else(small_folder: Path, tmp_path: Path) -> None:
    arguments = ["sweep", small_folder, "--param", "seed", "--jobs", 1]
    for values in ("1,2", "3"):
        assert call(*arguments, "--values", values, "--out", tmp_path / "s").exit_code == 0
    assert [path.name for path in (tmp_path / "s").glob("seed=*")] == ["seed=3"]
    result = call(*arguments, "--values", "1", "--out", small_folder)
    assert result.exit_code == 2
    assert "exists and is not a run folder" in result.stderr
    assert (small_folder / "scenario.toml").is_file()


def test_interrupted_sweep_leaves_nothing(
    small_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "write_run", interrupt)
    result = call("sweep --param seed --values 1,2 --jobs 1", small_folder, "--out", tmp_path / "s")
    assert (result.exit_code, result.stderr) == (130, "Interrupted; nothing was written.\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small"]


def test_unknown_solver_ends_the_sweep(tiny_folder: Path, tmp_path: Path) -> None:
    result = call(
        "sweep --param solver --values glpk --jobs 1", tiny_folder, "--out", tmp_path / "s"
    )
    assert (result.exit_code, result.stdout) == (2, "")
    assert "solver = glpk: is not a known solver (highs, scip)" in result.stderr
    assert not (tmp_path / "s").exists()


def test_outage_hours_of_a_day_with_two_outages() -> None:
    day = replace(small_scenario(), grid_limit_kw=[0.0, np.inf, 0.0, np.inf])
    with pytest.raises(InputError, match=r"scenario: has not exactly one outage\. Sweep the"):
        changed(find_parameter("outage.hours", day), 1.0, day, RunOptions())


# What the parameters change


def varied(name: str, value: float) -> Scenario:
    """The small day with one parameter changed."""
    day = small_scenario()
    return changed(find_parameter(name, day), value, day, RunOptions())[0]


def test_scenario_parameters_by_hand() -> None:
    assert varied("outage.hours", 1.5).outage.tolist() == [False, True, True, True]
    assert varied("outage.hours", 0).outage.tolist() == [False] * 4
    assert varied("scale.load", 2).load_kw[0].tolist() == [20.0, 40.0, 80.0]
    assert varied("scale.price", 0.5).price_gbp_per_kwh.tolist() == [0.05, 0.1, 0.15, 0.2]
    pv = varied("scale.pv", 2)
    assert (pv.pv.p_max_kw[0], pv.pv.s_max_kva[0], pv.pv_kw[0, 0]) == (60.0, 80.0, 24.0)
    battery = varied("scale.batteries", 2).batteries
    assert (battery.energy_kwh[0], battery.p_max_kw[0], battery.s_max_kva[0]) == (200, 100, 200)
    assert varied("batteries.soc_max", 0.7).batteries.soc_max.tolist() == [0.7]
    assert varied("tiers.critical", 5).customers.weight.tolist() == [5.0, 0.1, 0.2]
    assert varied("network.v_min_pu", 0.95).network.v_min_pu == 0.95
    assert varied("objective.lambda_curt", 0.2).objective.lambda_curt == 0.2


def test_nothing_is_left_at_scale_zero() -> None:
    assert varied("scale.pv", 0).pv_kw.shape == (4, 0)
    assert len(varied("scale.batteries", 0).batteries) == 0


def test_range_has_both_ends_and_plain_decimals() -> None:
    horizon = find_parameter("horizon", small_scenario())
    assert read_range(horizon, "0:0.3:4") == [0.0, 0.1, 0.2, 0.3]
    assert read_range(horizon, "5:1:3") == [5.0, 3.0, 1.0]
    seed = find_parameter("seed", small_scenario())
    assert [value_text(v) for v in read_range(seed, "0:4:3")] == ["0", "2", "4"]


def test_values_may_have_spaces() -> None:
    controller = find_parameter("controller", small_scenario())
    assert read_values(controller, "mpc, full-horizon") == ["mpc", "full-horizon"]


def test_figure_orders_numbers_and_leaves_a_gap() -> None:
    summaries = {2.0: {"resilience": 0.2}, 1.0: None, 0.0: {"resilience": 0.0}}
    outcomes = [sweep.SweepRow(value, "", summary, None) for value, summary in summaries.items()]
    figure = sweep_figure("horizon", outcomes, ("critical",))
    assert figure.across.places.tolist() == [0.0, 1.0, 2.0]
    (curve,) = figure.panels[1].curves
    np.testing.assert_array_equal(curve.values, [0.0, np.nan, 0.2])
    assert curve.joined
    left, right = figure.time.edges[[0, 2]]
    dots = re.findall(r"M([\d.]+) [\d.]+h\.1", figure.svg())
    assert dots == [f"{left:.1f}", f"{right:.1f}"]


def test_figure_names_words_on_its_axis() -> None:
    outcomes = [sweep.SweepRow(value, "", {"resilience": 0.5}, None) for value in ("mpc", "full")]
    figure = sweep_figure("controller", outcomes, ("critical",))
    assert [name for _, name in figure.time.ticks()] == ["mpc", "full"]
    # There is nothing between two words.
    assert not any(curve.joined for panel in figure.panels for curve in panel.curves)


# Completion


@pytest.mark.parametrize(("words", "expected"), [
    ("vppres run uk", "uk-heatwave-2022"),
    ("vppres val", "validate"),
    ("vppres sweep x --ran", "--range"),
])  # fmt: skip
def test_shell_completion(words: str, expected: str) -> None:
    asked = {"_VPPRES_COMPLETE": "complete_bash", "COMP_WORDS": words}
    asked["COMP_CWORD"] = str(len(words.split()) - 1)
    done = CliRunner().invoke(app, [], prog_name="vppres", env=asked)
    assert (done.exit_code, done.stdout.split()) == (0, [expected])
