"""The worth of a stored kWh over the day, as a figure."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from vppres.core.arrays import Floats
from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import BLUE, GREY, VERMILLION, draw_steps, panels


def draw_worth(trajectory: Trajectory) -> Figure:
    """The value of one more stored kWh, in weighted customer hours and in GBP."""
    figure, (service, cost) = panels({"run": trajectory}, heights=(1, 1), height_in=4.4)
    for ax, column, color in ((service, "weighted_h", VERMILLION), (cost, "gbp", BLUE)):
        draw_steps(ax, trajectory, worth_per_step(trajectory, column), {"color": color})
    service.set_ylabel("Weighted customer\nhours per kWh")
    cost.set_ylabel("GBP per kWh")
    draw_steps(
        cost,
        trajectory,
        trajectory.steps["price_gbp_per_kwh"].to_numpy(float),
        {"color": GREY, "linestyle": ":", "label": "import price"},
    )
    for ax in (service, cost):
        ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    cost.legend(frameon=False, fontsize=8)
    figure.suptitle("Value of one more stored kWh")
    return figure


def worth_per_step(trajectory: Trajectory, column: str) -> Floats:
    """Largest worth of a stored kWh in any battery, shape (T,); NaN where it is not known."""
    prices = trajectory.shadow_prices
    if prices is None:
        return np.full(len(trajectory.steps), np.nan)
    stored = prices[prices["constraint"] == "stored_energy"]
    best = stored.groupby("time")[column].max()
    return best.reindex(trajectory.steps["time"]).to_numpy(float)
