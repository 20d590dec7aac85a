"""Probabilities of outages, beside what came."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Floats
from vppres.day.outages import BELIEF, LIKELY, believed_outages
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Band, Chart, Curve, Curves
from vppres.report.plots.palette import BLACK, BLUE, VERMILLION, Style

LEADS = {1.0: Style(BLUE, "", 2.6), 3.0: Style(BLUE, "7 3", 1.8), 6.0: Style(BLUE, "2 3", 1.4)}
"""How many hours before a step its probability is shown, and how."""


def has_beliefs(run: Trajectory) -> bool:
    """Whether a run believed something of outages ahead."""
    return run.options.get("outages") in (BELIEF, LIKELY)


def outage_belief(run: Trajectory) -> Chart:
    """Probability of an outage some hours before each step, and what stored energy was worth."""
    believed = believed_outages(run.scenario, run.options)[: len(run.steps), : len(run.steps)]
    dt_h = run.scenario.grid.dt_h
    curves = [
        Curve(f"{lead_h:g} h before", _before(believed, round(lead_h / dt_h)), style)
        for lead_h, style in LEADS.items()
    ]
    values = [curve.values for curve in curves]
    fan = Band(np.fmin.reduce(values), np.fmax.reduce(values), BLUE)
    panels = [Curves("Probability of an outage", curves, 220.0, low=0.0, high=1.02, bands=[fan])]
    if "stored_value_gbp_per_kwh" in run.steps:
        panels.append(_worth(run))
    return Chart("outage_belief", "Outage forecasts; grey: actual outages", run, panels)


def _before(believed: Floats, steps: int) -> Floats:
    """Probability of each step as it was known so many steps before, NaN where it was not."""
    found = np.full(len(believed), np.nan)
    if steps < len(believed):
        found[steps:] = np.diagonal(believed, steps)
    return found


def _worth(run: Trajectory) -> Curves:
    """What one more stored kWh was worth, and what one costs."""
    worth = run.steps["stored_value_gbp_per_kwh"].to_numpy(float)
    price = run.steps["price_gbp_per_kwh"].to_numpy(float)
    return Curves(
        "GBP per kWh",
        [
            Curve("worth of one more stored kWh", worth, Style(VERMILLION, "", 2.0)),
            Curve("import price", price, Style(BLACK, "2 3", 1.3)),
        ],
        130.0,
    )
