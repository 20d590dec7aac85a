"""Do answers agree with a monolith's? ``python -m benchmarks.agreement``.

Small windows of random days, each solved by the package, by ``--method monolithic`` (outer polygons
for the bound, inner ones for the answer), and once as a whole by every other solver that is
installed: those with free, size-limited licences say by how much they are faster or slower where
they take the window. Seconds are the processor's, each solver has one thread.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from rich.progress import track

from benchmarks.deadlines import by_processor
from benchmarks.frame.store import Row, Store
from benchmarks.frame.terminal import plain_errors
from benchmarks.frame.whole import monolith
from benchmarks.hard_days import KINDS, hard_window
from benchmarks.licensed import ALL_SOLVERS, LICENSED
from benchmarks.race import Runner
from benchmarks.windows import NOT_ADMITTED
from vppres.core.errors import SolveError
from vppres.solve.cache import ModelCache
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

MOST_CELLS = 150
"""Buses times steps of a small window: a monolith proves most of them in seconds."""
MOST_STEPS = 12
TOLERANCE = 1e-6
"""Share of the objective by which an answer may exceed the other's bound: rounding of both."""


@dataclass(frozen=True)
class Answer:
    """A method's answer to a window: its error where it has none, ``inf`` where nothing is said."""

    ended: str  #: status, or name of the error
    #: Objective and bound on it.
    value: float
    bound: float
    seconds: float  #: of the processor, without compiling


def small_windows(count: int, first: int) -> Iterator[Runner]:
    """So many small windows, of all kinds in turn, from a seed on."""
    found = 0
    seed = first
    while found < count:
        for kind in KINDS:
            window = hard_window(kind, seed)
            cells = window.site.network.n_buses * window.steps
            if cells <= MOST_CELLS and window.steps <= MOST_STEPS and found < count:
                found += 1
                yield Runner(f"{kind} {seed}", "random", kind, window.site, window.data)
        seed += 1


def answer(runner: Runner, method: str, limits: SolveLimits) -> Answer:
    """The answer of one of the package's methods, its problems compiled before."""
    solver = WindowSolver(runner.site, method, limits=limits)
    solver.cache = ModelCache(runner.site)
    found: WindowSolution | None = None
    ended = ""
    spent_s = 0.0
    for _ in range(2):
        begin_s = time.process_time()
        try:
            found = solver.solve(runner.data)
            ended = str(found.status)
        except SolveError as error:
            ended = type(error).__name__
        spent_s = time.process_time() - begin_s
        if spent_s > 1.0:
            break  # what compiling took makes little difference
    if found is None:
        return Answer(ended, np.nan, np.nan, spent_s)
    return Answer(ended, found.objective, found.bound, spent_s)


def agree(ours: Answer, other: Answer, limits: SolveLimits) -> bool:
    """Whether neither answer contradicts the other's bound, and ours is no worse than the gap.

    A bound without an answer is no contradiction, and neither is time that ran out.
    """
    if np.isnan(ours.value) or np.isnan(other.value):
        return ours.ended == other.ended or "LimitError" in (ours.ended, other.ended)
    slack = TOLERANCE * max(1.0, abs(ours.value))
    within = ours.value <= other.bound + slack and other.value <= ours.bound + slack
    return within and ours.value >= other.value - limits.gap_at(other.value)


def compare(runner: Runner, time_s: float) -> Row:
    """One window by all methods."""
    limits = SolveLimits(time_s=time_s)
    ours = answer(runner, "decomposed", limits)
    whole = answer(runner, "monolithic", limits)
    row: Row = {
        "buses": runner.site.network.n_buses,
        "steps": runner.data.n_steps,
        "ended": ours.ended,
        "value": ours.value,
        "bound": ours.bound,
        "seconds": ours.seconds,
        "whole_ended": whole.ended,
        "whole_value": whole.value,
        "whole_bound": whole.bound,
        "agrees": bool(agree(ours, whole, limits)),
    }
    for name in ("highs", "scip", *LICENSED):
        if ALL_SOLVERS[name].installed:
            row |= {f"{name}_{key}": value for key, value in _once(runner, name, time_s).items()}
    return row


def _once(runner: Runner, name: str, time_s: float) -> Row:
    """One solve of the whole problem, or that a licence does not admit it."""
    try:
        found = monolith(runner.site, runner.data, ALL_SOLVERS[name], time_s)
    except Exception as error:  # a licensed solver's own class, which may not be installed
        if name not in LICENSED:
            raise
        return {"s": np.nan, "status": NOT_ADMITTED, "reason": str(error)[:200]}
    if name in LICENSED and found["status"] == "numerical":
        return {"s": np.nan, "status": NOT_ADMITTED}
    return {"s": found["s"], "status": found["status"]}


def speeds(rows: pd.DataFrame) -> pd.DataFrame:
    """Each solver: windows it takes, its median, ours on the same ones, and the median ratio.

    A window that is not solved in its limit counts as infinitely slow.
    """
    table = []
    for name in ("highs", "scip", *LICENSED):
        if f"{name}_s" not in rows:
            continue
        taken = rows[rows[f"{name}_status"] != NOT_ADMITTED]
        theirs = pd.to_numeric(taken[f"{name}_s"], errors="coerce").fillna(np.inf)
        table.append(
            {
                "solver": name,
                "windows": len(taken),
                "not admitted": len(rows) - len(taken),
                "median_s": theirs.median(),
                "ours_median_s": taken["seconds"].median(),
                "ratio_median": (theirs / taken["seconds"]).median(),
                "faster than ours": int((theirs < taken["seconds"]).sum()),
            }
        )
    return pd.DataFrame(table)


def main(
    windows: Annotated[int, typer.Option(min=1, metavar="N", help="Windows.")] = 100,
    first: Annotated[int, typer.Option(metavar="SEED", help="First seed.")] = 5000,
    time_limit: Annotated[float, typer.Option(metavar="S", help="Of each solve.")] = 20.0,
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the rows.")] = Path(
        "results/agreement"
    ),
) -> None:
    """Compare answers on small random windows with those of monoliths."""
    with plain_errors("Nothing"), by_processor():
        store = Store(results / "rows")
        found = []
        for runner in track(small_windows(windows, first), "windows", windows, transient=True):
            key = {"bench": "agreement", "window": runner.name, "limit_s": time_limit}
            row = store.row(key, lambda r=runner: compare(r, time_limit))  # type: ignore[misc]
            found.append({"window": runner.name, **row})
        rows = pd.DataFrame(found)
        results.mkdir(parents=True, exist_ok=True)
        rows.to_csv(results / "windows.csv", index=False)
    typer.echo(f"{int(rows['agrees'].sum())} of {len(rows)} windows agree with the monolith.")
    shown = ["window", "buses", "steps", "ended", "value", "bound"]
    shown += ["whole_ended", "whole_value", "whole_bound"]
    if not rows["agrees"].all():
        typer.echo(rows.loc[~rows["agrees"], shown].to_string(index=False))
    proven = (rows["ended"] == "optimal").sum()
    whole = (rows["whole_ended"] == "optimal").sum()
    typer.echo(f"Certified: {proven} by the package, {whole} by the monolith.")
    typer.echo(speeds(rows).to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
