"""What a section of the report is made from, and what it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from vppres.day.trajectory import Trajectory
from vppres.report.pages import embedded_svg, page
from vppres.report.plots import FIGURE_TEXTS

FOLDED_ABOVE = 40  # rows; longer tables are opened by a click


@dataclass(frozen=True, eq=False)
class Run:
    """What a section may draw on.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    summary : mapping
        Its figures, from :func:`vppres.day.metrics.summarise`.
    figures : Path
        Folder with the SVG files of :func:`vppres.report.plots.save_figures`.
    interactive : bool
        Whether figures may also be drawn by scripts; the static ones then serve the print.
    """

    trajectory: Trajectory
    summary: Mapping[str, Any]
    figures: Path
    interactive: bool

    def figure(self, name: str) -> tuple[str, str]:
        """What a figure shows, and the figure as a data URI."""
        return FIGURE_TEXTS[name], embedded_svg(self.figures / f"{name}.svg")

    def chart(self, name: str) -> tuple[str, Markup] | None:
        """Name and JSON of a chart of :mod:`vppres.report.charts`; None in a static report."""
        if not self.interactive:
            return None
        from vppres.report.charts import chart_json

        return name, Markup(chart_json(self.trajectory, name))


@dataclass(frozen=True)
class Section:
    """A part of the report with its own heading.

    Parameters
    ----------
    key : str
        Anchor in the page: lower case, unique.
    title : str
        Heading, and entry of the contents.
    html : Markup
        What follows the heading.
    """

    key: str
    title: str
    html: Markup


SectionMaker = Callable[[Run], Section | None]


def section(key: str, title: str, content: Mapping[str, Any]) -> Section:
    """A section from the template that bears its key, ``templates/sections/KEY.html.j2``."""
    return Section(key, title, Markup(page(f"sections/{key}.html.j2", content)))
