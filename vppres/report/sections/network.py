"""Voltages and line loading."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from vppres.day.metrics import line_current_a, line_loading
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock
from vppres.report.sections.base import Run
from vppres.scenario.configuration import Branches

LINES_SHOWN = 10


def network_of(run: Run) -> dict[str, Any]:
    """Voltages, loadings and the lines that came closest to their rating."""
    phased = bool(run.trajectory.scenario.phases)
    return {
        "lines": [] if phased else _top_lines(run.trajectory),
        "phases": _top_phases(run.trajectory) if phased else [],
        "figures": [
            run.figure("voltages"),
            run.figure("by_phase" if phased else "line_loadings"),
        ],
        "maps": run.figure("feeder_maps"),
        "rated": run.trajectory.scenario.network.has_ratings,
    }


def _top_phases(run: Trajectory) -> list[dict[str, Any]]:
    """Phases of lines and transformers that were the fullest of a step, by their loading."""
    steps = run.steps[run.steps["loading_max"].notna()]
    most = steps.groupby("loading_at")["loading_max"].max().sort_values(ascending=False)
    return [_fullest(run, steps[steps["loading_at"] == name]) for name in most.index[:LINES_SHOWN]]


def _fullest(run: Trajectory, rows: pd.DataFrame) -> dict[str, Any]:
    """A phase in the steps in which no other was as full."""
    loading = rows["loading_max"].to_numpy(float)
    first = int(loading.argmax())
    dt_h = run.scenario.grid.dt_h
    return {
        "name": rows["loading_at"].iloc[0],
        "loading": float(loading[first]),
        "time": Clock.of(run).words(rows["time"].iloc[first]),
        "hours_fullest": len(rows) * dt_h,
        "hours_above": float((loading > 1.0).sum() * dt_h),
    }


def _top_lines(run: Trajectory) -> list[dict[str, Any]]:
    """The most loaded lines, or those with the largest current where there are no ratings."""
    lines = Branches.of(run.scenario)
    current = line_current_a(run)
    loading = line_loading(run)
    peak = current.max(axis=0)
    rating_a = lines.rating_a[: len(peak)]
    rated = np.isfinite(rating_a)
    share = np.where(rated, peak / rating_a, np.nan)
    order = np.argsort(-np.where(rated, share, -1.0) if rated.any() else -peak, kind="stable")
    times = run.steps["time"].map(Clock.of(run).words).tolist()
    return [
        {
            "line": f"{lines.from_bus[i]} to {lines.to_bus[i]}",
            "current_a": float(peak[i]),
            "rating_a": float(rating_a[i]) if rated[i] else None,
            "loading": float(share[i]) if rated[i] else None,
            "hours_above": float(
                (np.nan_to_num(loading[:, i]) > 1.0).sum() * run.scenario.grid.dt_h
            ),
            "time": times[int(current[:, i].argmax())],
        }
        for i in order[:LINES_SHOWN]
    ]
