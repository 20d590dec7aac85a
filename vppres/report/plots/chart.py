"""Charts: panels above each other over one axis, mostly that of time, drawn as SVG."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from vppres.core.arrays import Floats, spans_of
from vppres.day.metrics import horizon_h
from vppres.day.trajectory import Trajectory
from vppres.report.plots.axes import Scale, ScaleAxis, TimeAxis, ValueAxis, range_of
from vppres.report.plots.drawing import (
    BLACK,
    FONT_PX,
    GREY,
    OUTAGE_COLOUR,
    RULE_COLOUR,
    RUN_STYLES,
    Canvas,
    Style,
    text_px,
)

Runs = Trajectory | Mapping[str, Trajectory]
Across = TimeAxis | ScaleAxis

WIDTH_PX = 860.0
TITLE_PX, GAP_PX, EDGE_PX = 44.0, 16.0, 10.0
LINE_PX = 1.2 * FONT_PX
SMALL_PX = 10.0
SAMPLE_PX, BETWEEN_PX = 30.0, 22.0
"""Length of a line in the legend, and the space from one of its entries to the next."""


@dataclass(frozen=True)
class Frame:
    """A panel's place in px."""

    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True, eq=False)
class Curve:
    """Values over the time of a run, or over another scale; dots mark them if wanted.

    Values (T,) hold over each step and are drawn as steps; (T + 1,) are at the instants between
    them, and joined.
    """

    name: str
    values: Floats
    style: Style
    in_legend: bool = True
    dots: bool = False
    joined: bool = True


@dataclass(frozen=True, eq=False)
class Band:
    """Band between two values of each step: shaded, or hatched where it has a name."""

    lower: Floats
    upper: Floats
    color: str
    name: str = ""


@dataclass(frozen=True)
class Limit:
    """A value that is drawn across; its name stands in the legend."""

    value: float
    name: str = ""
    dash: str = "5 3"

    @property
    def style(self) -> Style:
        """How it is drawn."""
        return Style(GREY, self.dash, 1.0)


@dataclass(frozen=True)
class Entry:
    """An entry of the legend: a line in a style, or a box with a fill, a hatch, or both."""

    name: str
    style: Style | None = None
    fill: str = ""
    hatch: str = ""
    kind: str = "lines"


class Panel(Protocol):
    """Panel of a chart over the time axis."""

    @property
    def height(self) -> float:
        """Height in px."""

    @property
    def left_px(self) -> float:
        """Width at the left of the frame, in px."""

    @property
    def right_px(self) -> float:
        """Width at the right of the frame, in px."""
        return 0.0

    @property
    def shaded(self) -> bool:
        """Whether outages lie behind it in grey; over it they would be bracketed."""

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Draw what lies over the axis."""

    def name(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Draw names, at its sides or where they move with the axis."""

    def entries(self) -> Iterable[Entry]:
        """Its entries in the legend."""
        return ()

    def readings(self) -> list[dict[str, Any]]:
        """Values under a pointer: name, color and the value of each step or instant as text."""
        return []

    def rows(self) -> dict[str, Any] | None:
        """Values under a pointer in a row ``of`` the run's customers, buses or lines, by number."""
        return None


