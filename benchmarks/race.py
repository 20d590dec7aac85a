"""Is any window slower than the better monolith? Measured as cheaply as the question allows.

All windows, those of ``instances.csv`` and of ``hard.csv``, in the processor's time of one process,
so that others on the machine change little. A window that takes ``t`` seconds is slower where a
monolith is certified in less than ``(t - HEAD_START_S) / SLOWER``: no monolith runs longer, and
none at all beside a window that takes no more than the head start.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.progress import Progress

from benchmarks.deadlines import by_processor
from benchmarks.frame.store import Row, Store
from benchmarks.frame.whole import BUSY, monolith
from benchmarks.hard import HardInstance, read_hard
from benchmarks.instances import Instance, packaged, read_instances, window_data
from benchmarks.licensed import ALL_SOLVERS
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.report.plots.drawing import BLUE, GREEN, ORANGE, RULE_COLOUR
from vppres.solve.cache import ModelCache
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

MONOLITHS = ("highs", "scip")
SLOWER = 2.0
"""Factor by which a window may be slower than the better monolith."""
HEAD_START_S = 0.5
"""Seconds by which it may be slower besides."""
CERTIFY_S = 10.0
"""Seconds in which a window is to be certified."""


@dataclass(frozen=True, eq=False)
class Runner:
    """A window by name and group, with its reason where it has one."""

    name: str
    group: str
    kind: str
    site: Site
    data: WindowData


def runners(every: int = 1) -> Iterator[Runner]:
    """Every N-th window of both tables."""
    instances: list[Instance | HardInstance] = [*read_instances(), *read_hard()]
    for instance in instances[::every]:
        if isinstance(instance, HardInstance):
            window = instance.window
            yield Runner(instance.name, instance.group, instance.kind, window.site, window.data)
        else:
            site = Site.of(packaged())
            yield Runner(instance.name, instance.group, "", site, window_data(instance))


def race(runner: Runner, busy: float = BUSY) -> Row:
    """The package's answer, and the monoliths' as long as they can still win."""
    row = ours(runner, busy)
    limit_s = (float(row["seconds"]) - HEAD_START_S) / SLOWER
    for solver in MONOLITHS if limit_s > 0.0 else ():
        row |= {
            f"{solver}_{key}": value
            for key, value in monolith(
                runner.site, runner.data, ALL_SOLVERS[solver], limit_s, busy
            ).items()
        }
    return row


def ours(runner: Runner, busy: float = BUSY) -> Row:
    """The package's answer, with its problems compiled before where that may decide."""
    solver = WindowSolver(runner.site, limits=SolveLimits(time_s=busy * CERTIFY_S))
    solver.cache = ModelCache(runner.site)
    row: Row = {
        "group": runner.group,
        "kind": runner.kind,
        "buses": runner.site.network.n_buses,
        "steps": runner.data.n_steps,
    }
    for name in ("first_s", "seconds"):
        begin_s = time.process_time()
        try:
            answer = solver.solve(runner.data)
        except SolveError as error:
            row["status"] = type(error).__name__
        else:
            row |= {
                "status": str(answer.status),
                "value": answer.terms.upper_levels(runner.site.weights),
                "bound": answer.bound,
                "gap": answer.gap,
                "gap_abs": answer.gap_abs,
                "stages": " ".join(answer.stages),
            }
        row[name] = time.process_time() - begin_s
        row["seconds"] = row[name]
        if not HEAD_START_S < row[name] < CERTIFY_S / 4.0:
            break  # what compiling took makes no difference
    return row


def with_verdict(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows with the better monolith's seconds, and whether it is faster than is allowed."""
    names = [f"{solver}_s" for solver in MONOLITHS]
    times = rows.reindex(columns=names).apply(pd.to_numeric, errors="coerce")
    best_s = times.fillna(np.inf).min(axis=1)
    allowed_s = SLOWER * best_s + HEAD_START_S
    certified = (rows["status"] == "optimal") & (rows["seconds"] <= CERTIFY_S)
    return rows.assign(monolith_s=best_s, slower=rows["seconds"] > allowed_s, certified=certified)


def run_race(every: int, busy: float, folder: Path, bar: Progress) -> pd.DataFrame:
    """One row for every N-th window, with its verdict; finished rows are kept.

    Solvers get ``busy`` times their seconds on the clock on the wall: 1 on a quiet machine.
    """
    store = Store(folder / "rows")
    found = list(runners(every))
    task = bar.add_task("race", total=len(found))
    rows = []
    with by_processor():
        for runner in found:
            key = {"bench": "race", "window": runner.name, "busy": busy}
            row = store.row(key, lambda r=runner: race(r, busy))  # type: ignore[misc]
            rows.append({"window": runner.name, **row})
            bar.advance(task)
    return with_verdict(pd.DataFrame(rows))


def draw_certified(rows: pd.DataFrame) -> Figure:
    """Share of each group's windows that is certified within a time."""
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    ax = figure.subplots()
    for group, colour in zip(("ordinary", "stressed", "hard"), (BLUE, ORANGE, GREEN), strict=True):
        part = rows[rows["group"] == group]
        seconds = np.sort(part["seconds"][part["certified"]].to_numpy(float))
        share = np.arange(1, len(seconds) + 1) / max(len(part), 1)
        ax.step(seconds, share, where="post", color=colour, label=f"{group} ({len(part)})")
    ax.set_xscale("log")
    ax.set_ylim(-0.02, 1.02)
    ax.set_xlabel("Processor time, s")
    ax.set_ylabel("Share of windows certified")
    ax.grid(True, color=RULE_COLOUR, linewidth=0.5)
    ax.legend(frameon=False, loc="lower right")
    return figure


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Windows of each group and kind: how many are certified, how long, how many slower."""
    rows = rows.assign(kind=rows["kind"].replace("", "all"))
    hard = rows[rows["group"] == "hard"].assign(kind="all")
    groups = pd.concat([hard, rows]).groupby(["group", "kind"], sort=False)
    return groups.agg(
        windows=("window", "size"),
        certified=("certified", "sum"),
        median_s=("seconds", "median"),
        max_s=("seconds", "max"),
        slower=("slower", "sum"),
        worst_gap=("gap", "max"),
    ).reset_index()
