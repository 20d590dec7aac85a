"""The table of options: it covers all options of a run, and a row in it is enough for a new one."""

from __future__ import annotations

import json
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, get_args

import pytest

from tests.support.command_line import call
from tests.support.pages import page_row
from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.cli import options as cli_options
from vppres.contract.operating_point import Centre
from vppres.control.converged import DEFAULT_HEADROOM
from vppres.control.full_horizon import PVCheck
from vppres.day import options as day_options
from vppres.day.options import RunOptions
from vppres.io import read_scenario, schema, write_scenario
from vppres.kinds.customer.data import SwitchingRules
from vppres.model.numerics import POLYGON_SIDES
from vppres.scenario.fairness import Fairness
from vppres.scenario.option_table import OPTIONS, Option, section_options
from vppres.scenario.scenario import ControllerDefaults, Headroom, Priority
from vppres.studies import sweep_parameters

CHOICES = {option.field: option.choices for option in OPTIONS}
PAGE = Path(__file__).parents[2] / "docs" / "command-line.md"


def leaves(record: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Values of nested groups by their paths: ``errors.load_bias``."""
    found: dict[str, Any] = {}
    for name, value in record.items():
        inside = (
            leaves(value, f"{above}{name}.") if isinstance(value, dict) else {above + name: value}
        )
        found |= inside
    return found


def test_every_field_of_the_options_has_one_row_with_its_default() -> None:
    rows = [(option.field, option.run_default) for option in OPTIONS]
    assert len({option.name for option in OPTIONS}) == len(OPTIONS) == len(dict(rows))
    assert dict(rows) == leaves(asdict(RunOptions(switching=SwitchingRules())))


def test_constants_of_other_rooms_are_those_of_the_table() -> None:
    options = RunOptions()
    assert (options.polygon_sides, Headroom().share) == (POLYGON_SIDES, DEFAULT_HEADROOM)
    assert CHOICES["centre"] == get_args(Centre)
    assert CHOICES["pv_check"] == get_args(PVCheck)


@pytest.mark.parametrize(("section", "frozen"), [
    ("controller", ControllerDefaults),
    ("switching", SwitchingRules),
    ("priority", Priority),
    ("headroom", Headroom),
    ("fairness", Fairness),
])  # fmt: skip
def test_sections_hold_what_a_scenario_carries(section: str, frozen: type) -> None:
    assert list(section_options(section)) == [f.name for f in fields(frozen)]


def test_page_has_the_rows_of_the_table() -> None:
    page = PAGE.read_text(encoding="utf-8").splitlines()
    first = page.index("## Options of `run`") + 4
    rows = [page_row(option) for option in cli_options.DAY_OPTIONS]
    assert page[first : first + len(rows)] == rows


def test_page_names_what_a_sweep_varies() -> None:
    page = PAGE.read_text(encoding="utf-8")
    of_run, python_alone = (
        ", ".join(
            f"`{option.name}`"
            for option in OPTIONS
            if option.sweep and option.command_line is wanted
        )
        for wanted in (True, False)
    )
    assert f"| {of_run} | the option of `run` |" in page
    assert f"| {python_alone} | the option of `RunOptions`" in page


def test_every_option_of_a_sweep_changes_its_own_field() -> None:
    day = tiny_scenario()
    options = RunOptions().on(day)
    expected = leaves(options.as_record())
    own = {"cold-load-factor": 1.5, "solver": "scip", "method": "monolithic"}
    for name, row in sweep_parameters.OPTION_OF.items():
        others = [choice for choice in row.choices if choice != expected[row.field]]
        value = own.get(name) or (others[0] if others else 3 if row.kind is int else 0.5)
        parameter = sweep_parameters.find_parameter(name, day)
        same, options = sweep_parameters.changed(parameter, value, day, options)
        assert same is day
        assert expected[row.field] != value, name
        expected[row.field] = value
    assert leaves(options.as_record()) == expected


@pytest.mark.parametrize("kind", CHOICES["controller"])
def test_scenario_may_name_every_controller_of_the_command_line(kind: str, tmp_path: Path) -> None:
    day = replace(tiny_scenario(), controller=ControllerDefaults(kind, 2.0))
    write_scenario(day, tmp_path / "tiny")
    given = dict.fromkeys(cli_options._key(option) for option in cli_options.DAY_OPTIONS)
    given |= {
        cli_options._key(option): option.default
        for option in cli_options.DAY_OPTIONS
        if not option.scenario_key
    }
    options = cli_options.run_options(read_scenario(tmp_path / "tiny"), given)
    assert (options.controller, options.horizon_h) == (kind, 2.0)


@pytest.mark.parametrize(("changes", "text"), [
    ({"thermal": "hot"}, "options, thermal = hot: is not known. Use one of: off, exact, euler."),
    ({"seed": -1}, "options, seed = -1: must not be negative. Give a whole number from zero."),
    ({"forecast_file": "mine.csv"},
        "options, forecast_file = mine.csv: is not read by the forecaster paper. Add --forecaster "
        "file."),
])  # fmt: skip
def test_run_options_check_what_the_table_says(changes: dict[str, Any], text: str) -> None:
    assert refusal(RunOptions, **changes) == text


def test_options_of_studies_pass_the_check() -> None:
    assert RunOptions(thermal="exact-joule-kw").thermal == "exact-joule-kw"


@pytest.fixture
def gap_row(monkeypatch: pytest.MonkeyPatch) -> Option:
    """A row for an option that only Python had, put where the other rows are."""
    row = Option(
        "gap-abs",
        "limits.gap_abs",
        float,
        0.005,
        "largest absolute gap",
        unit="share",
        choices=(),
        range=next(option.range for option in OPTIONS if option.field == "limits.gap_abs"),
    )
    rows = tuple(row if option.field == "limits.gap_abs" else option for option in OPTIONS)
    of_command = tuple(option for option in rows if option.command_line)
    monkeypatch.setattr(cli_options, "DAY_OPTIONS", of_command)
    monkeypatch.setattr(cli_options.DayCommand, "table", of_command)
    monkeypatch.setattr(day_options, "OPTIONS", rows)
    monkeypatch.setitem(sweep_parameters.OPTION_OF, "gap-abs", row)
    return row


def test_a_row_is_enough_for_an_option(
    gap_row: Option, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    caught: list[RunOptions] = []

    def catch(day: object, options: RunOptions, progress: object) -> None:
        caught.append(options)
        raise KeyboardInterrupt

    monkeypatch.setattr("vppres.day.simulate.run_day", catch)
    write_scenario(tiny_scenario(), tmp_path / "tiny")

    folder = str(tmp_path / "tiny")
    assert "Largest absolute gap. [default: 0.005]" in " ".join(
        call("run", "--help-all").stdout.replace("│", " ").split()
    )
    call("run", folder, "--gap-abs", "0.25", "--out", str(tmp_path / "run"))
    assert [options.limits.gap_abs for options in caught] == [0.25]
    refused = call("run", folder, "--gap-abs", "0", "--out", str(tmp_path / "run"))
    assert "positive number" in refused.stderr
    day = tiny_scenario()
    parameter = sweep_parameters.find_parameter("gap-abs", day)
    assert sweep_parameters.changed(parameter, 0.3, day, RunOptions())[1].limits.gap_abs == 0.3
    assert page_row(gap_row) == "| `--gap-abs` | 0.005 | largest absolute gap |"


def test_a_row_with_a_key_is_a_key_of_the_scenario(monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(
        next(option for option in OPTIONS if option.field == "headroom"),
        scenario_key="controller.headroom",
    )
    monkeypatch.setattr("vppres.scenario.option_table.OPTIONS", (*OPTIONS, row))
    section = schema._model.__wrapped__("[controller]")
    found = json.loads(json.dumps(section.model_json_schema()))["properties"]["headroom"]
    assert found == {
        "default": 0.1,
        "description": row.meaning,
        "exclusiveMaximum": 1,
        "minimum": 0,
        "title": "Headroom",
        "type": "number",
    }


@pytest.mark.parametrize(("options", "given", "words"), [
    (RunOptions, {"guard": "no"}, "guard = no: is neither true nor false. Give True or False."),
    (RunOptions, {"seed": 1.5}, "seed = 1.5: is not a whole number. Give one."),
    (SwitchingRules, {"stay_restored": "yes"},
        "switching.stay_restored = yes: is neither true nor false. Give True or False."),
    (RunOptions, {"errors": 0.1}, "errors = 0.1: is of another kind. Give ForecastErrors(...)."),
])  # fmt: skip
def test_a_value_of_another_kind_is_refused(
    options: Any, given: dict[str, Any], words: str
) -> None:
    assert refusal(options, **given) == f"options, {words}"
