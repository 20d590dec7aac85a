"""Sections of the report of a run, in the order in which they are read.

A section is a key, a title, and a function of the run that gives its content, or None where it has
nothing to say. To add one, write such a function with a template ``templates/sections/KEY.html.j2``
for its content, and name it here.
"""

from __future__ import annotations

from vppres.report.sections.base import SectionOf
from vppres.report.sections.explain import explain_of
from vppres.report.sections.feeder import feeder_of
from vppres.report.sections.listed import (
    assumptions_of,
    days_of,
    energy_of,
    figures_of,
    solver_of,
    timeline_of,
)
from vppres.report.sections.network import network_of
from vppres.report.sections.outages import outages_of
from vppres.report.sections.overview import overview_of
from vppres.report.sections.service import service_of

SECTIONS: tuple[SectionOf, ...] = (
    SectionOf("overview", "Summary", overview_of),
    SectionOf("timeline", "Events", timeline_of),
    SectionOf("outages", "Outage forecasts and outcomes", outages_of),
    SectionOf("days", "Day by day", days_of),
    SectionOf("explain", "Decisions and reasons", explain_of),
    SectionOf("service", "Supply by customer", service_of),
    SectionOf("feeder", "The feeder", feeder_of),
    SectionOf("energy", "Energy, import and price", energy_of),
    SectionOf("network", "Voltages and line loading", network_of),
    SectionOf("figures", "All figures", figures_of),
    SectionOf("solver", "Solver results", solver_of),
    SectionOf("assumptions", "Assumptions and provenance", assumptions_of),
)
