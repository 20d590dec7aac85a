"""The day at a glance: strips over one clock, and events."""

from __future__ import annotations

from vppres.report.events import events_of
from vppres.report.sections.base import FOLDED_ABOVE, Run, Section, section


def timeline_section(run: Run) -> Section:
    """The day as strips over one clock, and its events in words."""
    return section(
        "timeline",
        "The day at a glance",
        {
            "strip": run.figure("timeline"),
            "events": events_of(run.trajectory),
            "folded_above": FOLDED_ABOVE,
        },
    )
