"""Voltages per phase of the original feeder beside those of the plan."""

from __future__ import annotations

import itertools

import numpy as np
from matplotlib.figure import Figure

from vppres.core.arrays import Floats
from vppres.day.trajectory import Trajectory
from vppres.feeders.dss.recheck import PHASE_NAMES, Recheck
from vppres.report.plots.base import BLACK, RUN_STYLES, draw_limit, draw_steps, panels, with_legend


def voltages_per_phase(run: Trajectory, found: Recheck) -> Figure:
    """Lowest voltage of each phase and of the plan, and the largest difference of a step."""
    network = run.scenario.network
    figure, (lowest, apart) = panels({"": run}, heights=(3, 1.4), height_in=6.4)
    for phase, style in zip(PHASE_NAMES.values(), itertools.cycle(RUN_STYLES), strict=False):
        own = found.voltages[found.voltages["phase"] == phase]
        if not own.empty:
            draw_steps(lowest, run, _by_step(run, own, "v_pu", "min"), style.line(f"phase {phase}"))
    plan = {"color": BLACK, "linewidth": 1.2, "linestyle": ":", "label": "plan"}
    draw_steps(lowest, run, _by_step(run, found.voltages, "v_plan_pu", "min"), plan)
    draw_limit(lowest, network.v_min_ac_pu, f"{network.v_min_ac_pu:g} AC limit", linestyle="-")
    lowest.set_ylabel("Lowest bus voltage (pu)")
    largest = 1000.0 * found.steps["difference_max_pu"].to_numpy(float)
    draw_steps(apart, run, largest, {"color": BLACK, "linewidth": 1.2})
    apart.set_ylabel("Largest\ndifference\n(0.001 pu)")
    apart.set_ylim(bottom=0.0)
    figure.suptitle("Voltages: the original feeder, phase by phase, against the plan")
    return with_legend(figure, lowest, columns=len(PHASE_NAMES) + 1)


def _by_step(run: Trajectory, table: object, column: str, how: str) -> Floats:
    """One value a step, NaN where there is none."""
    grouped = table.groupby("time")[column].agg(how)  # type: ignore[attr-defined]
    return np.asarray(grouped.reindex(run.steps["time"]), dtype=float)