@dataclass(frozen=True, eq=False)
class Curves:
    """A panel of curves, later ones on top; ``height`` is in px.

    The ends of the value axis are found from the values if not given. On a logarithmic one values
    below ``low`` lie at its bottom.
    """

    axis: str
    curves: Sequence[Curve]
    height: float
    low: float | None = None
    high: float | None = None
    limits: Sequence[Limit] = ()
    bands: Sequence[Band] = ()
    logarithmic: bool = False
    shaded: bool = True
    right_px = 0.0
    rows = Panel.rows

    @cached_property
    def _range(self) -> tuple[float, float]:
        values = [curve.values for curve in self.curves]
        values += [value for band in self.bands for value in (band.lower, band.upper)]
        values += [np.array([limit.value]) for limit in self.limits if limit.name]
        return range_of(values, self.low, self.high, self.logarithmic)

    def _axis(self, bottom: float, top: float) -> ValueAxis:
        return ValueAxis(*self._range, bottom, top, self.logarithmic)

    @property
    def left_px(self) -> float:
        """Width of ticks and the axis' name."""
        ticks = max((text_px(name) for _, name in self._axis(1.0, 0.0).ticks()), default=0.0)
        return ticks + 14.0 + LINE_PX * len(self.axis.split("\n"))

    def name(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Values of the axis, and its name."""
        for place, name in self._axis(frame.bottom, frame.top).ticks():
            canvas.text(frame.left - 6, place, name, anchor="end")
        canvas.line([(frame.left, frame.top), (frame.left, frame.bottom)], BLACK, 0.8)
        name_axis(canvas, frame, self.axis)

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Rules, limits, bands and curves."""
        axis = self._axis(frame.bottom, frame.top)
        for place, _ in axis.ticks():
            canvas.line([(frame.left, place), (frame.right, place)], RULE_COLOUR, 0.6)
        for limit in self.limits:
            place = float(axis(np.array(limit.value)))
            canvas.line([(frame.left, place), (frame.right, place)], GREY, 1.0, limit.dash)
        for band in self.bands:
            self._draw_band(canvas, axis, time, band)
        for curve in self.curves:
            points = _points(curve.values, axis, time)
            if curve.joined:
                canvas.line(points, curve.style.color, curve.style.width, curve.style.dash)
            if curve.dots:
                canvas.dots(points, curve.style.color)
        canvas.line([(frame.left, frame.bottom), (frame.right, frame.bottom)], BLACK, 0.8)

    def _draw_band(self, canvas: Canvas, axis: ValueAxis, time: Across, band: Band) -> None:
        """Every stretch of steps in which both values are known."""
        known = np.isfinite(band.lower) & np.isfinite(band.upper)
        fill = canvas.hatched(band.color) if band.name else band.color
        for first, last in spans_of(known):
            edges = np.repeat(time.edges[first : last + 1], 2)[1:-1]
            upper = np.repeat(axis(band.upper[first:last]), 2)
            lower = np.repeat(axis(band.lower[first:last]), 2)
            outline = [*zip(edges, upper, strict=True)]
            outline += reversed([*zip(edges, lower, strict=True)])
            canvas.area(outline, fill, 1.0 if band.name else 0.15)

    def entries(self) -> Iterable[Entry]:
        """Named curves, limits and bands."""
        for curve in self.curves:
            if curve.in_legend:
                yield Entry(curve.name, curve.style)
        for limit in self.limits:
            if limit.name:
                yield Entry(limit.name, limit.style)
        for band in self.bands:
            if band.name:
                yield Entry(band.name, hatch=band.color)

    def readings(self) -> list[dict[str, Any]]:
        """The curves with their values to five digits."""
        axis = self.axis.replace("\n", " ")
        alone = len(self.curves) == 1
        return [
            {
                "name": axis if alone else f"{axis}, {curve.name}",
                "color": curve.style.color,
                "values": [f"{v:,.5g}" if np.isfinite(v) else "" for v in curve.values.tolist()],
            }
            for curve in self.curves
        ]


def name_axis(canvas: Canvas, frame: Frame, axis: str) -> None:
    """Draw the name of a panel's left axis, beside its middle."""
    at = EDGE_PX + 0.5 * LINE_PX * len(axis.split("\n"))
    canvas.text(at, (frame.top + frame.bottom) / 2, axis, anchor="middle", turned=True)


def _points(values: Floats, axis: ValueAxis, time: Across) -> list[tuple[float, float]]:
    """Corners of a curve."""
    places = axis(values)
    edges = time.edges
    if len(values) == len(edges):
        return [*zip(edges, places, strict=True)]
    return [*zip(np.repeat(edges, 2)[1:-1], np.repeat(places, 2), strict=True)]


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels above each other over the time of a run, or over another scale.

    ``key`` names the chart, uniquely within a page.
    """

    key: str
    title: str
    across: Trajectory | Scale
    panels: Sequence[Panel]

    @cached_property
    def time(self) -> Across:
        """The axis that all panels share."""
        left = max(panel.left_px for panel in self.panels) + EDGE_PX
        right = max([*(panel.right_px for panel in self.panels), 14.0]) + EDGE_PX
        if isinstance(self.across, Scale):
            return ScaleAxis(self.across, left, WIDTH_PX - right)
        return TimeAxis(self.across, left, WIDTH_PX - right)

    def frames(self) -> list[Frame]:
        """Frames of the panels."""
        frames = []
        top = TITLE_PX
        for panel in self.panels:
            frames.append(Frame(self.time.left, self.time.right, top, top + panel.height))
            top += panel.height + GAP_PX
        return frames

    def svg(self) -> str:
        """The chart as an SVG document."""
        canvas = Canvas(self.key)
        frames = self.frames()
        canvas.text(WIDTH_PX / 2, 12.0, self.title, anchor="middle", size=13.0, moves="title")
        for panel, frame in zip(self.panels, frames, strict=True):
            with canvas.over_time(frame.left, frame.right, frame.top, frame.bottom):
                self._draw_time(canvas, frame, panel.shaded)
                panel.draw(canvas, frame, self.time)
                if not panel.shaded:
                    for place in (edge for outage in self.time.outages for edge in outage):
                        canvas.line([(place, frame.top), (place, frame.bottom)], BLACK, 1.4, "6 3")
            panel.name(canvas, frame, self.time)
        apart = -np.inf
        for begin, end in self.time.outages:
            middle, width = (begin + end) / 2, text_px("outage", SMALL_PX)
            if middle - width > apart:
                y = TITLE_PX - 9
                canvas.text(middle, y, "outage", anchor="middle", size=SMALL_PX, moves="at")
                apart = middle
        bottom = self._name_times(canvas, frames[-1].bottom)
        bottom = self._legend(canvas, bottom + 14.0)
        return canvas.svg(WIDTH_PX, bottom, self.title)

    def data(self) -> dict[str, Any]:
        """Values under the pointer for the page's script, as JSON can hold them."""
        frames = self.frames()
        return {
            "top": frames[0].top,
            "bottom": round(frames[-1].bottom, 1),
            "steps": len(self.time.edges) - 1,
            "curves": [reading for panel in self.panels for reading in panel.readings()],
            "rows": [
                {"top": round(frame.top, 1), "bottom": round(frame.bottom, 1)} | rows
                for panel, frame in zip(self.panels, frames, strict=True)
                if (rows := panel.rows()) is not None
            ],
        }

    def _draw_time(self, canvas: Canvas, frame: Frame, shaded: bool) -> None:
        """Outages in grey, and rules at the ticks."""
        if not shaded:
            return
        for begin, end in self.time.outages:
            canvas.box(begin, frame.top, end - begin, frame.bottom - frame.top, OUTAGE_COLOUR)
        with canvas.group("ticks"):
            for place, _ in self.time.ticks():
                canvas.line([(place, frame.top), (place, frame.bottom)], RULE_COLOUR, 0.6)

    def _name_times(self, canvas: Canvas, bottom: float) -> float:
        """Times below the last panel; where they end."""
        lines = 1
        for place, name in self.time.ticks():
            lines = len(name.split("\n"))
            at = bottom + 6 + 0.5 * LINE_PX * lines
            canvas.text(place, at, name, anchor="middle", moves="at tick")
        below = bottom + 14 + LINE_PX * lines
        middle = (self.time.left + self.time.right) / 2
        canvas.text(middle, below, self.time.title, anchor="middle", moves="middle")
        return below + 0.5 * LINE_PX

    def _legend(self, canvas: Canvas, top: float) -> float:
        """Entries side by side in rows, each row centred; where they end."""
        entries = {entry.name: entry for panel in self.panels for entry in panel.entries()}
        rows: list[list[Entry]] = []
        for entry in entries.values():
            room = WIDTH_PX - 2 * EDGE_PX
            if not rows or sum(map(_entry_px, [*rows[-1], entry])) > room:
                rows.append([])
            rows[-1].append(entry)
        for row in rows:
            x = (WIDTH_PX - sum(map(_entry_px, row)) + BETWEEN_PX) / 2
            for entry in row:
                with canvas.group("entry", _entry_px(entry)):
                    _draw_entry(canvas, entry, x, top)
                x += _entry_px(entry)
            top += 1.3 * LINE_PX
        return top + EDGE_PX / 2


def _entry_px(entry: Entry) -> float:
    return SAMPLE_PX + 6 + text_px(entry.name) + BETWEEN_PX


def _draw_entry(canvas: Canvas, entry: Entry, x: float, y: float) -> None:
    """A sample, and its name."""
    if entry.style is not None:
        style = entry.style
        canvas.line([(x, y), (x + SAMPLE_PX, y)], style.color, style.width, style.dash)
    else:
        canvas.box(x, y - 5, SAMPLE_PX, 10, entry.fill or "none", GREY)
        if entry.hatch:
            canvas.box(x, y - 5, SAMPLE_PX, 10, canvas.hatched(entry.hatch, entry.kind))
    canvas.text(x + SAMPLE_PX + 6, y, entry.name)


def styled(runs: Runs) -> list[tuple[str, Trajectory, Style]]:
    """Label, run and style of each run."""
    pairs = zip(named_runs(runs).items(), RUN_STYLES, strict=False)
    return [(label, run, style) for (label, run), style in pairs]


def named_runs(runs: Runs) -> dict[str, Trajectory]:
    """Runs by label; a single run is labelled by its controller."""
    return {label_of(runs): runs} if isinstance(runs, Trajectory) else dict(runs)


def label_of(run: Trajectory) -> str:
    """A run's controller, with its horizon."""
    horizon = horizon_h(run)
    others = str(run.options["controller"]).replace("-", " ")
    return others if horizon is None else f"MPC, H = {horizon:g} h"
