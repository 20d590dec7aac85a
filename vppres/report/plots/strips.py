"""The day at a glance: grid, batteries, sun and service as strips over one clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.day.series import battery_power_kw, off_kw
from vppres.day.trajectory import Trajectory
from vppres.report.plots.canvas import Canvas, text_px
from vppres.report.plots.chart import Across, Chart, Entry, Frame, Panel
from vppres.report.plots.palette import BLACK, GREEN, GREY, ORANGE, SERVED, UNSERVED, WHITE, blend

MAX_COUNTED_STEPS = 50
IDLE_SHARE = 0.01  # of the batteries' power
PHASE_GREYS = ("#FFFFFF", "#D0D0D0", "#F0F0F0", "#B8B8B8")
DARK, LIMITED, GIVING = "#707070", "#C8C8C8", "#FFFFFF"
SUN = (WHITE, "#FFE640")
STRIP_PX, SMALL_PX = 34.0, 9.5

Look = tuple[str, str, str]
"""Fill, hatch (empty, ``lines`` or ``dots``) and text of a step."""


@dataclass(frozen=True)
class Strip:
    """A look for each step."""

    name: str
    looks: Sequence[Look]


def timeline(run: Trajectory) -> Chart:
    """Strips of the grid, the batteries, the PV power, and what is off supply."""
    makers: list[Callable[[Trajectory], Strip]] = [
        _grid_strip,
        *([_battery_strip] if len(run.scenario.batteries) else []),
        *([_sun_strip] if len(run.scenario.pv) else []),
        _service_strip,
        _off_strip,
    ]
    if "phase" in run.steps:
        makers.insert(0, _phase_strip)
    return Chart("timeline", "The day at a glance", run, [Strips([make(run) for make in makers])])


def _phase_strip(run: Trajectory) -> Strip:
    """Phases of the day as the record names them."""
    phases = run.steps["phase"].astype(str).tolist()
    names = dict.fromkeys(phases)
    greys = {phase: PHASE_GREYS[i % len(PHASE_GREYS)] for i, phase in enumerate(names)}
    return Strip("Phase", [(greys[phase], "", phase) for phase in phases])


def _grid_strip(run: Trajectory) -> Strip:
    """Grid available, limited or out."""
    limit = run.scenario.grid_limit_kw[: len(run.steps)]
    colours = np.select([limit <= 0, np.isfinite(limit)], [DARK, LIMITED], GIVING)
    return Strip("Grid", [(str(colour), "", "") for colour in colours])


def _battery_strip(run: Trajectory) -> Strip:
    """Whether the batteries together charge or discharge."""
    rated = float(run.scenario.batteries.p_max_kw.sum())
    share = battery_power_kw(run) / max(rated, 1e-9)
    states = np.select([share > IDLE_SHARE, share < -IDLE_SHARE], [1, 2], 0)
    looks = ((WHITE, "", ""), (GREEN, "lines", ""), (ORANGE, "dots", ""))
    return Strip("Batteries", [looks[state] for state in states])


def _sun_strip(run: Trajectory) -> Strip:
    """PV power as a share of its largest of the day."""
    available = run.scenario.pv_kw[: len(run.steps)].sum(axis=1)
    shares = available / max(float(available.max()), 1e-9)
    colours = [f"#{red:02x}{green:02x}{blue:02x}" for red, green, blue in blend(SUN, shares)]
    return Strip("PV power", [(colour, "", "") for colour in colours])


def _service_strip(run: Trajectory) -> Strip:
    """How many customers are not served."""
    return _off("Off supply", (~run.by_step("customers", "served")).sum(axis=1))


def _off_strip(run: Trajectory) -> Strip:
    """Demand of customers that are off supply, in kW."""
    return _off("kW off", off_kw(run))


def _off(name: str, missing: Floats | Wholes) -> Strip:
    """Steps in which something is off, with its number while there is room."""
    counted = len(missing) <= MAX_COUNTED_STEPS
    return Strip(
        name,
        [(UNSERVED if n else SERVED, "", f"{n:.0f}" if n and counted else "") for n in missing],
    )


@dataclass(frozen=True, eq=False)
class Strips(Panel):
    """Strips below each other, each with a box for steps that look alike."""

    strips: Sequence[Strip]
    shaded: bool = True

    @property
    def height(self) -> float:
        """Height in px."""
        return STRIP_PX * len(self.strips)

    @property
    def left_px(self) -> float:
        """What the names take."""
        return max(text_px(strip.name) for strip in self.strips) + 8.0

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Boxes and texts."""
        edges = time.edges
        for row, strip in enumerate(self.strips):
            top = frame.top + STRIP_PX * row + 0.14 * STRIP_PX
            middle = frame.top + STRIP_PX * (row + 0.5)
            canvas.text(frame.left - 6, middle, strip.name, anchor="end")
            start = 0
            for (fill, hatch, _), steps in groupby(strip.looks):
                end = start + len(list(steps))
                width = edges[end] - edges[start]
                canvas.box(edges[start], top, width, 0.72 * STRIP_PX, fill, GREY)
                if hatch:
                    over = canvas.hatched(BLACK, hatch)
                    canvas.box(edges[start], top, width, 0.72 * STRIP_PX, over, GREY)
                start = end
            self._write(canvas, strip, edges, middle)

    def _write(self, canvas: Canvas, strip: Strip, edges: Any, middle: float) -> None:
        """Texts of steps, those of words once for steps that have the same."""
        start = 0
        for text, steps in groupby(look[2] for look in strip.looks):
            end = start + len(list(steps))
            spans = [(t, t + 1) for t in range(start, end)] if text.isdigit() else [(start, end)]
            for first, last in spans:
                if text and edges[last] - edges[first] > text_px(text, SMALL_PX):
                    at = (edges[first] + edges[last]) / 2
                    bold = text.isdigit()
                    canvas.text(at, middle, text, anchor="middle", size=SMALL_PX, bold=bold)
            start = end

    def entries(self) -> Iterable[Entry]:
        """What the colours mean."""
        yield Entry("outage", fill=DARK)
        yield Entry("charging", fill=GREEN, hatch=BLACK)
        yield Entry("discharging", fill=ORANGE, hatch=BLACK, kind="dots")
        yield Entry("customers off supply", fill=UNSERVED)
