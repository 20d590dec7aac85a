"""Voltages per phase of the original feeder beside those of the plan."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.day.trajectory import Trajectory
from vppres.feeders.dss.recheck import PHASE_NAMES, Recheck
from vppres.report.plots.chart import Chart, Curve, Curves, Limit
from vppres.report.plots.palette import BLACK, RUN_STYLES, Style


def voltages_per_phase(run: Trajectory, found: Recheck) -> Chart:
    """Lowest voltage of each phase and of the plan, and the largest difference of a step."""
    network = run.scenario.network
    curves = []
    for phase, style in zip(PHASE_NAMES.values(), RUN_STYLES, strict=False):
        own = found.voltages[found.voltages["phase"] == phase]
        if not own.empty:
            curves.append(Curve(f"phase {phase}", _by_step(run, own, "v_pu"), style))
    plan = _by_step(run, found.voltages, "v_plan_pu")
    curves.append(Curve("plan", plan, Style(BLACK, "2 3", 1.5)))
    limit = Limit(network.v_min_ac_pu, f"{network.v_min_ac_pu:g} AC limit", dash="")
    largest = 1000.0 * found.steps["difference_max_pu"].to_numpy(float)
    apart = Curve("largest difference", largest, Style(BLACK, "", 1.5), in_legend=False)
    return Chart(
        "voltages_per_phase",
        "Voltages: the original feeder, phase by phase, against the plan",
        run,
        [
            Curves("Lowest bus voltage (pu)", curves, 220.0, limits=[limit]),
            Curves("Largest\ndifference\n(0.001 pu)", [apart], 105.0, low=0.0),
        ],
    )


def _by_step(run: Trajectory, table: pd.DataFrame, column: str) -> Floats:
    """The lowest value of each step, NaN where there is none."""
    grouped = table.groupby("time")[column].min()
    return np.asarray(grouped.reindex(run.steps["time"]), dtype=float)
