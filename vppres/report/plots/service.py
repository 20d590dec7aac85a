"""Who was served in each step."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vppres.core.arrays import Floats
from vppres.day.metrics import service_by_tier as share_by_tier
from vppres.day.series import edges_of
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import (
    BLACK,
    GREY,
    RASTER_ABOVE,
    SERVED,
    TIER_STYLES,
    UNSERVED,
    Runs,
    clock,
    draw_grid,
    draw_steps,
    mark_outage,
    named_runs,
    plain,
)
from vppres.report.tree_layout import tree_layout

MAX_NAMED_CUSTOMERS = 60
MAX_ROWS = 120


def service_by_tier(runs: Runs) -> Figure:
    """Who was served, step by step: a tile per customer, and the share of each tier."""
    named = named_runs(runs)
    n_customers = max(len(run.scenario.customers) for run in named.values())
    tiles_in = float(np.clip(0.16 * n_customers, 2.0, 9.0))
    figure = Figure(figsize=(3.6 + 4.6 * len(named), tiles_in + 3.2), layout="constrained")
    axes = figure.subplots(
        2, len(named), squeeze=False, sharex="col", height_ratios=(tiles_in, 1.7)
    )
    for column, (label, run) in enumerate(named.items()):
        tiles = axes[0, column]
        share = axes[1, column]
        tiles.set_title(label, fontsize=10, loc="left")
        _draw_tiles(tiles, run)
        _draw_shares(share, run)
        mark_outage(tiles, run, shade=False)
        mark_outage(share, run, text=False)
        clock(share, run, max_ticks=9)
    handles = [
        Patch(facecolor=SERVED, edgecolor=GREY, label="served"),
        Patch(facecolor=UNSERVED, label="not served (x)"),
        *axes[1, 0].get_legend_handles_labels()[0],
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False)
    figure.suptitle("Service by customer and tier")
    return figure


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
    served = run.customers["served"].to_numpy(float).reshape(len(run.steps), -1)
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


def _draw_tiles(ax: Axes, run: Trajectory) -> None:
    """A tile per row and step, grouped by tier; crosses carry the message without colour."""
    rows = tile_rows(run)
    edges = edges_of(run)
    many = rows.share.size > RASTER_ABOVE
    ax.pcolormesh(
        edges,
        np.arange(len(rows.names) + 1),
        rows.share,
        vmin=0,
        vmax=1,
        cmap=LinearSegmentedColormap.from_list("service", [UNSERVED, SERVED]),
        edgecolors="none" if many else "white",
        linewidth=0.6,
        rasterized=many,
    )
    if not many:
        at, steps = np.nonzero(rows.share == 0.0)
        middles = edges[:-1] + (edges[1:] - edges[:-1]) / 2
        ax.scatter(middles[steps], at + 0.5, marker="x", s=14, color="white", linewidths=1.0)
    ax.set_ylim(len(rows.names), 0)
    named = len(rows.names) <= MAX_NAMED_CUSTOMERS
    ax.set_yticks(
        np.arange(len(rows.names)) + 0.5 if named else [],
        labels=[plain(name) for name in rows.names] if named else [],
        fontsize=6.5,
    )
    ax.tick_params(axis="y", length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    _name_tiers(ax, run, rows)


def _name_tiers(ax: Axes, run: Trajectory, rows: TileRows) -> None:
    """Rules between the tiers, and each tier's name, size and share in the outage at the right."""
    top = 0
    in_outage = share_by_tier(run)[run.steps["outage"].to_numpy(bool)].mean()
    for tier, share in in_outage.items():
        count = int(np.sum(run.scenario.customers.tier == tier))
        height = rows.tiers.count(str(tier))
        share_text = f"\n{share:.0%} served\nin outage" if np.isfinite(share) else ""
        ax.text(
            1.01,
            top + height / 2,
            f"{plain(tier)} ({count}){share_text}",
            fontsize=8,
            va="center",
            transform=ax.get_yaxis_transform(),
        )
        top += height
        ax.axhline(top, color=BLACK, linewidth=1.0)


def _draw_shares(ax: Axes, run: Trajectory) -> None:
    """Share of each tier's customers that are served, in per cent."""
    shares = share_by_tier(run)
    for (tier, share), style in zip(shares.items(), itertools.cycle(TIER_STYLES), strict=False):
        draw_steps(ax, run, 100.0 * share.to_numpy(), style.line(plain(tier)))
    ax.set_ylim(-4.0, 104.0)
    ax.set_yticks([0, 50, 100])
    ax.set_ylabel("Customers\nserved (%)")
    draw_grid(ax)
