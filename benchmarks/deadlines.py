"""How long after its time limit a window is answered, and with what.

``python -m benchmarks --only deadlines`` measures all windows by the clock on the wall, which wants
a quiet machine; ``python -m benchmarks.deadlines`` some of them by the processor's, which counts
limits and answers alike in what this process alone has worked. Every window is solved twice to each
limit: ``first`` has nothing compiled, ``again`` what the first one had time for. Whatever comes is
an answer with its status, or an error with its name.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated
from unittest.mock import patch

import pandas as pd
import typer
from rich.progress import Progress, track

from benchmarks.feeders import feeder_scenario
from benchmarks.frame.store import Row, Store
from benchmarks.instances import Instance, packaged, read_instances, window_data
from benchmarks.scaling import Case, windows_of
from vppres.core.errors import LimitError, SolveError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Stopwatch
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, Status

LIMITS_S = (0.1, 1.0, 10.0)
ALLOWED_S = {33: 0.5, 1021: 2.0}
"""Seconds beyond the limit within which a window must be answered, by number of buses."""

LARGE_BUSES = 1021
NAMED = frozenset({*map(str, Status), LimitError.__name__})
"""What a window may end with: a status, or the error that says that time ran out."""

TURNS = ("first", "again")


@dataclass(frozen=True, eq=False)
class Window:
    """A window by name."""

    name: str
    site: Site
    data: WindowData


def windows(instances: Iterable[Instance], large: int) -> Iterator[Window]:
    """The benchmark's instances, and some windows of the largest feeder."""
    for instance in instances:
        yield Window(instance.name, Site.of(packaged()), window_data(instance))
    if large:
        case = Case("buses", LARGE_BUSES, LIMITS_S[-1])
        day = feeder_scenario(LARGE_BUSES)
        for number, data in enumerate(windows_of(case, day)[:large]):
            yield Window(f"{LARGE_BUSES} buses, {number}", Site.of(day), data)


def run_deadlines(
    instances: Iterable[Instance], large: int, folder: Path, bar: Progress
) -> pd.DataFrame:
    """One row for each window and limit; finished rows are kept.

    Parameters
    ----------
    instances : iterable of Instance
        Windows of the packaged scenario.
    large : int
        How many windows of the largest feeder.
    folder : Path
        Where rows are kept.
    bar : Progress
        Shows how far it is.
    """
    store = Store(folder / "rows")
    found = list(windows(instances, large))
    task = bar.add_task("deadlines", total=len(found) * len(LIMITS_S))
    rows = []
    for window in found:
        for limit_s in LIMITS_S:
            key = {"bench": "deadlines", "window": window.name, "limit_s": limit_s}
            rows.append(store.row(key, lambda w=window, s=limit_s: measure(w, s)))  # type: ignore[misc]
            bar.advance(task)
    return pd.DataFrame(rows)


def measure(window: Window, limit_s: float) -> Row:
    """A window solved twice to a limit: how each turn ended, when, and how busy the machine was."""
    solver = WindowSolver(window.site, limits=SolveLimits(time_s=limit_s))
    solver.cache = ModelCache(window.site)
    row: Row = {"buses": window.site.network.n_buses, "steps": window.data.n_steps}
    for turn in TURNS:
        row |= {f"{turn}_{name}": value for name, value in answered(solver, window.data).items()}
    return {**row, "load": os.getloadavg()[0]}


def answered(solver: WindowSolver, data: WindowData) -> Row:
    """How a window ends: seconds beyond its limit, and the processor's part of them."""
    watch = Stopwatch()
    begin_cpu_s = time.process_time()
    try:
        ending = str(solver.solve(data).status)
    except SolveError as error:
        ending = type(error).__name__
    spent_s = watch.spent_s
    late_s = max(spent_s - solver.limits.time_s, 0.0)
    share = min((time.process_time() - begin_cpu_s) / spent_s, 1.0)
    return {"ending": ending, "late_s": late_s, "late_cpu_s": share * late_s}


def by_turn(rows: pd.DataFrame) -> pd.DataFrame:
    """One row for each solve."""
    common = ["window", "buses", "limit_s", "load"]
    parts = [
        rows[common].assign(
            turn=turn,
            **{name: rows[f"{turn}_{name}"] for name in ("ending", "late_s", "late_cpu_s")},
        )
        for turn in TURNS
    ]
    return pd.concat(parts, ignore_index=True)


def deadline_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Solves by buses, limit, turn and ending: how many, and how late."""
    groups = by_turn(rows).groupby(["buses", "limit_s", "turn", "ending"])
    table = groups.agg(
        windows=("late_s", "size"),
        late_median_s=("late_s", "median"),
        late_max_s=("late_s", "max"),
        late_max_cpu_s=("late_cpu_s", "max"),
    )
    names = {
        "limit_s": "limit s",
        "late_median_s": "late, median s",
        "late_max_s": "late, largest s",
        "late_max_cpu_s": "late, largest s of processor",
    }
    return table.reset_index().rename(columns=names)


@contextmanager
def by_processor() -> Iterator[None]:
    """Let all deadlines of the block be counted in this process's time of a processor.

    The solvers' own limits stay on the wall's clock, which is never slower: they end earlier.
    """
    clock = SimpleNamespace(perf_counter=time.process_time)
    with patch("vppres.solve.deadline.time", clock):
        yield


def main(
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Every N-th instance.")] = 5,
    large: Annotated[int, typer.Option(min=0, max=6, help="Windows of 1,021 buses.")] = 2,
    limit: Annotated[list[float], typer.Option(metavar="S", help="Limits in s.")] = [*LIMITS_S],  # noqa: B006 (typer copies it)
) -> None:
    """Measure by the processor's clock, which others on the machine do not change."""
    found = list(windows(read_instances()[::every], large))
    with by_processor():
        rows = [
            {"window": window.name, "limit_s": limit_s, **measure(window, limit_s)}
            for window in track(found, "windows", transient=True)
            for limit_s in limit
        ]
    typer.echo(deadline_table(pd.DataFrame(rows)).round(3).to_string())


if __name__ == "__main__":
    typer.run(main)
