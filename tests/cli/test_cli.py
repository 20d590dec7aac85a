"""The command line: exit statuses, plain errors, nothing half written, and a light start."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest
import typer

import vppres
from tests.support.command_line import call
from tests.support.offenders import assert_for_all
from vppres.cli import commands as cli
from vppres.cli import progress
from vppres.cli.progress import progress_bar
from vppres.day import simulate
from vppres.scenario.option_table import IMPORT_OPTIONS

NOT_OF_A_RUN = (
    "distributed", "fastapi", "matplotlib", "networkx", "opendssdirect", "pandapower", "resvg_py",
    "sqlalchemy",
)  # fmt: skip
"""What other commands need, and no run."""

HEAVY = ("cvxpy", "matplotlib", "numpy", "pandapower", "pandas", "scipy")
NOT_OF_VALIDATE = ("cvxpy", "highspy", "matplotlib", "pandapower", "pyscipopt")

STARTS = """
import sys
from vppres.cli.commands import app

def loaded(names, *arguments):
    app(arguments, standalone_mode=False)
    print("loaded", [name for name in names if name in sys.modules])
"""
"""What a process says of the libraries that commands loaded, one after the other."""


def lines_of(code: str, *arguments: object) -> list[str]:
    """What a process prints that runs commands."""
    command = [sys.executable, "-c", STARTS + code, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.splitlines()


def names_below(folder: Path) -> list[str]:
    """What a folder holds, hidden names included."""
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.daily
def test_commands_load_only_what_they_need() -> None:
    code = f"loaded({HEAVY}, '--help')\nloaded({HEAVY}, '--version')\n"
    code += f"loaded({NOT_OF_VALIDATE}, 'validate', 'uk-heatwave-2022')"
    said = [line for line in lines_of(code) if line.startswith("loaded")]
    assert said == ["loaded []"] * 3


@pytest.mark.daily
def test_a_run_with_its_report_prints_its_figures_and_loads_what_it_needs(
    tiny_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    options = (
        "--horizon 2 --load-bias 0.1 --pv-error 0.05 --seed 3 --thermal exact --gap 1e-3 "
        "--time-limit 30"
    )
    code = f"loaded({NOT_OF_A_RUN}, 'run', *sys.argv[1:])"
    *said, written, loaded = lines_of(code, tiny_folder, "--out", out, *options.split())
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    figures = "\n".join(said)
    assert f"{summary['resilience']:.4f}" in figures
    assert f"{summary['cost_gbp']:,.2f} │ GBP" in figures
    assert (written, loaded) == (f"Written to {out}", "loaded []")
    assert (out / "report.html").is_file()
    assert sorted(tmp_path.iterdir()) == [out, tiny_folder]


@pytest.mark.nightly
def test_figures_on_demand(tiny_folder: Path, tmp_path: Path) -> None:
    def kinds(folder: Path) -> set[str]:
        return {file.suffix for file in (folder / "figures").glob("*")}

    run = tmp_path / "run"
    assert call("run", tiny_folder, "--out", run, "--figures", "none").exit_code == 0
    assert (run / "report.html").is_file()
    assert not (run / "figures").exists()
    assert call("report", run, "--figures", "png,svg").exit_code == 0
    assert kinds(run) == {".png", ".svg"}
    wrong = call("run", tiny_folder, "--out", tmp_path / "no", "--figures", "pdf")
    assert wrong.exit_code == 2
    assert wrong.stderr == (
        "--figures pdf: 'pdf' is not a kind of figure. Give svg, png, svg,png or none.\n"
    )
    assert not (tmp_path / "no").exists()


def test_module_is_the_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "vppres", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"vppres {vppres.__version__}\n"


def test_version_of_a_checkout_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.delitem(vars(vppres), "__version__", raising=False)
    monkeypatch.setattr("importlib.metadata.version", absent)
    assert vppres.__version__ == "0+not.installed"
    monkeypatch.delitem(vars(vppres), "__version__")


def test_public_names_are_their_own() -> None:
    def check(name: str) -> None:
        found = getattr(vppres, name)
        home = vppres._HOME_OF[name]
        module = inspect.getmodule(found) or found  # a module is its own home
        assert (found.__name__, module.__name__) in ((name, home), (home, home))
        assert name in dir(vppres)

    names = [name for name in vppres.__all__ if name != "__version__"]
    assert len(names) > 10
    assert_for_all({name: name for name in names}, check)


def test_unknown_public_name() -> None:
    with pytest.raises(AttributeError, match="module 'vppres' has no attribute 'run_night'"):
        _ = vppres.run_night


def test_scenarios_lists_one_name_per_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vppres.io.find.packaged_scenarios", lambda: ["flood", "heat"])
    result = call("scenarios")
    assert (result.exit_code, result.stdout) == (0, "flood\nheat\n")


def test_options_reach_the_run(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = caught_options(monkeypatch)
    words = (
        "--controller full-horizon --horizon 2 --solver scip --method monolithic --load-bias 0.1 "
        "--load-error 0.2 --pv-bias -0.3 --pv-error 0.4 --thermal euler --seed 3 --gap 1e-3 "
        "--time-limit 30 --isolate"
    )
    call(f"run {words}", tiny_folder, "--out", tmp_path / "run")
    errors = {"load_bias": 0.1, "load_alpha_per_h": 0.2, "pv_bias": -0.3, "pv_alpha_per_h": 0.4}
    record = options[0].as_record()
    expected = {
        "controller": "full-horizon", "horizon_h": 2.0, "solver": "scip", "seed": 3,
        "method": "monolithic", "errors": errors, "thermal": "euler", "isolate": True,
    }  # fmt: skip
    assert {name: record[name] for name in expected} == expected
    assert (record["limits"]["gap_rel"], record["limits"]["time_s"]) == (1e-3, 30.0)


def test_scenario_names_controller_and_horizon(
    tiny_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toml = tiny_folder / "scenario.toml"
    text = toml.read_text(encoding="utf-8")
    assert 'kind = "mpc"\nhorizon_h = 5.0' in text
    toml.write_text(
        text.replace('kind = "mpc"\nhorizon_h = 5.0', 'kind = "full-horizon"\nhorizon_h = 3.0'),
        encoding="utf-8",
    )
    options = caught_options(monkeypatch)
    call("run", tiny_folder)
    call("run", tiny_folder, "--controller", "mpc", "--horizon", 0)
    assert [(o.controller, o.horizon_h) for o in options] == [("full-horizon", 3.0), ("mpc", 0.0)]


@pytest.mark.daily
def test_reasons_of_a_day_tell_how_far_they_are(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    result = call("run", tiny_folder, "--out", tmp_path / "mine", "--figures", "none")
    told = result.stderr.splitlines()
    assert "mpc: 6 of 6" in told and told[-1] == "explained: 6 of 6"


def caught_options(monkeypatch: pytest.MonkeyPatch) -> list[simulate.RunOptions]:
    """Options of the runs that follow, none of which is done."""
    caught = []

    def catch(scenario: object, options: simulate.RunOptions, progress: object) -> None:
        caught.append(options)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "run_day", catch)
    return caught


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run"], "Missing argument"),
        (["run", "x", "--gap", "nan"], "nan is not a positive number."),
        (["run", "x", "--time-limit", "0"], "0.0 is not a positive number."),
        (["sweep", "x", "--param", "seed", "--jobs", "0"], "greater than or equal to 1"),
        (["run", "x", "--thermal", "hot"], "'hot' is not one of 'off', 'exact', 'euler'"),
        (["walk"], "No such command 'walk'."),
    ],
)
def test_bad_usage(arguments: list[str], message: str) -> None:
    result = call(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    text = " ".join(result.stderr.replace("│", " ").split())
    assert message in text


def test_unknown_scenario() -> None:
    result = call("run", "nowhere")
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("scenario nowhere: is neither a packaged scenario nor ")


def test_every_problem_of_the_data_is_named(tiny_folder: Path) -> None:
    lines = tiny_folder / "lines.csv"
    lines.write_text(
        "from_bus,to_bus,r_ohm,x_ohm\n1,2,-0.3,0.2\n2,3,0.4,none\n2,4,0.5,0.4\n", encoding="utf-8"
    )
    result = call("run", tiny_folder)
    assert result.exit_code == 2
    assert [line.partition(":")[0] for line in result.stderr.splitlines()] == [
        "lines.csv, row 2, r_ohm = -0.3",
        "lines.csv, row 3, x_ohm = none",
    ]


def test_foreign_folder_is_refused_before_the_work(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("keep", encoding="utf-8")
    options = caught_options(monkeypatch)
    result = call("run", tiny_folder, "--out", tmp_path / "mine")
    assert (result.exit_code, options) == (2, [])
    assert "exists and is not a run folder" in result.stderr
    assert names_below(tmp_path / "mine") == ["letter.txt"]


def test_interrupt_leaves_nothing(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    caught_options(monkeypatch)
    result = call("run", tiny_folder, "--out", tmp_path / "run")
    assert (result.exit_code, result.stderr) == (130, "Interrupted; nothing was written.\n")
    assert names_below(tmp_path) == ["tiny"]


def test_interrupt_while_writing_leaves_nothing(
    tiny_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("vppres.report.plots.figures.save_chart", interrupt)
    result = call("run", tiny_folder, "--horizon", 0, "--out", tmp_path / "run")
    assert result.exit_code == 130
    assert names_below(tmp_path) == ["tiny"]


@pytest.mark.parametrize("debug", [False, True])
def test_unexpected_error(tiny_folder: Path, monkeypatch: pytest.MonkeyPatch, debug: bool) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyError("bus")

    monkeypatch.setattr(simulate, "run_day", fail)
    result = call("run", tiny_folder, *["--debug"] * debug)
    assert (result.exit_code, result.stdout) == (1, "")
    assert ("Traceback" in result.stderr) is debug
    assert ("Unexpected KeyError: 'bus'. Run again with --debug" in result.stderr) is not debug


def test_debug_shows_the_traceback_and_keeps_the_status(tiny_folder: Path) -> None:
    result = call("run", tiny_folder, "--solver", "glpk", "--debug")
    assert result.exit_code == 2
    assert result.stderr.startswith("Traceback")
    assert "InputError" in result.stderr


def test_errors_stand_in_a_panel_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    result = call("run", "[bold]nowhere")
    assert result.exit_code == 2
    text = re.sub(r"\x1b\[[0-9;]*m", "", result.stderr)
    assert text.startswith("╭─ Error ─")
    # What the user wrote is shown as it is, not taken as markup.
    assert "[bold]nowhere" in text
    assert "Traceback" not in text


COMMANDS = typer.main.get_command(cli.app).commands


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_help_of_every_command_has_an_example(command: str) -> None:
    result = call(command, "--help")
    assert result.exit_code == 0
    assert f"Example: vppres {command}" in " ".join(result.stdout.split())


@pytest.mark.parametrize("command", [["serve"], ["serve", "simulate"]])
def test_help_names_the_extra_that_serving_needs(command: list[str]) -> None:
    assert 'pip install "vppres[serve]"' in call(*command, "--help").stdout


def test_output_that_nobody_reads_on_ends_without_a_word() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as deaf:
        done = subprocess.run(
            [sys.executable, "-m", "vppres", "schema"],
            stdout=deaf,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (1, "")


def test_schema_is_printed() -> None:
    result = call("schema")
    assert (result.exit_code, result.stderr) == (0, "")
    assert json.loads(result.stdout)["required"] == ["name", "time", "network", "tiers"]


def option_names(command: str) -> list[str]:
    """Options of a command in the order of its help, without those that show it."""
    found = COMMANDS[command]
    return [
        parameter.opts[0]
        for parameter in found.get_params(typer.Context(found))
        if parameter.opts[0].startswith("--") and parameter.name not in ("help", "help_all")
    ]


def test_help_of_a_run_is_a_screen_and_help_all_has_everything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    shown = call("run", "--help").stdout
    usual = "controller horizon priority mode outages seed out figures json quiet help help-all"
    assert re.findall(r"^│ --([a-z-]+)", shown, re.MULTILINE) == usual.split()
    assert len(shown.splitlines()) <= 40
    whole = call("run", "--help-all").stdout
    assert set(option_names("run")) <= set(re.findall(r"--[a-z-]+", whole))
    assert "Show all options and exit." not in call("validate", "--help").stdout


def documented_options(command: str) -> list[str]:
    """Options in the table of the command's section of the documentation."""
    page = (Path(__file__).parents[2] / "docs" / "command-line.md").read_text(encoding="utf-8")
    found = re.search(rf"^## Options of `{command}`$(.*?)^## ", page, re.MULTILINE | re.DOTALL)
    return re.findall(r"^\| `(--[a-z-]+)`", found[1], re.MULTILINE) if found else []


