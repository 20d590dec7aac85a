"""Random days of the kinds that hurt, in the closed loop: ``python -m benchmarks.random_days``.

Seconds are the processor's time of one process, compiling included, so that others on the machine
change little; solvers know the clock on the wall alone, so that on a busy machine they stop early.
Days of quarter hours are cut to the 24 steps around their first outage.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from rich.progress import track

from benchmarks.deadlines import by_processor
from benchmarks.frame.store import Row, Store
from benchmarks.frame.terminal import plain_errors
from benchmarks.hard_days import KINDS, hard_day
from benchmarks.race import CERTIFY_S
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.scenario.scenario import Scenario
from vppres.solve.result import SolveLimits

STEPS = 24
BEFORE = 8
"""Steps of a cut day, and how many of them come before the outage."""
OPEN_GAP = 1e-3
"""Gap above which no step may be left."""


def run_one(kind: str, seed: int, limit_s: float = CERTIFY_S) -> Row:
    """The steps of a day: seconds, statuses, gaps and fallbacks."""
    day = hard_day(kind, seed)
    options = RunOptions(
        errors=day.errors,
        seed=seed,
        switching=day.rules,
        limits=SolveLimits(time_s=limit_s),
    )
    scenario = cut(day.scenario)
    steps = run_day(scenario, options).steps
    return {
        "traits": " ".join(sorted(day.traits)),
        "buses": scenario.network.n_buses,
        "seconds": steps["solve_s"].tolist(),
        "status": steps["status"].astype(str).tolist(),
        "gap": steps["gap"].fillna(np.nan).tolist(),
        "fallback": steps["fallback"].astype(str).tolist(),
        "stages": steps["stages"].astype(str).tolist(),
    }


def cut(scenario: Scenario) -> Scenario:
    """The steps around the first outage, or the first ones where there is none."""
    if scenario.grid.n_steps <= STEPS:
        return scenario
    out = np.flatnonzero(scenario.outage)
    first = max(int(out[0]) - BEFORE, 0) if len(out) else 0
    first = min(first, scenario.grid.n_steps - STEPS)
    return scenario.between(first, first + STEPS)


def steps_of(days: pd.DataFrame) -> pd.DataFrame:
    """One row for each step."""
    columns = ["seconds", "status", "gap", "fallback", "stages"]
    rows = days.explode(columns, ignore_index=True)
    seconds = pd.to_numeric(rows["seconds"], errors="coerce")
    return rows.assign(seconds=seconds, gap=pd.to_numeric(rows["gap"], errors="coerce"))


def summary(steps: pd.DataFrame) -> pd.DataFrame:
    """Each kind, and all: days, steps, seconds, and what is left open."""
    steps = steps.assign(day=steps["kind"] + " " + steps["seed"].astype(str))
    everything = pd.concat([steps.assign(kind="all"), steps])
    groups = everything.groupby("kind", sort=False)
    table = groups.agg(
        days=("day", "nunique"),
        steps=("seconds", "size"),
        median_s=("seconds", "median"),
        p99_s=("seconds", lambda s: s.quantile(0.99)),
        max_s=("seconds", "max"),
        largest_gap=("gap", "max"),
    )
    opened = everything.assign(open=everything["gap"] > OPEN_GAP)
    fell = everything.assign(
        fell=everything["fallback"].isin(["", "none", "None", "nan"]).eq(False)
    )
    table["open"] = opened.groupby("kind", sort=False)["open"].sum()
    table["fallbacks"] = fell.groupby("kind", sort=False)["fell"].sum()
    return table.reset_index()


def main(
    days: Annotated[int, typer.Option(min=1, metavar="N", help="Days in all.")] = 39,
    first: Annotated[int, typer.Option(metavar="SEED", help="First seed.")] = 1000,
    time_limit: Annotated[float, typer.Option(metavar="S", help="Of each step.")] = CERTIFY_S,
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the rows.")] = Path(
        "results/random_days"
    ),
) -> None:
    """Run random days, kind after kind, seed after seed."""
    with plain_errors("Nothing"), by_processor():
        store = Store(results / "rows")
        found = []
        for number in track(range(days), "days", transient=True):
            kind = KINDS[number % len(KINDS)]
            seed = first + number // len(KINDS)
            key = {"bench": "random_days", "kind": kind, "seed": seed, "limit_s": time_limit}
            row = store.row(key, lambda k=kind, s=seed: run_one(k, s, time_limit))  # type: ignore[misc]
            found.append(row)
        steps = steps_of(pd.DataFrame(found))
        results.mkdir(parents=True, exist_ok=True)
        steps.to_csv(results / "steps.csv", index=False)
    typer.echo(summary(steps).to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
