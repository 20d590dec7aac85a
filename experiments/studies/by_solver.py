"""R of the packaged day whoever solves it: ``python -m experiments.studies.by_solver``.

It writes the table of ``docs/reproduction.md``. The monolithic problem of SCIP takes minutes a day.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import typer

from benchmarks.frame.pages import markdown_table, put_into
from vppres import RunOptions, load_scenario
from vppres.day.metrics import resilience
from vppres.day.simulate import run_day
from vppres.solve.result import SolveLimits

PAGE = Path(__file__).parents[2] / "docs" / "reproduction.md"
BEGIN, END = "<!-- by solver -->", "<!-- end -->"
PATIENT = SolveLimits(time_s=900.0)
"""Time limit of a window: the answer of a slower one is the previous plan's."""

WAYS = (("decomposed", "highs"), ("monolithic", "highs"), ("monolithic", "scip"))
NAMES = {"highs": "HiGHS", "scip": "SCIP"}


def found(mode: str, horizon_h: float, method: str, solver: str) -> str:
    """R of the packaged day, to four digits."""
    options = RunOptions(
        mode=mode, horizon_h=horizon_h, method=method, solver=solver, limits=PATIENT
    )
    ratio = resilience(run_day(load_scenario("uk-heatwave-2022"), options))
    return "" if ratio is None else f"{ratio:.4f}"


def table(horizons_h: Iterable[float]) -> str:
    """A row for each horizon, a column for each mode, method and solver."""
    columns = [(mode, *way) for mode in ("paper", "physical") for way in WAYS]
    heads = [f"{mode}: {method}, {NAMES[solver]}" for mode, method, solver in columns]
    rows = []
    for horizon_h in horizons_h:
        rows.append((f"{horizon_h:g}", *(found(mode, horizon_h, *way) for mode, *way in columns)))
        typer.echo(rows[-1])
    return markdown_table(("$H$", *heads), rows)


def main(longest: int = 5) -> None:
    """Write the table into the documentation."""
    made = table(float(hours) for hours in range(longest + 1))
    put_into(PAGE, made, BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
