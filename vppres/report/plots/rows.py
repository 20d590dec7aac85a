"""Panels of rows over the time of a run: colours for values, tiles for customers, strips."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.day.metrics import service_by_tier as share_by_tier
from vppres.day.trajectory import Trajectory
from vppres.report.plots.axes import ValueAxis
from vppres.report.plots.chart import Across, Entry, Frame, Panel, name_axis
from vppres.report.plots.drawing import (
    BLACK,
    FONT_PX,
    GREEN,
    GREY,
    ORANGE,
    SERVED,
    UNSERVED,
    WHITE,
    Canvas,
    blend,
    shortened,
    text_px,
)
from vppres.report.tree_layout import tree_layout

MAX_NAMED_ROWS = 70
HEAT_ROW_PX, HEAT_MOST_PX, ROW_NAME_PX = 10.0, 460.0, 8.5
KEY_PX, KEY_COLOURS = 14.0, 64
MOST_LETTERS = 24
"""Of a row's name; the whole one is shown when it is pointed at."""


@dataclass(frozen=True, eq=False)
class HeatMap(Panel):
    """Values of rows over the time of a run, (rows, T); NaN stays white.

    ``axis`` says what a row is, ``scale`` what the values are; colours go from the least to the
    largest, or between the ``ends`` that are given. Rows may be ``of`` a run's buses or lines, with
    the ``number`` of each.
    """

    axis: str
    names: Sequence[str]
    values: Floats
    scale: str
    colours: tuple[str, ...]
    shaded: bool = False
    ends: tuple[float, float] | None = None
    of: str = ""
    number: Sequence[int] | Wholes = ()

    @property
    def height(self) -> float:
        """Height in px: a row is as high as its name, while there is room."""
        return float(np.clip(HEAT_ROW_PX * len(self.names), 120.0, HEAT_MOST_PX))

    @property
    def left_px(self) -> float:
        """Width of the names."""
        return row_names_px(self.names) + 1.6 * FONT_PX

    @property
    def right_px(self) -> float:
        """Width of the key."""
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
        """Rows."""
        low, high = self._range
        height = frame.bottom - frame.top
        pixels = blend(self.colours, (self.values - low) / (high - low))
        canvas.image(frame.left, frame.top, frame.right - frame.left, height, pixels)
        canvas.box(frame.left, frame.top, frame.right - frame.left, height, "none", GREY)

    def name(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Names of the rows, and the key."""
        draw_row_names(canvas, frame, self.names)
        name_axis(canvas, frame, self.axis)
        with canvas.group("right"):
            left = frame.right + 12.0
            height = frame.bottom - frame.top
            column = blend(self.colours, np.linspace(1.0, 0.0, KEY_COLOURS)[:, None])
            canvas.image(left, frame.top, KEY_PX, height, column)
            canvas.box(left, frame.top, KEY_PX, height, "none", GREY)
            for place, name in self._scale(frame.bottom, frame.top).ticks():
                canvas.line([(left + KEY_PX, place), (left + KEY_PX + 3, place)], GREY)
                canvas.text(left + KEY_PX + 6, place, name)
            at = frame.right + self.right_px - 0.9 * FONT_PX
            canvas.text(
                at, (frame.top + frame.bottom) / 2, self.scale, anchor="middle", turned=True
            )

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

    def rows(self) -> dict[str, Any] | None:
        """The bus or line of each row."""
        return {"of": self.of, "each": [[int(n)] for n in self.number]} if self.of else None


def row_names_px(names: Sequence[str]) -> float:
    """Width of the names of rows at the left."""
    widths = (text_px(shortened(name, MOST_LETTERS), ROW_NAME_PX) for name in names)
    return max(widths, default=0.0) + 8.0


def draw_row_names(canvas: Canvas, frame: Frame, names: Sequence[str]) -> None:
    """Names at the left; of many rows only some."""
    every = -(-len(names) // MAX_NAMED_ROWS)
    row_px = (frame.bottom - frame.top) / len(names)
    for number in range(0, len(names), every):
        place = frame.top + (number + 0.5) * row_px
        name = shortened(names[number], MOST_LETTERS)
        hint = names[number] if name != names[number] else ""
        canvas.text(frame.left - 5, place, name, anchor="end", size=ROW_NAME_PX, hint=hint)


MAX_NAMED_CUSTOMERS = 60
MAX_ROWS = 120
MOST_CROSSES = 1000
"""Tiles up to which those without supply are crossed; more would only be grey."""

ROW_PX, TIER_PX, MOST_PX = 12.0, 44.0, 600.0
"""Least heights of a row and of a tier's name, and the most of all rows."""


@dataclass(frozen=True)
class TileRows:
    """Rows of the tiles: names, the share served, (rows, T), tier and customers of each."""

    names: list[str]
    share: Floats
    tiers: list[str]
    customers: list[list[int]]


def tile_rows(run: Trajectory) -> TileRows:
    """A row per customer, tier after tier; of many customers, a row for some neighbours of a tier.

    Neighbours are next to each other along the feeder.
    """
    day = run.scenario
    served = run.supplied
    at_bus = np.array([day.network.bus_index[bus] for bus in day.customers.bus], dtype=int)
    size = -(-len(day.customers) // MAX_ROWS)
    layout = tree_layout(day.network)
    along = np.lexsort((layout.column[at_bus], layout.row[at_bus]))
    names = []
    shares = []
    tiers = []
    blocks = []
    for tier in day.tiers:
        members = np.flatnonzero(day.customers.tier == tier)
        if size > 1:
            members = along[np.isin(along, members)]
        for start in range(0, len(members), size):
            block = members[start : start + size]
            names.append(" ".join(str(name) for name in day.customers.id[block]))
            shares.append(served[:, block].mean(axis=1))
            tiers.append(tier)
            blocks.append(block.tolist())
    return TileRows(names, np.array(shares).reshape(len(names), -1), tiers, blocks)


@dataclass(frozen=True, eq=False)
class Tiles(Panel):
    """A tile per row and step, grouped by tier; crosses carry the message without colour."""

    axis: str
    run: Trajectory
    rows_of: TileRows
    shaded: bool = False

    @property
    def height(self) -> float:
        """Height in px: the smallest tier has room for its name, within reason."""
        smallest = min(map(self.rows_of.tiers.count, self.rows_of.tiers))
        row_px = max(TIER_PX / smallest, ROW_PX)
        return min(row_px * len(self.rows_of.names), MOST_PX)

    @property
    def names(self) -> list[str]:
        """Names of the rows, if there is room for them."""
        return self.rows_of.names if len(self.rows_of.names) <= MAX_NAMED_CUSTOMERS else []

    @property
    def left_px(self) -> float:
        """Width of the names."""
        return row_names_px(self.names) + 1.2 * FONT_PX * (1 + self.axis.count("\n"))

    @property
    def right_px(self) -> float:
        """Width of the names of the tiers."""
        return max(map(text_px, self._tier_texts().values())) + 10.0

    def _tier_texts(self) -> dict[str, str]:
        """Each tier's name, size and share in the outage."""
        island = self.run.steps["outage"].to_numpy(bool)
        in_outage = share_by_tier(self.run)[island].mean()
        texts = {}
        for tier, share in in_outage.items():
            count = int(np.sum(self.run.scenario.customers.tier == tier))
            served = f"\n{share:.0%} supplied\nin outage" if np.isfinite(share) else ""
            texts[str(tier)] = f"{tier} ({count}){served}"
        return texts

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Tiles and crosses."""
        share = self.rows_of.share
        width = frame.right - frame.left
        height = frame.bottom - frame.top
        canvas.image(frame.left, frame.top, width, height, blend((UNSERVED, SERVED), share))
        row_px = height / len(share)
        if share.size <= MOST_CROSSES:
            self._draw_tiles(canvas, frame, time, row_px)
        for below in self._tier_ends(frame).values():
            canvas.line([(frame.left, below), (frame.right, below)], BLACK)

    def _tier_ends(self, frame: Frame) -> dict[str, float]:
        """Ends of the rows of each tier, in px."""
        counts = {tier: self.rows_of.tiers.count(tier) for tier in self._tier_texts()}
        ends = frame.top + (frame.bottom - frame.top) * np.cumsum([*counts.values()]) / sum(
            counts.values()
        )
        return dict(zip(counts, ends.tolist(), strict=True))

    def name(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Names of the rows and tiers."""
        if self.names:
            draw_row_names(canvas, frame, self.names)
        name_axis(canvas, frame, self.axis)
        top, ends = frame.top, self._tier_ends(frame)
        with canvas.group("right"):
            for tier, text in self._tier_texts().items():
                words = text if ends[tier] - top >= TIER_PX else text.split("\n")[0]
                canvas.text(frame.right + 8, (top + ends[tier]) / 2, words)
                top = ends[tier]

    def _draw_tiles(self, canvas: Canvas, frame: Frame, time: Across, row_px: float) -> None:
        """Seams between the tiles, and a cross where no customer of a row is supplied."""
        edges = time.edges
        gap = (np.nan, np.nan)
        seams = [[(x, frame.top), (x, frame.bottom), gap] for x in edges[1:-1]]
        for row in range(1, len(self.rows_of.share)):
            y = frame.top + row * row_px
            seams.append([(frame.left, y), (frame.right, y), gap])
        canvas.line(itertools.chain.from_iterable(seams), WHITE, 0.7)
        arm = min(3.0, 0.3 * row_px)
        crosses = []
        for row, t in np.argwhere(self.rows_of.share == 0.0).tolist():
            x = (edges[t] + edges[t + 1]) / 2
            y = frame.top + (row + 0.5) * row_px
            crosses += [(x - arm, y - arm), (x + arm, y + arm), gap]
            crosses += [(x - arm, y + arm), (x + arm, y - arm), gap]
        canvas.line(crosses, WHITE, 1.2)

    def rows(self) -> dict[str, Any]:
        """The customers of each row."""
        return {"of": "customers", "each": self.rows_of.customers}

    def entries(self) -> Iterable[Entry]:
        """Meaning of the colours."""
        yield Entry("supplied", fill=SERVED)
        yield Entry("off supply (x)", fill=UNSERVED)


BATTERIES = "Batteries"
DARK, LIMITED, GIVING = "#707070", "#C8C8C8", "#FFFFFF"
STRIP_PX, STRIP_TEXT_PX = 34.0, 9.5

Look = tuple[str, str, str]
"""Fill, hatch (empty, ``lines`` or ``dots``) and text of a step."""


@dataclass(frozen=True)
class Strip:
    """A look for each step, and what a pointer reads of it."""

    name: str
    looks: Sequence[Look]
    said: Sequence[str] = ()


def _alike(looks: Sequence[Any]) -> Iterator[tuple[Any, int, int]]:
    """Stretches of steps that are alike: what they are, the first one, and the one after them."""
    end = 0
    for look, steps in groupby(looks):
        start, end = end, end + len(list(steps))
        yield look, start, end


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
        """Width of the names."""
        return max(text_px(strip.name) for strip in self.strips) + 8.0

    def draw(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Boxes."""
        edges = time.edges
        for row, strip in enumerate(self.strips):
            top = frame.top + STRIP_PX * row + 0.14 * STRIP_PX
            for (fill, hatch, _), start, end in _alike(strip.looks):
                width = edges[end] - edges[start]
                for fill_or_hatch in [fill, *([canvas.hatched(BLACK, hatch)] if hatch else [])]:
                    canvas.box(edges[start], top, width, 0.72 * STRIP_PX, fill_or_hatch, GREY)

    def name(self, canvas: Canvas, frame: Frame, time: Across) -> None:
        """Names, and texts of steps."""
        for row, strip in enumerate(self.strips):
            middle = frame.top + STRIP_PX * (row + 0.5)
            canvas.text(frame.left - 6, middle, strip.name, anchor="end")
            self._write(canvas, strip, time.edges, middle)

    def _write(self, canvas: Canvas, strip: Strip, edges: Any, middle: float) -> None:
        """Texts of steps, those of words once for steps that have the same."""
        for text, start, end in _alike([look[2] for look in strip.looks]):
            spans = [(t, t + 1) for t in range(start, end)] if text.isdigit() else [(start, end)]
            for first, last in spans:
                if text and edges[last] - edges[first] > text_px(text, STRIP_TEXT_PX):
                    at = (edges[first] + edges[last]) / 2
                    canvas.text(
                        at,
                        middle,
                        text,
                        anchor="middle",
                        size=STRIP_TEXT_PX,
                        bold=text.isdigit(),
                        moves="at",
                    )

    def entries(self) -> Iterable[Entry]:
        """Meaning of the colours."""
        yield Entry("outage", fill=DARK)
        if any(strip.name == BATTERIES for strip in self.strips):
            yield Entry("charging", fill=GREEN, hatch=BLACK)
            yield Entry("discharging", fill=ORANGE, hatch=BLACK, kind="dots")
        yield Entry("customers off supply", fill=UNSERVED)

    def readings(self) -> list[dict[str, Any]]:
        """Strips that say something of a step."""
        return [
            {"name": strip.name, "color": GREY, "values": strip.said}
            for strip in self.strips
            if strip.said
        ]
