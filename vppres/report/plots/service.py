"""Who was served in each step."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.day.metrics import service_by_tier as share_by_tier
from vppres.day.trajectory import Trajectory
from vppres.report.plots.canvas import FONT_PX, Canvas, text_px
from vppres.report.plots.chart import (
    EDGE_PX,
    Across,
    Chart,
    Curve,
    Curves,
    Entry,
    Frame,
    Panel,
    Runs,
    named_runs,
)
from vppres.report.plots.heat import draw_row_names, row_names_px
from vppres.report.plots.palette import (
    BLACK,
    SERVED,
    TIER_STYLES,
    UNSERVED,
    WHITE,
    blend,
)
from vppres.report.tree_layout import tree_layout

MAX_NAMED_CUSTOMERS = 60
MAX_ROWS = 120
MOST_CROSSES = 1000
"""Tiles up to which those without supply are crossed; more would only be grey."""

ROW_PX, TIER_PX, MOST_PX = 12.0, 44.0, 600.0
"""Least heights of a row and of a tier's name, and the most of all rows."""


def service_by_tier(runs: Runs) -> Chart:
    """Who was served, step by step: a tile per customer, and the share of each tier."""
    named = named_runs(runs)
    panels: list[Panel] = []
    for label, run in named.items():
        title = f"{label}\n" if len(named) > 1 else ""
        panels.append(Tiles(f"{title}Customer", run, tile_rows(run)))
        panels.append(_shares(run, f"{title}Customers\nsupplied (%)"))
    first = next(iter(named.values()))
    return Chart("service_by_tier", "Supply by customer and tier", first, panels)


def _shares(run: Trajectory, axis: str) -> Curves:
    """Share of each tier's customers that are served, in per cent."""
    curves = [
        Curve(str(tier), 100.0 * share.to_numpy(float), style)
        for (tier, share), style in zip(
            share_by_tier(run).items(), itertools.cycle(TIER_STYLES), strict=False
        )
    ]
    return Curves(axis, curves, 110.0, low=-4.0, high=104.0)


@dataclass(frozen=True)
class TileRows:
    """Rows of the tiles: names, the share served, shape (rows, T), and the tier of each."""

    names: list[str]
    share: Floats
    tiers: list[str]


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
    for tier in day.tiers:
        members = np.flatnonzero(day.customers.tier == tier)
        if size > 1:
            members = along[np.isin(along, members)]
        for start in range(0, len(members), size):
            block = members[start : start + size]
            names.append(" ".join(str(name) for name in day.customers.id[block]))
            shares.append(served[:, block].mean(axis=1))
            tiers.append(tier)
    return TileRows(names, np.array(shares).reshape(len(names), -1), tiers)


@dataclass(frozen=True, eq=False)
class Tiles(Panel):
    """A tile per row and step, grouped by tier; crosses carry the message without colour."""

    axis: str
    run: Trajectory
    rows: TileRows
    shaded: bool = False

    @property
    def height(self) -> float:
        """Height in px: the smallest tier has room for its name, within reason."""
        smallest = min(map(self.rows.tiers.count, self.rows.tiers))
        row_px = max(TIER_PX / smallest, ROW_PX)
        return min(row_px * len(self.rows.names), MOST_PX)

    @property
    def names(self) -> list[str]:
        """Names of the rows, if there is room for them."""
        return self.rows.names if len(self.rows.names) <= MAX_NAMED_CUSTOMERS else []

    @property
    def left_px(self) -> float:
        """What the names take."""
        return row_names_px(self.names) + 1.2 * FONT_PX * (1 + self.axis.count("\n"))

    @property
    def right_px(self) -> float:
        """What the names of the tiers take."""
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
        """Tiles, crosses, names of the rows and tiers."""
        share = self.rows.share
        width = frame.right - frame.left
        height = frame.bottom - frame.top
        canvas.image(frame.left, frame.top, width, height, blend((UNSERVED, SERVED), share))
        row_px = height / len(share)
        if share.size <= MOST_CROSSES:
            self._draw_tiles(canvas, frame, time, row_px)
        if self.names:
            draw_row_names(canvas, frame, self.names)
        middle = (frame.top + frame.bottom) / 2
        at = EDGE_PX + 0.6 * FONT_PX * (1 + self.axis.count("\n"))
        canvas.text(at, middle, self.axis, anchor="middle", turned=True)
        top = frame.top
        for tier, text in self._tier_texts().items():
            below = top + row_px * self.rows.tiers.count(tier)
            room = below - top >= TIER_PX
            canvas.text(frame.right + 8, (top + below) / 2, text if room else text.split("\n")[0])
            top = below
            canvas.line([(frame.left, top), (frame.right, top)], BLACK)

    def _draw_tiles(self, canvas: Canvas, frame: Frame, time: Across, row_px: float) -> None:
        """Seams between the tiles, and a cross where no customer of a row is supplied."""
        edges = time.edges
        gap = (np.nan, np.nan)
        seams = [[(x, frame.top), (x, frame.bottom), gap] for x in edges[1:-1]]
        for row in range(1, len(self.rows.share)):
            y = frame.top + row * row_px
            seams.append([(frame.left, y), (frame.right, y), gap])
        canvas.line(itertools.chain.from_iterable(seams), WHITE, 0.7)
        arm = min(3.0, 0.3 * row_px)
        crosses = []
        for row, t in np.argwhere(self.rows.share == 0.0).tolist():
            x = (edges[t] + edges[t + 1]) / 2
            y = frame.top + (row + 0.5) * row_px
            crosses += [(x - arm, y - arm), (x + arm, y + arm), gap]
            crosses += [(x - arm, y + arm), (x + arm, y - arm), gap]
        canvas.line(crosses, WHITE, 1.2)

    def entries(self) -> Iterable[Entry]:
        """What the colours mean."""
        yield Entry("supplied", fill=SERVED)
        yield Entry("off supply (x)", fill=UNSERVED)
