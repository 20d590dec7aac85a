"""What all figures share: runs by label, colours and styles, panels, the clock, the outage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import Any, Literal

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, DateFormatter, num2date
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter

from vppres.core.arrays import Floats
from vppres.day.metrics import horizon_h
from vppres.day.series import edges_of, outage_spans
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock

Runs = Trajectory | Mapping[str, Trajectory]

# Okabe and Ito's palette: distinct for the common kinds of colour blindness.
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#CC79A7",
    "#56B4E9",
)
BLACK, GREY = "#000000", "#666666"
OUTAGE_COLOUR, RULE_COLOUR = "#E4E4E4", "#D0D0D0"
UNNAMED = "_"  # a leading underscore keeps a line out of the legend

DPI = 150
RASTER_ABOVE = 4000  # tiles of a map; as vectors they would make the page large
HOURS_OF_PLAIN_CLOCK = 48
MANY_STEPS = 48
# A fixed salt keeps two SVG files equal if their data are.
SVG_HASH_SALT = "vppres"


@dataclass(frozen=True)
class Style:
    """How one run, or tier, is told from another where their lines coincide.

    Later ones are thinner and have their markers on other steps, so that all can be seen.
    """

    color: str
    linestyle: str | tuple[int, tuple[int, ...]]
    marker: str
    linewidth: float
    first_marker: int

    def line(self, label: str = "") -> dict[str, Any]:
        """Keywords of a line in this style, with a marker on every third point."""
        return {
            "color": self.color,
            "linestyle": self.linestyle,
            "marker": self.marker,
            "markersize": 4,
            "markevery": slice(self.first_marker, -1, 3),
            "linewidth": self.linewidth,
            "label": label or UNNAMED,
        }

    def thin(self, label: str) -> dict[str, Any]:
        """Keywords of a companion of the same run: what was planned or modelled."""
        return self.line(label) | {"linestyle": ":", "linewidth": 1.0, "markerfacecolor": "white"}


RUN_STYLES = (
    Style(BLUE, "-", "o", 1.8, 0),
    Style(VERMILLION, (0, (5, 2)), "s", 1.6, 1),
    Style(GREEN, "-.", "^", 1.4, 2),
    Style(PURPLE, (0, (1, 1)), "D", 1.4, 0),
    Style(BLACK, (0, (6, 1, 1, 1, 1, 1)), "v", 1.2, 1),
)
# Vermillion is left to the tiles that were not served.
TIER_STYLES = (
    Style(BLACK, "-", "o", 2.6, 0),
    Style(SKY, (0, (5, 2)), "s", 2.0, 1),
    Style(GREEN, "-.", "^", 1.4, 2),
    Style(PURPLE, (0, (1, 1)), "D", 1.2, 0),
)
SERVED, UNSERVED = "#D6E6F2", VERMILLION


def plain(text: object) -> str:
    r"""Others' words for a figure: matplotlib reads what stands between two dollars as a formula.

    >>> print(plain("$x$"))
    \$x\$
    """
    return str(text).replace("$", r"\$")


def named_runs(runs: Runs) -> dict[str, Trajectory]:
    """Runs by label; a single run is labelled by its controller."""
    if not isinstance(runs, Trajectory):
        return {plain(label): run for label, run in runs.items()}
    horizon = horizon_h(runs)
    others = str(runs.options["controller"]).replace("-", " ")
    return {others if horizon is None else f"MPC, H = {horizon:g} h": runs}


def panels(
    runs: Mapping[str, Trajectory], heights: tuple[float, ...], height_in: float
) -> tuple[Figure, list[Axes]]:
    """Panels above each other over one time axis, with the outage shaded."""
    run = next(iter(runs.values()))
    figure = Figure(figsize=(8.6, height_in), layout="constrained")
    axes = list(
        figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    )
    for position, ax in enumerate(axes):
        mark_outage(ax, run, text=position == 0)
        draw_grid(ax)
    clock(axes[-1], run)
    figure.align_ylabels(axes)
    return figure, axes


def with_legend(figure: Figure, panel: Axes, columns: int) -> Figure:
    """Put the legend of one panel below the figure."""
    figure.legend(
        handles=panel.get_legend_handles_labels()[0],
        loc="outside lower center",
        ncols=columns,
        frameon=False,
    )
    return figure


def closed(values: Floats) -> Floats:
    """Values with the last one repeated: the height of a step at its end."""
    return np.append(values, values[-1])


def draw_steps(ax: Axes, run: Trajectory, values: Floats, line: Mapping[str, Any]) -> None:
    """A quantity that holds over each step; many steps have their markers further apart."""
    if "markevery" in line and len(values) > MANY_STEPS:
        first = line["markevery"].start
        line = {**line, "markevery": slice(first, -1, len(values) // (MANY_STEPS // 3))}
    ax.plot(edges_of(run), closed(values), drawstyle="steps-post", **line)


def draw_limit(ax: Axes, value: float, text: str, linestyle: str = "--") -> None:
    """A horizontal limit, named outside the axes."""
    ax.axhline(value, color=GREY, linestyle=linestyle, linewidth=1.0)
    ax.text(
        1.01, value, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8, color=GREY
    )


def mark_outage(ax: Axes, run: Trajectory, text: bool = True, shade: bool = True) -> None:
    """Shade or bracket every outage; name it above the axes."""
    edges = edges_of(run)
    for first, last in outage_spans(run):
        if shade:
            ax.axvspan(edges[first], edges[last], color=OUTAGE_COLOUR, zorder=0)
        else:
            for edge in (edges[first], edges[last]):
                ax.axvline(edge, color=BLACK, linewidth=1.2, linestyle="--")
        if text:
            middle = edges[first] + (edges[last] - edges[first]) / 2
            ax.text(
                middle,
                1.01,
                "outage",
                transform=ax.get_xaxis_transform(),
                ha="center",
                va="bottom",
                fontsize=8,
            )


def draw_grid(ax: Axes, axis: Literal["both", "x"] = "both") -> None:
    """Light rules behind the curves, and no frame above and at the right."""
    ax.grid(True, axis=axis, color=RULE_COLOUR, linewidth=0.5)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def clock(ax: Axes, run: Trajectory, max_ticks: int = 13) -> None:
    """Time axis in UTC, named with its day."""
    edges = edges_of(run)
    ax.set_xlim(edges[0], edges[-1])
    text = "%d %b\n%H:%M" if _has_dates(run) else "%H:%M"
    times = Clock.of(run)
    # Two classes of matplotlib's that carry no annotations yet.
    locator = AutoDateLocator(tz=UTC, minticks=4, maxticks=max_ticks)  # type: ignore[no-untyped-call]
    formatter: Formatter = DateFormatter(text, tz=UTC)  # type: ignore[no-untyped-call]
    if times.has_local:
        formatter = FuncFormatter(lambda value, _: _both_clocks(times, value, text))
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(formatter)
    below = f", {times.grid.zone} below" if times.has_local else ""
    ax.set_xlabel(f"Time (UTC{below}), from {edges[0]:%d %B %Y}")


def clock_lines(run: Trajectory) -> int:
    """How many lines the times below an axis have."""
    return 1 + _has_dates(run) + Clock.of(run).has_local


def _has_dates(run: Trajectory) -> bool:
    """Whether a run is so long that a time needs its date."""
    edges = edges_of(run)
    hours = (edges[-1] - edges[0]).total_seconds() / 3600.0
    return bool(hours > HOURS_OF_PLAIN_CLOCK)


def _both_clocks(clock: Clock, value: float, text: str) -> str:
    """A tick in UTC, and below it the hour of the clocks on the feeder."""
    utc = pd.Timestamp(num2date(value, tz=UTC))  # type: ignore[no-untyped-call]
    return f"{utc:{text}}\n({clock.grid.local(utc):%H:%M})"


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
