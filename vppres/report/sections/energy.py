"""Energy, power, import and price."""

from __future__ import annotations

from vppres.report.sections.base import Run, Section, section


def energy_section(run: Run) -> Section:
    """Stored energy, powers, import and price over the day, and temperatures if there are any."""
    rooms = ("indoor",) if run.trajectory.thermal_loads is not None else ()
    names = ("energy_and_price", "import_load_pv", *rooms)
    return section(
        "energy",
        "Energy, import and price",
        {"figures": [run.figure(name) for name in names]},
    )
