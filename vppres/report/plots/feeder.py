"""The feeder over the day: voltages and loadings of everything, and what the solver took."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.core.arrays import Floats, Wholes
from vppres.day.series import edges_of, line_values
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import (
    BLACK,
    GREY,
    RASTER_ABOVE,
    RUN_STYLES,
    Runs,
    clock,
    draw_limit,
    draw_steps,
    mark_outage,
    named_runs,
    panels,
    plain,
    with_legend,
)
from vppres.report.tree_layout import tree_layout

MAX_NAMED_ROWS = 70
ROW_IN = 0.11
GAP_SHOWN_LINEARLY = 1e-6


def line_loadings(runs: Runs) -> Figure:
    """Loading of the most loaded line, or the largest current where lines have no rating."""
    named = named_runs(runs)
    rated = all(run.scenario.network.has_ratings for run in named.values())
    figure, (ax,) = panels(named, heights=(1,), height_in=3.2)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        largest = np.nanmax(line_values(run, rated), axis=1)
        draw_steps(ax, run, largest, style.line(label))
    ax.set_ylim(bottom=0.0)
    if rated and ax.get_ylim()[1] > 80.0:
        draw_limit(ax, 100.0, "rating", linestyle="-")
    ax.set_ylabel("Largest line\nloading (%)" if rated else "Largest line\ncurrent (A)")
    figure.suptitle("Line loading, AC power flow")
    return with_legend(figure, ax, columns=len(named))


def solve_times(runs: Runs) -> Figure:
    """Time of each decision, and its proven relative gap."""
    named = named_runs(runs)
    figure, (seconds, gap) = panels(named, heights=(1, 1), height_in=4.6)
    for (label, run), style in zip(named.items(), itertools.cycle(RUN_STYLES), strict=False):
        draw_steps(seconds, run, run.steps["solve_s"].to_numpy(float), style.line(label))
        draw_steps(gap, run, run.steps["gap"].to_numpy(float), style.line())
    seconds.set_ylim(bottom=0.0)
    seconds.set_ylabel("Time for the\ndecision (s)")
    gap.set_yscale("symlog", linthresh=GAP_SHOWN_LINEARLY)
    gap.set_ylim(0.0, max(1e-4, 2.0 * gap.get_ylim()[1]))
    gap.set_ylabel("Relative gap")
    figure.suptitle("Time and optimality gap of each decision")
    return with_legend(figure, seconds, columns=len(named))


def feeder_maps(run: Trajectory) -> Figure:
    """A row per bus with its voltage, and a row per line with its loading, over the day."""
    net = run.scenario.network
    rated = run.scenario.network.has_ratings
    v = run.buses["v_ac_pu"].to_numpy(float).reshape(len(run.steps), -1)
    rows = min(net.n_buses, MAX_NAMED_ROWS)
    figure = Figure(figsize=(8.6, 2.6 + 2 * ROW_IN * max(rows, 12)), layout="constrained")
    buses, lines = figure.subplots(2, 1, sharex=True)
    order = _along_the_feeder(run)
    _draw_map(buses, run, v[:, order], "AC voltage (pu)", "cividis")
    _name_rows(buses, [plain(bus) for bus in net.buses[order]], "Bus")
    order = order[order > 0] - 1  # of the lines, by the bus that each feeds
    _draw_map(
        lines,
        run,
        line_values(run, rated)[:, order],
        "Loading (%)" if rated else "Current (A)",
        "cividis_r",
    )
    _name_rows(lines, [plain(bus) for bus in net.to_bus[order]], "Line, by the bus that it feeds")
    mark_outage(buses, run, shade=False)
    mark_outage(lines, run, text=False, shade=False)
    clock(lines, run)
    figure.suptitle(
        "Voltage of each bus and " + ("loading" if rated else "current") + " of each line"
    )
    return figure


def _along_the_feeder(run: Trajectory) -> Wholes:
    """Buses as they stand in the one-line diagram, row by row: neighbours stay together."""
    layout = tree_layout(run.scenario.network)
    return np.lexsort((layout.column, layout.row))


def _draw_map(ax: Axes, run: Trajectory, values: Floats, name: str, colours: str) -> None:
    """Values of shape (T, rows) as tiles with a scale; what is not defined stays white."""
    mesh = ax.pcolormesh(
        edges_of(run),
        np.arange(values.shape[1] + 1),
        np.ma.masked_invalid(values).T,
        cmap=colours,
        rasterized=values.size > RASTER_ABOVE,
    )
    ax.set_ylim(values.shape[1], 0)
    bar = ax.figure.colorbar(mesh, ax=ax, pad=0.01, fraction=0.04, aspect=24)
    bar.set_label(name)


def _name_rows(ax: Axes, names: list[str], title: str) -> None:
    """Names at the left; of many rows only some."""
    every = -(-len(names) // MAX_NAMED_ROWS)
    ax.set_yticks(np.arange(0, len(names), every) + 0.5, labels=names[::every], fontsize=6)
    ax.tick_params(axis="y", length=0)
    ax.set_ylabel(title, color=BLACK)
    for spine in ax.spines.values():
        spine.set_color(GREY)
