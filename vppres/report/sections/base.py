"""Section of the report, and the data that it is made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from vppres.day.trajectory import Trajectory
from vppres.report.pages import page
from vppres.report.plots.chart import Chart
from vppres.report.plots.figures import FIGURE_TEXTS, chart_of

FOLDED_ABOVE = 40  # rows; longer tables are opened by a click


@dataclass(frozen=True, eq=False)
class Run:
    """A run that is shown, and its figures (:func:`vppres.day.metrics.summarise`)."""

    trajectory: Trajectory
    summary: Mapping[str, Any]

    def figure(self, name: str) -> Figure:
        """A figure of :mod:`vppres.report.plots.figures`."""
        return figure_of(chart_of(self.trajectory, name), FIGURE_TEXTS[name])


@dataclass(frozen=True)
class Figure:
    """A figure of the page: what it shows, its drawing, and what scripts read in it."""

    text: str
    svg: Markup
    data: Mapping[str, Any]


def figure_of(chart: Chart, text: str) -> Figure:
    """A chart as a figure of the page."""
    return Figure(text, Markup(chart.svg()), chart.data())


@dataclass(frozen=True)
class Section:
    """A part of the report; its key is its anchor in the page, unique and in lower case."""

    key: str
    title: str
    html: Markup


SectionMaker = Callable[[Run], Section | None]


def section(key: str, title: str, content: Mapping[str, Any]) -> Section:
    """A section from the template that bears its key, ``templates/sections/KEY.html.j2``."""
    return Section(key, title, Markup(page(f"sections/{key}.html.j2", content)))
