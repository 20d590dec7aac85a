"""How each decision was found: status, gap and time."""

from __future__ import annotations

from typing import Any

from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.key_figures import number
from vppres.report.sections.base import Run, Section, section


def solver_section(run: Run) -> Section:
    """Times of the decisions and the table of the steps."""
    return section(
        "solver",
        "Solver results",
        {
            "summary": run.summary,
            "steps": _rows(run.trajectory),
            "number": number,
            "figure": run.figure("solve_times"),
        },
    )


def _rows(trajectory: Trajectory) -> list[dict[str, Any]]:
    """The steps table with the time as text."""
    times = trajectory.steps["time"].map(Clock.of(trajectory).words)
    return [
        {str(name): value for name, value in row.items()}
        for row in trajectory.steps.assign(time=times).to_dict("records")
    ]
