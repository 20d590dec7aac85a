"""Voltages and line loading."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.day.metrics import line_current_a, line_loading
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.key_figures import number
from vppres.report.sections.base import Run, Section, section

LINES_SHOWN = 10


def network_section(run: Run) -> Section:
    """Voltages, loadings and the lines that came closest to their rating."""
    return section(
        "network",
        "Voltages and line loading",
        {
            "lines": _top_lines(run.trajectory),
            "number": number,
            "heading": Clock.of(run.trajectory).heading,
            "figures": [run.figure("voltages"), run.figure("line_loadings")],
            "maps": run.figure("feeder_maps"),
            "rated": run.trajectory.scenario.network.has_ratings,
        },
    )


def _top_lines(run: Trajectory) -> list[dict[str, Any]]:
    """The most loaded lines, or those with the largest current where there are no ratings."""
    net = run.scenario.network
    current = line_current_a(run)
    loading = line_loading(run)
    rated = np.isfinite(net.i_max_a)
    peak = current.max(axis=0)
    share = np.where(rated, peak / net.i_max_a, np.nan)
    order = np.argsort(-np.where(rated, share, -1.0) if rated.any() else -peak, kind="stable")
    times = run.steps["time"].map(Clock.of(run).words).tolist()
    return [
        {
            "line": f"{net.from_bus[i]} to {net.to_bus[i]}",
            "current_a": float(peak[i]),
            "rating_a": float(net.i_max_a[i]) if rated[i] else None,
            "loading": float(share[i]) if rated[i] else None,
            "hours_above": float(
                (np.nan_to_num(loading[:, i]) > 1.0).sum() * run.scenario.grid.dt_h
            ),
            "time": times[int(current[:, i].argmax())],
        }
        for i in order[:LINES_SHOWN]
    ]
