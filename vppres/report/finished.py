"""Finished runs, read back from their folders."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vppres.core.errors import InputError, first_line
from vppres.day.metrics import summarise
from vppres.day.reliability import reliability_figures
from vppres.day.run_files import read_run
from vppres.day.trajectory import Trajectory
from vppres.io.atomic import remove_leftovers
from vppres.report.pages import write_page
from vppres.report.pdf import write_pdf
from vppres.report.plots.figures import save_figures
from vppres.report.run_folder import FIGURES_FOLDER, SUMMARY_FILE, render_report
from vppres.scenario.timegrid import UTC

_CURE = "Give a folder written by a run."


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A run folder's content; the summary has the figures that a newer version adds too."""

    folder: Path
    trajectory: Trajectory
    summary: Mapping[str, Any]


def read_finished(folder: Path) -> FinishedRun:
    """Read a run folder with its summary."""
    if not folder.exists():
        remove_leftovers(folder.absolute().parent)  # a killed run may have been replacing it
    if not folder.is_dir():
        message = "is not a folder" if folder.exists() else "there is no such folder"
        raise InputError.of(str(folder), message, _CURE)
    try:
        trajectory = read_run(folder)
    except (ValueError, KeyError) as error:
        raise InputError.of(
            str(folder), f"cannot be read ({first_line(error)})", "Run the scenario again."
        ) from error
    # What was recorded counts, above all the versions that made the run.
    summary = {**summarise(trajectory), **_read_summary(folder / SUMMARY_FILE)}
    return FinishedRun(folder, trajectory, summary)


def priced(run: FinishedRun, voll_gbp_per_kwh: float) -> FinishedRun:
    """The run with its energy not supplied at another value of lost load."""
    scenario = replace(run.trajectory.scenario, voll_gbp_per_kwh=voll_gbp_per_kwh)
    trajectory = replace(run.trajectory, scenario=scenario)
    summary = {**run.summary, **reliability_figures(trajectory)}
    return FinishedRun(run.folder, trajectory, summary)


def in_zone(run: FinishedRun, zone: str = UTC) -> FinishedRun:
    """The run with times of a zone, UTC if not given, whatever the clocks on the site show."""
    day = run.trajectory.scenario
    day = replace(day, grid=replace(day.grid, zone=zone))
    return replace(run, trajectory=replace(run.trajectory, scenario=day))


def rewrite_report(
    run: FinishedRun, file: Path, browser: str = "", kinds: Sequence[str] = ()
) -> list[Path]:
    """Draw the figures of a run again and write its report into a file; what was written.

    A ``browser`` (:func:`vppres.report.pdf.find_browser`) prints it beside the file as PDF. Figures
    of the ``kinds`` ``svg`` and ``png`` go into ``figures/`` beside the file.
    """
    text = render_report(run.trajectory, dict(run.summary))
    write_page(file, text)
    written = [file]
    if kinds:
        figures = file.parent / FIGURES_FOLDER
        save_figures(run.trajectory, figures, kinds)
        written.append(figures)
    if browser:
        printed = file.with_suffix(".pdf")
        write_pdf(text, printed, browser)
        written.append(printed)
    return written


def _read_summary(file: Path) -> dict[str, Any]:
    if not file.is_file():
        raise InputError.of(str(file.parent), f"has no {file.name}", _CURE)
    try:
        summary = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError.of(
            str(file), f"is not valid JSON ({first_line(error)})", "Run the scenario again."
        ) from error
    if not isinstance(summary, dict):
        raise InputError.of(str(file), "is not a table of figures", _CURE)
    return summary
