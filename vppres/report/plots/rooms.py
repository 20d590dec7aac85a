"""Temperatures of rooms and tanks."""

from __future__ import annotations

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.day.trajectory import Trajectory
from vppres.report.plots.chart import Chart, Curve, Curves, Limit
from vppres.report.plots.palette import BLACK, BLUE, Style

ROOM = Style(BLUE, "", 0.6)
MEDIAN = Style(BLACK, "", 2.0)


def indoor(run: Trajectory) -> Chart:
    """Temperature of each room and tank, and their median: those that are cooled, then heated."""
    loads = run.scenario.thermal_loads
    start_c, end_c = (run.by_step("thermal_loads", name) for name in ("t_start_c", "t_end_c"))
    t_c = np.vstack([start_c[:1], end_c])
    kinds = (("Cooled (°C)", ~loads.heats), ("Heated (°C)", loads.heats))
    panels = [_panel(run, axis, t_c, chosen) for axis, chosen in kinds if chosen.any()]
    return Chart("indoor", "Temperatures of rooms and tanks", run, panels)


def _panel(run: Trajectory, axis: str, t_c: Floats, chosen: Flags) -> Curves:
    """Those of a kind, with the ends of their comfort band if they have the same."""
    loads = run.scenario.thermal_loads
    each = [Curve("each", t_c[:, h], ROOM, in_legend=False) for h in np.flatnonzero(chosen)]
    median = Curve("median", np.median(t_c[:, chosen], axis=1), MEDIAN)
    ends = (("top of the band", loads.t_max_c), ("bottom of the band", loads.t_min_c))
    limits = [
        Limit(float(end_c[chosen][0]), name) for name, end_c in ends if np.ptp(end_c[chosen]) == 0.0
    ]
    return Curves(axis, [*each, median], 150.0, limits=limits)
