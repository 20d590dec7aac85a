"""The worth of a stored kWh over the day."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Floats
from vppres.day.priority import ranks_of
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Chart, Curve, Curves
from vppres.report.plots.palette import BLUE, GREY, VERMILLION, Style


def worth_of_energy(run: Trajectory) -> Chart:
    """The value of one more stored kWh, in customer hours and in GBP."""
    service = worth_per_step(run, "weighted_h")
    cost = worth_per_step(run, "gbp")
    price = run.steps["price_gbp_per_kwh"].to_numpy(float)
    ranks = ranks_of(run.scenario, run.options)
    # In strict order a customer of the last tier weighs 1.
    hours = (
        "weighted customer hours" if ranks is None else f"customer hours of tier {ranks.tiers[-1]}"
    )
    return Chart(
        "worth_of_energy",
        "Value of one more stored kWh",
        run,
        [
            Curves(
                "Customer hours\nper kWh",
                [Curve(f"{hours} per kWh", service, Style(VERMILLION))],
                120.0,
                low=0.0 if not (service < 0.0).any() else None,
            ),
            Curves(
                "GBP per kWh",
                [
                    Curve("GBP per kWh", cost, Style(BLUE)),
                    Curve("import price", price, Style(GREY, "2 3", 1.4)),
                ],
                120.0,
                low=0.0 if not (cost < 0.0).any() and price.min() >= 0.0 else None,
            ),
        ],
    )


def worth_per_step(trajectory: Trajectory, column: str) -> Floats:
    """Largest worth of a stored kWh in any battery, shape (T,); NaN where it is not known."""
    prices = trajectory.shadow_prices
    if prices is None:
        return np.full(len(trajectory.steps), np.nan)
    stored = prices[prices["constraint"] == "stored_energy"]
    best = stored.groupby("time")[column].max()
    return best.reindex(trajectory.steps["time"]).to_numpy(float)