# Named once at the top of the page.
OF_ALL = {"--debug", "--quiet"}

# What these lack of `run`'s options.
SIMULATED = {"--load-bias", "--load-error", "--pv-bias", "--pv-error", "--seed", "--thermal"}
OF_RUN_ALONE = {
    "sweep": {"--out", "--explain", "--figures", "--no-figures"},
    "survival": {"--out", "--explain", "--figures", "--no-figures"},
    "serve": {*SIMULATED, "--out", "--explain", "--figures", "--no-figures", "--json", "--quiet"},
    "serve export": {*SIMULATED, "--figures", "--no-figures", "--quiet"},
    "serve simulate": {*SIMULATED, "--out", "--explain", "--figures", "--no-figures"},
}


# What these share with `new`, to which the page refers.
IMPORT = {f"--{option.name}" for option in IMPORT_OPTIONS}
OF_NEW = {"reconfigure": IMPORT}


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - set(OF_RUN_ALONE)))
def test_documentation_lists_every_option(command: str) -> None:
    known = OF_ALL | OF_NEW.get(command, set())
    own = [name for name in option_names(command) if name not in known]
    assert documented_options(command) == own
    assert set(documented_options("new")) >= IMPORT


@pytest.mark.parametrize("command", sorted(OF_RUN_ALONE))
def test_documentation_lists_what_is_not_shared_with_run(command: str) -> None:
    own = [*documented_options(command), *OF_ALL.intersection(option_names(command))]
    # The page refers to those that it shares with `run`.
    alone = {*own, *OF_RUN_ALONE[command]}
    shared = [name for name in option_names("run") if name not in alone]
    assert sorted(own + shared) == sorted(option_names(command))
    assert shared == [name for name in option_names(command) if name not in own]


def test_the_state_of_a_service_does_not_depend_on_where_it_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site, other = tmp_path / "site", tmp_path / "other"
    for folder in (site, other):
        folder.mkdir()
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    here = cli._state_place("site", None)
    packaged = cli._state_place("uk-heatwave-2022", None)
    monkeypatch.chdir(other)
    assert cli._state_place("../site", None) == here == str(tmp_path / "site.live")
    assert cli._state_place("uk-heatwave-2022", None) == packaged
    assert packaged == str(tmp_path / "config" / "vppres" / "uk-heatwave-2022.live")
    assert cli._state_place("../site", "state") == str(other / "state")
    assert cli._state_place("../site", "postgresql://a@b/c") == "postgresql://a@b/c"


def test_progress_without_a_terminal_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress_bar("mpc", quiet=False) as bar:
        bar(1, 24)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    with progress_bar("mpc", quiet=False) as bar:
        bar(2, 24)
    with progress_bar("mpc", quiet=True) as bar:
        bar(3, 24)
    assert capsys.readouterr().err == "mpc: 2 of 24\n"
