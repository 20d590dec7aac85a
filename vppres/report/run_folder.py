"""The run folder, and the report a person can open: one HTML file that needs nothing beside it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from vppres.core.errors import ReportError, StorageError, VppresError
from vppres.day.daily import daily_figures, spans_days
from vppres.day.metrics import summarise
from vppres.day.run_files import write_tables
from vppres.day.trajectory import Trajectory
from vppres.io.atomic import atomic_folder, is_full
from vppres.io.scenario_writer import write_scenario
from vppres.report.clock import Clock
from vppres.report.operating_order import ORDER_FILE, operating_order
from vppres.report.pages import page
from vppres.report.plots.figures import SVG, save_figures
from vppres.report.sections import SECTIONS
from vppres.report.sections.base import Run

SUMMARY_FILE = "summary.json"
REPORT_FILE = "report.html"
FIGURES_FOLDER = "figures"
DAYS_FILE = "days.parquet"
TEMPLATE = "run_report.html.j2"


def write_run(
    trajectory: Trajectory, folder: Path, figures: bool = True, kinds: Sequence[str] = (SVG,)
) -> dict[str, Any]:
    """Write a run folder, whole or not at all.

    What was computed is written first: where figures or report cannot be made, the folder is kept
    without them, so that no computed day is lost, and ``vppres report`` makes them later.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    folder : Path
        The folder to make; an older run in its place is replaced.
    figures : bool
        Whether to draw the figures and write the report, which has them.
    kinds : sequence of str
        Files of the figures in ``figures/``: ``svg``, ``png``, both or none.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.

    Raises
    ------
    InputError
        If the folder holds something other than a run, or cannot be written.
    StorageError
        If the disk is full; the message says what was kept.
    ReportError
        If only the report could not be made; the rest of the folder is there.
    """
    summary = summarise(trajectory)
    with atomic_folder(folder) as aside:
        write_tables(trajectory, aside)
        if spans_days(trajectory):
            daily_figures(trajectory).to_parquet(aside / DAYS_FILE, index=False)
        operating_order(trajectory).to_csv(aside / ORDER_FILE, index=False, float_format="%.6g")
        write_scenario(trajectory.scenario, aside / "scenario")
        _write(aside / SUMMARY_FILE, json.dumps(summary, indent=2, allow_nan=False) + "\n")
        failure = _illustrate(trajectory, summary, aside, kinds) if figures else None
    if failure:
        raise _without_report(folder, failure) from failure
    return summary


def _illustrate(
    trajectory: Trajectory, summary: Mapping[str, Any], folder: Path, kinds: Sequence[str]
) -> Exception | None:
    """Figures and report of a run, or why they could not be made; then neither is there."""
    try:
        if kinds:
            save_figures(trajectory, folder / FIGURES_FOLDER, kinds)
        _write(folder / REPORT_FILE, render_report(trajectory, summary))
    except Exception as error:  # whatever it is: hours of computing must not go with a figure
        shutil.rmtree(folder / FIGURES_FOLDER, ignore_errors=True)
        (folder / REPORT_FILE).unlink(missing_ok=True)
        return error
    return None


def _without_report(folder: Path, failure: Exception) -> VppresError:
    """Note on a run folder that has no figures and no report."""
    cure = f"{folder} holds the run; make its report with vppres report {folder}."
    if isinstance(failure, OSError) and is_full(failure):
        return StorageError(
            f"{folder}: the disk is full, or a quota is reached: figures and "
            f"report were not written. Free some space: {cure}"
        )
    return ReportError(
        f"{folder}: figures and report could not be made "
        f"({type(failure).__name__}: {failure}). {cure}"
    )


def render_report(trajectory: Trajectory, summary: Mapping[str, Any]) -> str:
    """The report of a run with its summary, as HTML."""
    run = Run(trajectory, summary)
    made = [part.of(run) for part in SECTIONS]
    return page(
        TEMPLATE,
        {
            "title": trajectory.scenario.title,
            "summary": summary,
            "mode": trajectory.options.get("mode", ""),
            "clock_note": Clock.of(trajectory).note,
            "sections": [*filter(None, made)],
        },
    )


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")
