"""The day at a glance: grid, batteries, sun and service as strips over one clock."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vppres.core.arrays import Floats
from vppres.day.series import battery_power_kw, edges_of
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import (
    BLACK,
    GREEN,
    GREY,
    ORANGE,
    SERVED,
    UNSERVED,
    clock,
    clock_lines,
)

MAX_COUNTED_STEPS = 50
IDLE_SHARE = 0.01  # of the batteries' power
PHASE_GREYS = ("#FFFFFF", "#D0D0D0", "#F0F0F0", "#B8B8B8")
LETTERS_ACROSS = 120  # that fit across the figure
DARK, LIMITED, GIVING = "#707070", "#C8C8C8", "#FFFFFF"
STRIP_IN, FRAME_IN = 0.42, 1.0  # below the strips are the clock and the legend
LINE_IN = 0.17  # of the clock's, where it has more than one
LEFT = 0.12
WIDTH = 0.85


def timeline(run: Trajectory) -> Figure:
    """Strips of the grid, the batteries, the PV power and the customers not served."""
    strips = [_grid_strip, _battery_strip, _sun_strip, _service_strip]
    if "phase" in run.steps:
        strips.insert(0, _phase_strip)
    below_in = FRAME_IN + LINE_IN * (clock_lines(run) - 1)
    height_in = below_in + STRIP_IN * len(strips)
    figure = Figure(figsize=(8.6, height_in))
    bottom = (below_in - 0.1) / height_in
    ax = figure.add_axes((LEFT, bottom, WIDTH, 0.97 - bottom))
    names = [strip(ax, run, row) for row, strip in enumerate(strips)]
    ax.set_ylim(len(strips) - 0.5, -0.5)
    ax.set_yticks(range(len(strips)), labels=names)
    ax.tick_params(axis="y", length=0)
    clock(ax, run)
    handles = [
        Patch(facecolor=DARK, edgecolor=GREY, label="outage"),
        Patch(facecolor=GREEN, hatch="///", edgecolor=GREY, label="charging"),
        Patch(facecolor=ORANGE, hatch="...", edgecolor=GREY, label="discharging"),
        Patch(facecolor=UNSERVED, edgecolor=GREY, label="customers not served"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=8)
    return figure


def _phase_strip(ax: Axes, run: Trajectory, row: int) -> str:
    """Phases of the day as the record names them."""
    edges = edges_of(run)
    phases = run.steps["phase"].astype(str).tolist()
    start = 0
    greys = {
        phase: PHASE_GREYS[i % len(PHASE_GREYS)] for i, phase in enumerate(dict.fromkeys(phases))
    }
    _strip(ax, run, row, [(greys[phase], "") for phase in phases])
    for phase, steps in groupby(phases):
        end = start + len(list(steps))
        if (end - start) * LETTERS_ACROSS > len(phase) * len(phases):
            middle = edges[start] + (edges[end] - edges[start]) / 2
            ax.text(middle, row, phase, ha="center", va="center", fontsize=7)
        start = end
    return "Phase"


def _grid_strip(ax: Axes, run: Trajectory, row: int) -> str:
    """Grid available, limited or out."""
    limit = run.scenario.grid_limit_kw[: len(run.steps)]
    colours = np.select([limit <= 0, np.isfinite(limit)], [DARK, LIMITED], GIVING)
    _strip(ax, run, row, [(colour, "") for colour in colours.tolist()])
    return "Grid"


def _battery_strip(ax: Axes, run: Trajectory, row: int) -> str:
    """Whether the batteries together charge or discharge."""
    power = battery_power_kw(run)
    rated = float(run.scenario.batteries.p_max_kw.sum())
    share = power / max(rated, 1e-9)
    states = np.select([share > IDLE_SHARE, share < -IDLE_SHARE], [1, 2], 0)
    styles = (("#FFFFFF", ""), (GREEN, "///"), (ORANGE, "..."))
    _strip(ax, run, row, [styles[state] for state in states.tolist()])
    return "Batteries"


def _sun_strip(ax: Axes, run: Trajectory, row: int) -> str:
    """PV power as a share of its largest of the day."""
    available = run.scenario.pv_kw[: len(run.steps)].sum(axis=1)
    shade = available / max(float(available.max()), 1e-9)
    _strip(ax, run, row, [((1.0, 1.0 - 0.1 * s, 1.0 - 0.75 * s), "") for s in shade])
    return "PV power"


def _service_strip(ax: Axes, run: Trajectory, row: int) -> str:
    """How many customers are not served: their number, and the darker the more."""
    served = run.customers["served"].to_numpy(bool).reshape(len(run.steps), -1)
    missing: Floats = (~served).sum(axis=1).astype(float)
    _strip(ax, run, row, [(UNSERVED if n else SERVED, "") for n in missing])
    edges = edges_of(run)
    if len(run.steps) <= MAX_COUNTED_STEPS:
        for t in np.flatnonzero(missing):
            ax.text(
                edges[t] + (edges[t + 1] - edges[t]) / 2,
                row,
                f"{missing[t]:.0f}",
                ha="center",
                va="center",
                fontsize=7,
                color=BLACK,
                fontweight="bold",
            )
    return "Not served"


def _strip(ax: Axes, run: Trajectory, row: int, styles: Iterable[tuple[Any, str]]) -> None:
    """One box for each stretch of steps that look alike; ``styles`` are colour and hatch."""
    edges = edges_of(run)
    start = 0
    for (colour, hatch), steps in groupby(styles):
        end = start + len(list(steps))
        ax.fill_between(
            [edges[start], edges[end]],
            row - 0.36,
            row + 0.36,
            facecolor=colour,
            edgecolor=GREY,
            linewidth=0.4,
            hatch=hatch,
        )
        start = end
