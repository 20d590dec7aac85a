"""The report's first section: warnings, the day in words, key figures."""

from __future__ import annotations

from vppres.events import sentences_of
from vppres.findings import findings
from vppres.key_figures import key_figures
from vppres.sections.base import Run, Section, section


def overview_section(run: Run) -> Section:
    """What is not as it should be, the day in sentences, and key figures."""
    return section("overview", "Summary", {
        "findings": findings(run.trajectory), "key_figures": key_figures(run.summary),
        "sentences": sentences_of(run.trajectory, run.summary)})
