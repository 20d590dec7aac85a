"""The report's first section: key figures."""

from __future__ import annotations

from vppres.key_figures import key_figures
from vppres.sections.base import Run, Section, section


def overview_section(run: Run) -> Section:
    """Key figures of the run."""
    return section("overview", "Key figures", {"key_figures": key_figures(run.summary)})
