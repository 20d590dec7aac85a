"""Every figure of the summary, with its unit."""

from __future__ import annotations

from vppres.report.key_figures import key_figures
from vppres.report.sections.base import Run, Section, section


def figures_section(run: Run) -> Section:
    """The key figures as a table."""
    return section("figures", "All figures", {"key_figures": key_figures(run.summary)})
