"""What the run was made from and with."""

from __future__ import annotations

from vppres.sections.base import Run, Section, section


def provenance_section(run: Run) -> Section:
    """Digest of the input, and versions."""
    return section("provenance", "Provenance", {"summary": run.summary})
