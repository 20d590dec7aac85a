"""What was believed of outages, beside what came."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.core.arrays import Floats
from vppres.day.outages import BELIEF, LIKELY, believed_outages
from vppres.day.series import edges_of
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import (
    BLACK,
    BLUE,
    VERMILLION,
    closed,
    draw_steps,
    panels,
    with_legend,
)

LEADS_H = (1.0, 3.0, 6.0)
"""How long before a step its probability is shown."""

WIDE = 30.0
"""Ratio of worths from which they are drawn on a logarithmic scale."""


def has_beliefs(run: Trajectory) -> bool:
    """Whether a run believed something of outages ahead."""
    return run.options.get("outages") in (BELIEF, LIKELY)


def outage_belief(run: Trajectory) -> Figure:
    """Probability of an outage some hours before each step, and what stored energy was worth."""
    believed = believed_outages(run.scenario, run.options)[: len(run.steps), : len(run.steps)]
    valued = "stored_value_gbp_per_kwh" in run.steps
    heights = (3.0, 1.6) if valued else (3.0,)
    figure, axes = panels({"": run}, heights=heights, height_in=1.7 + 1.1 * sum(heights))
    fan = axes[0]
    dt_h = run.scenario.grid.dt_h
    curves = {lead_h: _before(believed, round(lead_h / dt_h)) for lead_h in LEADS_H}
    lower = np.fmin.reduce(list(curves.values()))
    upper = np.fmax.reduce(list(curves.values()))
    edges = edges_of(run)
    low, high = closed(lower), closed(upper)
    fan.fill_between(edges, low, high, step="post", color=BLUE, alpha=0.12, linewidth=0.0)
    for (lead_h, curve), width in zip(curves.items(), (2.2, 1.5, 0.9), strict=True):
        line = {"color": BLUE, "linewidth": width, "label": f"{lead_h:g} h before"}
        draw_steps(fan, run, curve, line)
    fan.set_ylim(0.0, 1.02)
    fan.set_ylabel("Probability of an outage")
    if valued:
        _draw_worth(axes[1], run)
    figure.suptitle("Outage forecasts; shaded: actual outages")
    return with_legend(figure, fan, columns=len(LEADS_H))


def _before(believed: Floats, steps: int) -> Floats:
    """Probability of each step as it was believed so many steps before, NaN where nobody did."""
    found = np.full(len(believed), np.nan)
    if steps < len(believed):
        found[steps:] = np.diagonal(believed, steps)
    return found


def _draw_worth(ax: Axes, run: Trajectory) -> None:
    """What one more stored kWh was worth, and what one costs."""
    worth = run.steps["stored_value_gbp_per_kwh"].to_numpy(float)
    price = run.steps["price_gbp_per_kwh"].to_numpy(float)
    draw_steps(ax, run, worth, {"color": VERMILLION, "linewidth": 1.6})
    draw_steps(ax, run, price, {"color": BLACK, "linewidth": 0.9, "linestyle": ":"})
    least = min(float(np.nanmin(worth)), float(price.min()))
    if least > 0.0 and np.nanmax(worth) > WIDE * least:
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylabel("Worth of one more\nstored kWh (GBP)\ndotted: price")
