"""Sections that show a list, a table or figures as they are."""

from __future__ import annotations

from typing import Any

from vppres.day.daily import daily_figures, spans_days
from vppres.report.assumptions import data_words, option_words, simplifications
from vppres.report.clock import Clock
from vppres.report.events import events_of
from vppres.report.first_page import further_notes
from vppres.report.key_figures import key_figures
from vppres.report.sections.base import Run


def timeline_of(run: Run) -> dict[str, Any]:
    """The events of the day in words."""
    return {
        "events": events_of(run.trajectory),
    }


def days_of(run: Run) -> dict[str, Any] | None:
    """One row for each calendar day; nothing for a run of one day."""
    if not spans_days(run.trajectory):
        return None
    days = daily_figures(run.trajectory)
    return {
        "days": days.to_dict("records"),
        "outages": bool((days["outage_h"] > 0).any()),
    }


def energy_of(run: Run) -> dict[str, Any]:
    """Stored energy, powers, import and price over the day, and temperatures if there are any."""
    rooms = ("indoor",) if run.trajectory.thermal_loads is not None else ()
    names = ("energy_and_price", "import_load_pv", *rooms)
    return {"figures": [run.figure(name) for name in names]}


def figures_of(run: Run) -> dict[str, Any]:
    """Every figure of the summary with its unit."""
    return {"key_figures": key_figures(run.summary)}


def solver_of(run: Run) -> dict[str, Any]:
    """Status, gap and time of each decision."""
    steps = run.trajectory.steps
    times = steps["time"].map(Clock.of(run.trajectory).words)
    return {
        "summary": run.summary,
        "steps": steps.assign(time=times).to_dict("records"),
        "figure": run.figure("solve_times"),
    }


def assumptions_of(run: Run) -> dict[str, Any]:
    """Simplifications, data, options with their defaults, versions and the input's digest."""
    options = option_words(run.trajectory.options)
    return {
        "simplifications": simplifications(run.trajectory),
        "data": data_words(run.trajectory),
        "options": options,
        "changed": any(option.default for option in options),
        "summary": run.summary,
        "notes": further_notes(run.trajectory),
    }
