"""Day by day, for runs of more than one."""

from __future__ import annotations

from vppres.day.daily import daily_figures, spans_days
from vppres.report.key_figures import number
from vppres.report.sections.base import FOLDED_ABOVE, Run, Section, section


def days_section(run: Run) -> Section | None:
    """One row for each calendar day; nothing for a run of one day."""
    if not spans_days(run.trajectory):
        return None
    days = daily_figures(run.trajectory)
    return section(
        "days",
        "Day by day",
        {
            "days": days.to_dict("records"),
            "number": number,
            "folded_above": FOLDED_ABOVE,
            "outages": bool((days["outage_h"] > 0).any()),
        },
    )
