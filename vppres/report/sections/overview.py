"""The report's first section: warnings, the day in words, key figures."""

from __future__ import annotations

from vppres.report.events import sentences_of
from vppres.report.findings import findings
from vppres.report.key_figures import key_figures
from vppres.report.sections.base import Run, Section, section


def overview_section(run: Run) -> Section:
    """What is not as it should be, the day in sentences, and key figures."""
    return section(
        "overview",
        "Summary",
        {
            "findings": findings(run.trajectory),
            "key_figures": key_figures(run.summary),
            "sentences": sentences_of(run.trajectory, run.summary),
        },
    )
