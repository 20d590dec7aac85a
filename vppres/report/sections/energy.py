"""Energy, power, import and price."""

from __future__ import annotations

from vppres.report.sections.base import Run, Section, section


def energy_section(run: Run) -> Section:
    """Stored energy, powers, import and price over the day."""
    return section(
        "energy",
        "Energy, import and price",
        {
            "figures": [run.figure("energy_and_price"), run.figure("import_load_pv")],
        },
    )
