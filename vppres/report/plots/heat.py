"""A panel of coloured rows, one colour a step, with a key at its right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from vppres.core.arrays import Floats
from vppres.report.plots.axes import ValueAxis
from vppres.report.plots.canvas import FONT_PX, Canvas, text_px
from vppres.report.plots.chart import EDGE_PX, Across, Frame, Panel
from vppres.report.plots.palette import GREY, blend

MAX_NAMED_ROWS = 70
ROW_PX, MOST_PX, NAME_PX = 10.0, 460.0, 8.5
KEY_PX, KEY_COLOURS = 14.0, 64


@dataclass(frozen=True, eq=False)
class HeatMap(Panel):
    """Values of rows over the time of a run, (rows, T); NaN stays white.

    ``axis`` says what a row is, ``scale`` what the values are; colours go from the least to the
    largest, or between the ``ends`` that are given.
    """

    axis: str
    names: Sequence[str]
    values: Floats
    scale: str
    colours: tuple[str, ...]
    shaded: bool = False
    ends: tuple[float, float] | None = None

    @property
    def height(self) -> float:
        """Height in px: a row is as high as its name, while there is room."""
        return float(np.clip(ROW_PX * len(self.names), 120.0, MOST_PX))

    @property
    def left_px(self) -> float:
        """What the names take."""
        return row_names_px(self.names) + 1.6 * FONT_PX

    @property
    def right_px(self) -> float:
        """What the key takes."""
        ticks = max(text_px(name) for _, name in self._scale(1.0, 0.0).ticks())
        return 12.0 + KEY_PX + 8.0 + ticks + 1.8 * FONT_PX

    @cached_property
    def _range(self) -> tuple[float, float]:
        if self.ends is not None:
            return self.ends
        known = self.values[np.isfinite(self.values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
        return low, high if high > low else low + (abs(low) or 1.0) * 1e-3

    def _scale(self, bottom: float, top: float) -> ValueAxis:
        return ValueAxis(*self._range, bottom, top)

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Rows, their names, and the key."""
        low, high = self._range
        height = frame.bottom - frame.top
        pixels = blend(self.colours, (self.values - low) / (high - low))
        canvas.image(frame.left, frame.top, frame.right - frame.left, height, pixels)
        canvas.box(frame.left, frame.top, frame.right - frame.left, height, "none", GREY)
        draw_row_names(canvas, frame, self.names)
        middle = (frame.top + frame.bottom) / 2
        canvas.text(EDGE_PX + 0.6 * FONT_PX, middle, self.axis, anchor="middle", turned=True)
        self._draw_key(canvas, frame)

    def _draw_key(self, canvas: Canvas, frame: Frame) -> None:
        """The colours beside their values."""
        left = frame.right + 12.0
        height = frame.bottom - frame.top
        column = blend(self.colours, np.linspace(1.0, 0.0, KEY_COLOURS)[:, None])
        canvas.image(left, frame.top, KEY_PX, height, column)
        canvas.box(left, frame.top, KEY_PX, height, "none", GREY)
        for place, name in self._scale(frame.bottom, frame.top).ticks():
            canvas.line([(left + KEY_PX, place), (left + KEY_PX + 3, place)], GREY)
            canvas.text(left + KEY_PX + 6, place, name)
        at = frame.right + self.right_px - 0.9 * FONT_PX
        canvas.text(at, (frame.top + frame.bottom) / 2, self.scale, anchor="middle", turned=True)

    def readings(self) -> list[dict[str, Any]]:
        """Least and largest value of each step."""
        found = np.where(np.isfinite(self.values), self.values, np.nan)
        kinds = (("lowest", np.fmin.reduce(found)), ("highest", np.fmax.reduce(found)))
        return [
            {
                "name": f"{kind} of {self.scale}",
                "color": GREY,
                "values": [f"{v:,.5g}" if np.isfinite(v) else "" for v in values.tolist()],
            }
            for kind, values in kinds
        ]


def row_names_px(names: Sequence[str]) -> float:
    """What names of rows take at the left."""
    return max((text_px(name, NAME_PX) for name in names), default=0.0) + 8.0


def draw_row_names(canvas: Canvas, frame: Frame, names: Sequence[str]) -> None:
    """Names at the left; of many rows only some."""
    every = -(-len(names) // MAX_NAMED_ROWS)
    row_px = (frame.bottom - frame.top) / len(names)
    for number in range(0, len(names), every):
        place = frame.top + (number + 0.5) * row_px
        canvas.text(frame.left - 5, place, names[number], anchor="end", size=NAME_PX)
