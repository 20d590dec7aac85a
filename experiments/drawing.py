"""What the experiments' figures have in common."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from experiments.results import DayResult
from vppres.core.arrays import Floats
from vppres.report.plots.palette import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RULE_COLOUR,
    VERMILLION,
)

MPC = "MPC"
FULL = "full horizon"
WIDTH_IN = 8.0
DAY_H = 24
DPI = 150

# A fixed salt keeps two SVG files equal if their data are.
SVG_HASH_SALT = "vppres"

# The second line is thinner and dashed, so that both are seen where they coincide.
LINES: dict[str, dict[str, Any]] = {
    MPC: {"color": BLUE, "linewidth": 2.4, "linestyle": "-"},
    FULL: {"color": VERMILLION, "linewidth": 1.5, "linestyle": (0, (5, 2))},
}
PLANNED: dict[str, Any] = {"color": GREEN, "linewidth": 1.3, "linestyle": (0, (1, 1))}
SERIES: dict[str, dict[str, Any]] = {
    "load": {"color": BLACK, "linewidth": 1.3},
    "pv": {"color": ORANGE, "linewidth": 1.5},
    "price": {"color": PURPLE, "linewidth": 1.3},
}
SPREAD, SPREAD_RANGE = "#8C3A00", "#F4C7A8"
PUBLISHED_RANGE = "#E4E4E4"


def draw_grid(ax: Axes, axis: Literal["both", "x"] = "both") -> None:
    """Light rules behind the curves, and no frame above and at the right."""
    ax.grid(True, axis=axis, color=RULE_COLOUR, linewidth=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def panels(heights: tuple[float, ...], height_in: float, title: str) -> tuple[Figure, list[Axes]]:
    """Panels above each other that share their horizontal axis."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    axes = list(
        figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    )
    for ax in axes:
        draw_grid(ax)
    figure.suptitle(title, fontsize=11)
    return figure, axes


def legend(figure: Figure, ax: Axes, columns: int) -> Figure:
    """The legend of one panel, below the figure."""
    handles = ax.get_legend_handles_labels()[0]
    # Matplotlib lists error bars last; they are what the figure is about.
    handles.sort(key=lambda handle: not isinstance(handle, ErrorbarContainer))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
    return figure


def day_axis(axes: list[Axes], day: DayResult) -> None:
    """Hours of the day on the lowest panel, the outage shaded on all."""
    first, last = outage_hours(day)
    for ax in axes:
        ax.axvspan(first, last, color="#F6DCD3", zorder=0)
    axes[0].text(
        (first + last) / 2,
        1.01,
        "outage",
        ha="center",
        va="bottom",
        fontsize=8,
        transform=axes[0].get_xaxis_transform(),
    )
    axes[-1].set_xlim(0, DAY_H)
    axes[-1].set_xticks(range(0, DAY_H + 1, 2))
    axes[-1].set_xlabel("Hour of 19 July 2022 (UTC)")


def over_steps(ax: Axes, values: Floats, line: Mapping[str, Any], label: str = "_") -> None:
    """A quantity that holds over each hour."""
    edges = np.arange(len(values) + 1)
    ax.plot(edges, np.append(values, values[-1]), drawstyle="steps-post", label=label, **line)


def limit(ax: Axes, value: float, text: str, linestyle: str = "--") -> None:
    """A horizontal limit with its name at the right."""
    ax.axhline(value, color=GREY, linestyle=linestyle, linewidth=1.0)
    ax.text(
        1.005, value, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8, color=GREY
    )


def outage_hours(day: DayResult) -> tuple[int, int]:
    """First hour of the outage, and the first after it."""
    hours = np.flatnonzero(day.series("outage"))
    return int(hours[0]), int(hours[-1]) + 1


def save_figure(figure: Figure, stem: Path) -> list[Path]:
    """Write one figure as PNG and SVG; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    stem : Path
        File without its ending, in an existing folder.

    Returns
    -------
    list of Path
        The files written.
    """
    png = stem.with_name(f"{stem.name}.png")
    svg = stem.with_name(f"{stem.name}.svg")
    with matplotlib.rc_context({"svg.hashsalt": SVG_HASH_SALT}):
        figure.savefig(svg, metadata={"Date": None})
    # The places are found; to find them again would take half of the time.
    figure.set_layout_engine("none")
    figure.savefig(png, dpi=DPI)
    return [png, svg]
