"""The figures of a run."""

from __future__ import annotations

from vppres.pages import embedded_svg
from vppres.plots import FIGURE_TEXTS, FIGURES
from vppres.sections.base import Run, Section, section


def figures_section(run: Run) -> Section:
    """All figures, embedded."""
    return section("figures", "Figures", {
        "figures": [(FIGURE_TEXTS[name], embedded_svg(run.figures / f"{name}.svg"))
                    for name in FIGURES]})
