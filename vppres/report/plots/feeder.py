"""The feeder over the day: voltages and loadings of everything, and what the solver took."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vppres.core.arrays import Floats, Wholes
from vppres.day.series import line_values
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Chart, Curve, Curves, Limit, Runs, named_runs, styled
from vppres.report.plots.heat import HeatMap
from vppres.report.plots.palette import CIVIDIS
from vppres.report.tree_layout import tree_layout

GAP_SHOWN = 1e-9
"""Gaps below it lie at the bottom of their axis: they are rounding."""

RATING_SHOWN_FROM = 80.0
"""Largest loading in per cent from which the rating is drawn."""


def _curves(runs: Runs, values: Callable[[Trajectory], Floats]) -> list[Curve]:
    """A quantity of every run."""
    return [
        Curve(label, np.asarray(values(run), dtype=float), style)
        for label, run, style in styled(runs)
    ]


def line_loadings(runs: Runs) -> Chart:
    """Loading of the most loaded line, or the largest current where lines have no rating."""
    named = named_runs(runs)
    rated = all(run.scenario.network.has_ratings for run in named.values())
    largest = _curves(runs, lambda run: np.nanmax(line_values(run, rated), axis=1))
    near = rated and max(float(curve.values.max()) for curve in largest) > RATING_SHOWN_FROM
    return Chart(
        "line_loadings",
        "Line loading, AC power flow",
        next(iter(named.values())),
        [
            Curves(
                "Largest line\nloading (%)" if rated else "Largest line\ncurrent (A)",
                largest,
                180.0,
                low=0.0,
                limits=[Limit(100.0, "rating", dash="")] if near else (),
            )
        ],
    )


def solve_times(runs: Runs) -> Chart:
    """Time of each decision, and its proven relative gap where there is one."""
    gaps = _curves(runs, lambda run: run.steps["gap"].to_numpy(float))
    gap = Curves("Relative gap", gaps, 130.0, low=GAP_SHOWN, logarithmic=True)
    with_gap = any((curve.values > GAP_SHOWN).any() for curve in gaps)
    return Chart(
        "solve_times",
        "Time and optimality gap of each decision",
        next(iter(named_runs(runs).values())),
        [
            Curves(
                "Time for the\ndecision (s)",
                _curves(runs, lambda run: run.steps["solve_s"].to_numpy(float)),
                130.0,
                low=0.0,
            ),
            *([gap] if with_gap else ()),
        ],
    )


def feeder_maps(run: Trajectory) -> Chart:
    """A row per bus with its voltage, and a row per line with its loading, over the day."""
    net = run.scenario.network
    rated = net.has_ratings
    v = run.by_step("buses", "v_ac_pu")
    order = _along_the_feeder(run)
    lines = order[order > 0] - 1  # by the bus that each feeds
    return Chart(
        "feeder_maps",
        "Voltage of each bus and " + ("loading" if rated else "current") + " of each line",
        run,
        [
            HeatMap(
                "Bus",
                [str(bus) for bus in net.buses[order]],
                v[:, order].T,
                "AC voltage (pu)",
                CIVIDIS,
            ),
            HeatMap(
                "Line, by the bus that it feeds",
                [str(bus) for bus in net.to_bus[lines]],
                line_values(run, rated)[:, lines].T,
                "Loading (%)" if rated else "Current (A)",
                CIVIDIS[::-1],
            ),
        ],
    )


def _along_the_feeder(run: Trajectory) -> Wholes:
    """Buses as they stand in the one-line diagram, row by row: neighbours stay together."""
    layout = tree_layout(run.scenario.network)
    return np.lexsort((layout.column, layout.row))
