"""Sections of the report of a run, in the order in which they are read.

A section is a function of the run and of how it is shown that gives a
:class:`~vppres.report.sections.base.Section`, or None where it has nothing to say. To add one,
write such a function with a template in ``templates/sections``, and name it
here.
"""

from __future__ import annotations

from vppres.report.sections.base import SectionMaker
from vppres.report.sections.explain import explain_section
from vppres.report.sections.feeder import feeder_section
from vppres.report.sections.listed import (
    assumptions_section,
    days_section,
    energy_section,
    figures_section,
    solver_section,
    timeline_section,
)
from vppres.report.sections.network import network_section
from vppres.report.sections.outages import outages_section
from vppres.report.sections.overview import overview_section
from vppres.report.sections.service import service_section

# Makers of the sections.
SECTIONS: tuple[SectionMaker, ...] = (
    overview_section,
    timeline_section,
    outages_section,
    days_section,
    explain_section,
    service_section,
    feeder_section,
    energy_section,
    network_section,
    figures_section,
    solver_section,
    assumptions_section,
)
