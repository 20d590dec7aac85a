"""Many MPC days at once on all cores, each process with one thread."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

import pandas as pd
from joblib import Parallel, delayed, parallel_config
from rich.progress import Progress

from benchmarks.day import error_settings
from benchmarks.frame.store import Row, Store
from benchmarks.instances import packaged
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day

DAYS = 1000


def day_options(count: int) -> list[RunOptions]:
    """Options of MPC days at H = 5: the reproduction's errors in turn, each with new seeds."""
    settings = error_settings(count)
    # One level after the other, so that any number of days mixes them.
    by_seed = sorted((options for _, options in settings), key=lambda options: options.seed)
    return [by_seed[i % len(by_seed)] for i in range(count)]


def one_day(options: RunOptions) -> float:
    """Run a day; seconds."""
    begin = time.perf_counter()
    run_day(packaged(), options)
    return time.perf_counter() - begin


def run_throughput(folder: Path, days: int, processes: int, bar: Progress) -> Row:
    """Days per minute, compilation and start of the processes included, and apart."""
    task = bar.add_task("throughput", total=days)

    def measure() -> Row:
        begin = time.perf_counter()
        ends = []
        seconds = []
        with parallel_config("loky", inner_max_num_threads=1):
            parallel = Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
            work = (delayed(one_day)(options) for options in day_options(days))
            with closing(parallel(work)) as finished:
                for spent in finished:
                    seconds.append(spent)
                    ends.append(time.perf_counter() - begin)
                    bar.advance(task)
        return rates(ends, seconds, processes)

    return Store(folder / "rows").row(
        {"bench": "throughput", "days": days, "processes": processes}, measure
    )


def rates(ends: list[float], seconds: list[float], processes: int) -> Row:
    """Rates over the whole run, and over its days after the first of each process."""
    warm = min(processes, len(ends) - 1)
    later = (len(ends) - warm) / (ends[-1] - ends[warm - 1]) if warm else len(ends) / ends[-1]
    return {
        "wall_s": ends[-1],
        "days_per_min": 60.0 * len(ends) / ends[-1],
        "days_per_min_warm": 60.0 * later,
        "day_median_s": pd.Series(seconds).median(),
        "day_max_s": max(seconds),
    }


def throughput_table(row: Row) -> pd.DataFrame:
    """What was measured, and what 1,000 days would take at that rate."""
    start_s = row["wall_s"] - row["days"] / row["days_per_min_warm"] * 60.0
    whole_min = max(start_s, 0.0) / 60.0 + DAYS / row["days_per_min_warm"]
    return pd.DataFrame(
        [
            {
                "days measured": row["days"],
                "processes": row["processes"],
                "wall_s": row["wall_s"],
                "days per minute": row["days_per_min"],
                "days per minute, compiled": row["days_per_min_warm"],
                "min for 1,000 days (extrapolated)": whole_min,
            }
        ]
    )
