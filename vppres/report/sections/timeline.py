"""What happened when, in words."""

from __future__ import annotations

from vppres.report.clock import Clock
from vppres.report.events import events_of
from vppres.report.sections.base import FOLDED_ABOVE, Run, Section, section


def timeline_section(run: Run) -> Section:
    """The events of the day in words."""
    return section(
        "timeline",
        "Events",
        {
            "heading": Clock.of(run.trajectory).heading,
            "events": events_of(run.trajectory),
            "folded_above": FOLDED_ABOVE,
        },
    )
