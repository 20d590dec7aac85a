"""How far answers come after their time limit: ``python -m benchmarks.deadlines``.

Every window is solved twice to each limit: ``cold`` may compile, ``late`` finds its problems
compiled. What comes is an answer with its status or an error with its name.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import pandas as pd
import typer
from rich.progress import track

from benchmarks.feeders import feeder_scenario
from benchmarks.instances import packaged, read_instances, window_data
from benchmarks.scaling import Case, windows_of
from experiments.terminal import plain_errors
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.deadline import Stopwatch
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

LIMITS_S = (0.1, 1.0, 10.0)
LARGE_BUSES = 1021


def windows(every: int, large: bool) -> Iterator[tuple[Site, WindowData]]:
    """Every so many instances of the benchmark, and windows of the largest feeder."""
    for instance in read_instances()[::every]:
        yield Site.of(packaged()), window_data(instance)
    if large:
        case = Case("buses", LARGE_BUSES, LIMITS_S[-1])
        day = feeder_scenario(LARGE_BUSES)
        for data in windows_of(case, day)[:2]:
            yield Site.of(day), data


def measure(site: Site, data: WindowData, time_s: float) -> dict[str, object]:
    """How long after its limit a window is answered, and with what."""
    cold_s, _ = late(site, data, time_s)
    late_s, ending = late(site, data, time_s)
    return {
        "buses": site.network.n_buses,
        "steps": data.n_steps,
        "limit_s": time_s,
        "ending": ending,
        "cold_s": cold_s,
        "late_s": late_s,
    }


def late(site: Site, data: WindowData, time_s: float) -> tuple[float, str]:
    """Seconds beyond the limit, and how the window ended."""
    solver = WindowSolver(site, limits=SolveLimits(time_s=time_s))
    watch = Stopwatch()
    try:
        ending = str(solver.solve(data).status)
    except SolveError as error:
        ending = type(error).__name__
    return max(watch.spent_s - time_s, 0.0), ending


def main(
    every: Annotated[int, typer.Option(metavar="N", help="Every N-th instance.")] = 1,
    limits: Annotated[
        list[float] | None,
        typer.Option("--limit", metavar="S", help="Time limit; may be repeated."),
    ] = None,
    large: Annotated[bool, typer.Option(help="Windows of 1,021 buses too.")] = True,
) -> None:
    """Measure how far answers come after their time limit, in this process."""
    rows = []
    with plain_errors("Nothing"):
        for site, data in track(list(windows(every, large)), "windows", transient=True):
            rows += [measure(site, data, time_s) for time_s in limits or LIMITS_S]
    found = pd.DataFrame(rows)
    table = found.groupby(["buses", "limit_s", "ending"]).agg(
        count=("late_s", "size"),
        late_median_s=("late_s", "median"),
        late_max_s=("late_s", "max"),
        cold_max_s=("cold_s", "max"),
    )
    typer.echo(table.round(3).to_string())


if __name__ == "__main__":
    typer.run(main)
