"""A day in the closed loop: total, steps, first and later runs, memory."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, ParamSpec

import numpy as np
import pandas as pd
from rich.progress import Progress

from benchmarks.clock import in_fresh_process, peak_memory_mb, watched
from benchmarks.frame.store import Row, Store
from benchmarks.instances import packaged
from vppres.contract.forecast import ForecastErrors
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.day.trajectory import Trajectory

GROWTHS = (0.01, 0.02, 0.03)
"""Growth of the relative standard deviation of random errors, per hour ahead."""
BIASES = (-0.2, -0.1, 0.1, 0.2)
ERRORS: dict[str, tuple[float, ...]] = {
    "load_alpha_per_h": GROWTHS,
    "load_bias": BIASES,
    "pv_alpha_per_h": GROWTHS,
    "pv_bias": BIASES,
}
"""Levels of the paper's forecast errors by field, as in the reproduction."""
QUICK = {GROWTHS: (0.02,), BIASES: (-0.1, 0.1)}
"""What stands for all levels in a quick run."""
RANDOM_DAYS = {False: 20, True: 2}
"""Most days of a random error, of a usual run and of a quick one; a bias has nothing to draw."""
LATER_RUNS = 3
P = ParamSpec("P")


def error_settings(seeds: int, quick: bool = False) -> list[tuple[str, RunOptions]]:
    """Names and options of the reproduction's forecast errors, ideal days left out.

    Parameters
    ----------
    seeds : int
        Days for each level of random error; a bias alone has nothing to draw.
    quick : bool
        Whether the reproduction's quick levels are meant.
    """
    found = []
    for field, levels in ERRORS.items():
        days = min(seeds, RANDOM_DAYS[quick] if levels is GROWTHS else 1)
        for level in QUICK[levels] if quick else levels:
            errors = ForecastErrors(**{field: level})
            found += [
                (f"{field} {level:g}", RunOptions(errors=errors, seed=seed)) for seed in range(days)
            ]
    return found


def timed_day(options: RunOptions) -> tuple[Row, Trajectory]:
    """Run a day and say what it took; a step is everything from observation to record."""
    ends = [time.perf_counter()]
    with watched() as clock:
        trajectory = run_day(
            packaged(), options, lambda done, total: ends.append(time.perf_counter())
        )
    steps_s = np.diff(ends)
    total_s = ends[-1] - ends[0]
    return {
        "total_s": total_s,
        "step_median_s": float(np.median(steps_s)),
        "step_p95_s": float(np.quantile(steps_s, 0.95)),
        "step_max_s": float(steps_s.max()),
        "outside_share": 1.0 - clock.library_s / total_s,
        "plan_s": float(trajectory.steps["solve_s"].max()),
        "gap_max": float(trajectory.steps["gap"].max()),
        "steps_s": steps_s.tolist(),
        "stages_s": dict(clock.stages_s),
        "compiled": _compiled(trajectory).tolist(),
    }, trajectory


def _compiled(trajectory: Trajectory) -> np.ndarray:
    """Whether each step compiled a problem."""
    counts = trajectory.steps["compilations"].to_numpy(dtype=float)
    return np.diff(counts, prepend=0.0) > 0


def ideal_runs(controller: str) -> list[Row]:
    """First run, which compiles, and later runs of the ideal day in this process."""
    rows = []
    for run in range(1 + LATER_RUNS):
        row, _ = timed_day(RunOptions(controller=controller))
        rows.append({**row, "run": "first" if run == 0 else "later", "memory_mb": peak_memory_mb()})
    return rows


def error_days(seeds: int, quick: bool) -> list[Row]:
    """All error settings one after the other, problems compiled by an ideal day before."""
    timed_day(RunOptions())
    return [
        {**timed_day(options)[0], "setting": name, "seed": options.seed}
        for name, options in error_settings(seeds, quick)
    ]


def run_days(folder: Path, seeds: int, quick: bool, bar: Progress) -> dict[str, pd.DataFrame]:
    """Tables ``ideal``, ``settings`` and ``steps`` (one row for each step of the settings)."""
    task = bar.add_task("days", total=3)
    store = Store(folder / "rows")
    ideal = []
    for controller in ("mpc", "full-horizon"):
        found = store.row(
            {"bench": "ideal", "controller": controller},
            partial(_in_column, "runs", ideal_runs, controller),
        )
        ideal += [{"controller": controller, **row} for row in found["runs"]]
        bar.advance(task)
    found = store.row(
        {"bench": "errors", "seeds": seeds, "quick": quick},
        partial(_in_column, "days", error_days, seeds, quick),
    )
    bar.advance(task)
    settings = pd.DataFrame(found["days"])
    steps = settings[["setting", "seed", "steps_s", "compiled"]].explode(["steps_s", "compiled"])
    steps = steps.rename(columns={"steps_s": "step_s"}).astype({"step_s": float, "compiled": bool})
    return {
        "ideal": pd.DataFrame(ideal).drop(columns=["steps_s", "compiled"]),
        "settings": settings.drop(columns=["steps_s", "compiled"]),
        "steps": steps,
    }


def _in_column(
    column: str, work: Callable[P, list[Row]], *args: P.args, **options: P.kwargs
) -> Row:
    """The rows of some work in a process of its own, as one entry of a row."""
    return {column: in_fresh_process(work, *args, **options)}


def day_table(ideal: pd.DataFrame) -> pd.DataFrame:
    """First run and median of the later runs of each controller."""
    numbers = ["total_s", "plan_s", "step_p95_s", "step_max_s", "outside_share", "memory_mb"]
    return ideal.groupby(["controller", "run"], sort=False)[numbers].median().reset_index()


def step_table(steps: pd.DataFrame) -> pd.DataFrame:
    """Steps of all error settings, with and without those that compiled a problem."""
    return pd.DataFrame(
        [
            _spread(name, part["step_s"])
            for name, part in (
                ("all steps", steps),
                ("steps without compilation", steps[~steps["compiled"]]),
            )
        ]
    )


def _spread(name: str, seconds: pd.Series[Any]) -> dict[str, Any]:
    return {
        "steps": name,
        "count": len(seconds),
        "median_s": seconds.median(),
        "p95_s": seconds.quantile(0.95),
        "max_s": seconds.max(),
    }


def stage_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Seconds and share of each stage over all rows with ``stages_s``."""
    total = pd.DataFrame(list(rows["stages_s"])).sum().sort_values(ascending=False)
    total = total.groupby(total.index.str.partition(":").get_level_values(0)).sum()
    total = total.sort_values(ascending=False)
    return pd.DataFrame(
        {
            "stage": total.index,
            "seconds": total.to_numpy(),
            "share": (total / total.sum()).to_numpy(),
        }
    )
