"""Names that mean something to whoever shows them: formulas, markup, tags and paths stay text."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from html import unescape
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rich.console import Console

from tests.support.tiny_day import tiny_scenario
from vppres.cli.tables import figures_table, sweep_table
from vppres.core.errors import Problem
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory
from vppres.io import read_scenario, write_scenario
from vppres.report.plots.drawing import png_of
from vppres.report.plots.figures import FIGURES, RUN_FIGURES
from vppres.report.run_folder import write_run
from vppres.scenario.scenario import Scenario
from vppres.studies.sweep import SweepRow, cases_of
from vppres.studies.sweep_page import sweep_figure
from vppres.studies.sweep_parameters import find_parameter

FORMULA = r"$\frac{$"  # an error where it is taken for a formula
MARKUP = "[/x]"  # an error where rich takes it for markup
TAG = "</script><b>../../x"
TITLE = f"[/bold] {FORMULA} {TAG} [red]"


@pytest.fixture(scope="module")
def hostile() -> Scenario:
    """The tiny day with every name and the title changed."""
    day = tiny_scenario()
    tier = {"critical": FORMULA, "high": MARKUP, "low": TAG}
    owner = {"hospital": FORMULA, "homes": TAG}
    return replace(
        day,
        title=TITLE,
        tiers=tuple(tier.values()),
        customers=replace(
            day.customers,
            id=[FORMULA, MARKUP, TAG],
            tier=[tier[name] for name in day.customers.tier],
        ),
        pv=replace(day.pv, id=["$^$", "<i>"], customer=[owner[c] for c in day.pv.customer]),
        batteries=replace(day.batteries, id=["$_$", MARKUP]),
    )


@pytest.fixture(scope="module")
def hostile_run(hostile: Scenario) -> Trajectory:
    return run_day(hostile, RunOptions(horizon_h=1.0))


def test_the_folder_reads_back(hostile: Scenario, tmp_path: Path) -> None:
    write_scenario(hostile, tmp_path / "day")
    read = read_scenario(tmp_path / "day")
    assert read.title == TITLE
    assert read.tiers == hostile.tiers
    assert read.customers.id.tolist() == hostile.customers.id.tolist()


@pytest.mark.parametrize("name", [*FIGURES, *RUN_FIGURES])
def test_figures_are_sound_whatever_the_names(hostile_run: Trajectory, name: str) -> None:
    chart = (
        RUN_FIGURES[name](hostile_run)
        if name in RUN_FIGURES
        else FIGURES[name]({FORMULA: hostile_run, "</svg><b>": hostile_run})
    )
    ElementTree.fromstring(chart.svg())
    assert "<b>" not in chart.svg()


def test_a_tier_is_drawn_under_its_own_name(hostile_run: Trajectory) -> None:
    drawn = ElementTree.fromstring(FIGURES["service_by_tier"](hostile_run).svg())
    assert FORMULA in [text.text for text in drawn.iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.daily
def test_the_page_of_a_run_holds_no_tag_of_others(hostile_run: Trajectory, tmp_path: Path) -> None:
    write_run(hostile_run, tmp_path / "run")
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "</script><b>" not in page
    assert TITLE in unescape(page)
    for data in re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', page, re.S):
        json.loads(data)


def shown(table: object) -> str:
    """What a terminal shows."""
    console = Console(file=StringIO(), width=200)
    console.print(table)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return text


def test_the_terminal_shows_brackets_as_text(hostile_run: Trajectory) -> None:
    summary = summarise(hostile_run)
    text = shown(figures_table(summary, TITLE))
    assert TITLE in text
    assert f"Share served in the outage, {MARKUP}" in text
    assert MARKUP in shown(sweep_table(MARKUP, [SweepRow(1.0, "a", summary, None)]))


def test_messages_write_out_what_steers_a_terminal() -> None:
    problem = Problem(
        "a\x1b]0;owned\x07.csv", "is wrong", "Mend it.", row=2, field="\u202eid", value="\x1b[2J"
    )
    assert str(problem) == (r"a\x1b]0;owned\x07.csv, row 2, \u202eid = \x1b[2J: is wrong. Mend it.")


@pytest.mark.parametrize("tier", [FORMULA, MARKUP, TAG])
def test_a_sweep_over_a_tier_writes_inside_its_folder(hostile: Scenario, tier: str) -> None:
    parameter = find_parameter(f"tiers.{tier}", hostile)
    cases = cases_of(parameter, [0.1, 0.2], hostile, RunOptions())
    folders = {Path("out") / case.folder for case in cases}
    assert len(folders) == 2
    assert all(folder.parent == Path("out") and ".." not in folder.parts for folder in folders)


def test_the_figure_of_a_sweep_shows_names_as_text(
    hostile_run: Trajectory, hostile: Scenario
) -> None:
    summary = summarise(hostile_run)
    rows: Sequence[SweepRow] = [SweepRow(value, "a", summary, None) for value in (0.1, 0.2)]
    chart = sweep_figure(f"tiers.{FORMULA}", rows, hostile.tiers)
    drawn = ElementTree.fromstring(chart.svg())
    assert {FORMULA, MARKUP, TAG, f"tiers.{FORMULA}"} <= {element.text for element in drawn.iter()}
    assert png_of(chart.svg()).startswith(b"\x89PNG")
