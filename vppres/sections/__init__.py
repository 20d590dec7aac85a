"""Sections of the report of a run, in the order in which they are read.

A section is a function of the run and of how it is shown that gives a
:class:`~vppres.sections.base.Section`, or None where it has nothing to say. To add one, write such
a function in a module of its own with a template in ``templates/sections``, and name it here.
"""

from __future__ import annotations

from vppres.sections.assumptions import assumptions_section
from vppres.sections.base import SectionMaker
from vppres.sections.energy import energy_section
from vppres.sections.explain import explain_section
from vppres.sections.feeder import feeder_section
from vppres.sections.network import network_section
from vppres.sections.overview import overview_section
from vppres.sections.service import service_section
from vppres.sections.solver import solver_section
from vppres.sections.timeline import timeline_section

# Makers of the sections.
SECTIONS: tuple[SectionMaker, ...] = (
    overview_section, timeline_section, explain_section, service_section, feeder_section,
    energy_section, network_section, solver_section, assumptions_section)
