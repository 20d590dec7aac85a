"""Section of the report, and the data that it is made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.key_figures import number
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


@dataclass(frozen=True)
class SectionOf:
    """A part that a report may have; its content goes into ``templates/sections/KEY.html.j2``."""

    key: str
    title: str
    content: Callable[[Run], dict[str, Any] | None]

    def of(self, run: Run) -> Section | None:
        """The section of a run, with what every template may use; None without content."""
        content = self.content(run)
        if content is None:
            return None
        heading = Clock.of(run.trajectory).heading
        every = {"heading": heading, "number": number, "folded_above": FOLDED_ABOVE}
        html = page(f"sections/{self.key}.html.j2", every | content)
        return Section(self.key, self.title, Markup(html))
