"""What the experiments' figures have in common."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from experiments.results import DayResult
from vppres.report.plot import finish, line_of
from vppres.report.plots.drawing import PURPLE, RULE_COLOUR, RUN_STYLES, Style

MPC = "MPC"
FULL = "full horizon"
WIDTH_IN = 8.0
DAY_H = 24

STYLES: dict[str, Style] = dict(zip((MPC, FULL), RUN_STYLES, strict=False))
LINES: dict[str, dict[str, Any]] = {name: line_of(style) for name, style in STYLES.items()}
PRICE = Style(PURPLE, "", 1.3)
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
    """Hours of the day on the lowest panel, below the first, which has the legend."""
    for ax in axes[1:]:
        finish(ax, day).legend().remove()
    axes[0].label_outer()
    axes[-1].set_xticks(range(0, DAY_H + 1, 2))
    axes[-1].set_xlabel("Hour of 19 July 2022 (UTC)")


def outage_hours(day: DayResult) -> tuple[int, int]:
    """First hour of the outage, and the first after it."""
    hours = np.flatnonzero(day.series("outage"))
    return int(hours[0]), int(hours[-1]) + 1
