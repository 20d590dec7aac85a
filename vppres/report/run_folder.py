"""The run folder, and the report a person can open: one HTML file that needs nothing beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from vppres.day.metrics import summarise
from vppres.day.trajectory import Trajectory, write_tables
from vppres.io.atomic import atomic_folder
from vppres.io.scenario_writer import write_scenario
from vppres.report.pages import page
from vppres.report.plots import save_figures
from vppres.report.sections import SECTIONS
from vppres.report.sections.base import Run

SUMMARY_FILE = "summary.json"
REPORT_FILE = "report.html"
TEMPLATE = "run_report.html.j2"


Draw = Callable[[Trajectory, Path], object]


def write_run(trajectory: Trajectory, folder: Path, interactive: bool = True, figures: bool = True,
              draw: Draw | None = None) -> dict[str, Any]:
    """Write a run folder, whole or not at all.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    folder : Path
        The folder to make; an older run in its place is replaced.
    interactive : bool
        Whether the report also has the charts that scripts draw, some 5 MB.
    figures : bool
        Whether to draw the figures and write the report, which embeds them.
    draw : callable, optional
        What puts the figures into a folder, ``draw(trajectory, folder)``;
        :func:`vppres.report.plots.save_figures` if not given.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.

    Raises
    ------
    InputError
        If the folder holds something other than a run, or cannot be written.
    """
    summary = summarise(trajectory)
    with atomic_folder(folder) as aside:
        write_tables(trajectory, aside)
        write_scenario(trajectory.scenario, aside / "scenario")
        if figures:
            (draw or save_figures)(trajectory, aside / "figures")
            report = render_report(trajectory, summary, aside / "figures", interactive)
            _write(aside / REPORT_FILE, report)
        _write(aside / SUMMARY_FILE, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def render_report(trajectory: Trajectory, summary: Mapping[str, Any], figures: Path,
                  interactive: bool = True) -> str:
    """The report as HTML.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    summary : mapping
        Its figures, from :func:`vppres.day.metrics.summarise`.
    figures : Path
        Folder with the SVG files of :func:`vppres.report.plots.save_figures`; they are embedded.
    interactive : bool
        Whether to add the figures that scripts draw, some 5 MB.
    """
    run = Run(trajectory, summary, figures, interactive)
    made = [make(run) for make in SECTIONS]
    return page(TEMPLATE, {
        "title": trajectory.scenario.title, "summary": summary,
        "sections": [section for section in made if section is not None],
        "plotly": Markup(_plotly()) if interactive else ""})


def _plotly() -> str:
    """The library that draws the charts; a static report does without it."""
    from vppres.report.charts import plotly_script

    return plotly_script()


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")
