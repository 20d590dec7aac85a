"""Sections of the report of a run, in the order in which they are read.

A section is a function of the run and of how it is shown that gives a
:class:`~vppres.sections.base.Section`, or None where it has nothing to say. To add one, write such
a function in a module of its own with a template in ``templates/sections``, and name it here.
"""

from __future__ import annotations

from vppres.sections.base import SectionMaker
from vppres.sections.explain import explain_section
from vppres.sections.figures import figures_section
from vppres.sections.overview import overview_section
from vppres.sections.provenance import provenance_section
from vppres.sections.service import service_section
from vppres.sections.solver import solver_section

SECTIONS: tuple[SectionMaker, ...] = (
    overview_section, explain_section, service_section, figures_section, solver_section,
    provenance_section)
"""Makers of the sections."""
