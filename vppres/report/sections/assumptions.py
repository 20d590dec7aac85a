"""What the run took for granted, and what it was made from and with."""

from __future__ import annotations

from vppres.report.assumptions import data_words, option_words, simplifications
from vppres.report.first_page import further_notes
from vppres.report.sections.base import Run, Section, section


def assumptions_section(run: Run) -> Section:
    """Simplifications, data, options with their defaults, versions and the input's digest."""
    options = option_words(run.trajectory.options)
    return section(
        "assumptions",
        "Assumptions and provenance",
        {
            "simplifications": simplifications(run.trajectory),
            "data": data_words(run.trajectory),
            "options": options,
            "changed": any(option.default for option in options),
            "summary": run.summary,
            "notes": further_notes(run.trajectory),
        },
    )
