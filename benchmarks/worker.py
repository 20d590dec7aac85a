"""What it costs to solve in a process of its own: every step of a day both ways, in turn."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from rich.progress import Progress

from benchmarks.frame.store import Row, Store
from benchmarks.instances import packaged
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.physics.powerflow import ACPowerFlow
from vppres.solve.isolated import close_workers, shared_workers

HERE, THERE = False, True
"""Solved in this process, or in another."""

_CPU_OF_PROCESS = 2
"""Clock of the processor's time that a process takes, as Linux numbers it (CPUCLOCK_SCHED)."""


def run_worker(folder: Path, days: int, bar: Progress) -> Row:
    """Medians of steps and of their ratios over some days, after one that compiles."""
    task = bar.add_task("worker", total=days)

    def measure() -> Row:
        _both_ways(0)
        steps = []
        for turn in range(days):
            steps += _both_ways(turn)
            bar.advance(task)
        close_workers()
        return summary(pd.DataFrame(steps))

    return Store(folder / "rows").row({"bench": "worker", "days": days}, measure)


def _both_ways(turn: int) -> list[Row]:
    """A day twice, step by step side by side: both meet the same load of the machine."""
    options = {way: RunOptions(isolate=way) for way in (HERE, THERE)}
    days = {way: Day(packaged(), options[way]) for way in (HERE, THERE)}
    for day in days.values():
        # A power flow starts from its last solution, which is to be that of the same day.
        day.ac = ACPowerFlow(packaged().network)
    controllers = {way: make_controller(packaged(), options[way]) for way in (HERE, THERE)}
    rows = []
    for t in range(packaged().grid.n_steps):
        row: Row = {}
        # Whoever comes second finds the data in the processor's caches.
        for way in (HERE, THERE) if (t + turn) % 2 else (THERE, HERE):
            name = "there" if way else "here"
            begin_s = time.perf_counter()
            begin_cpu_s = _cpu_s()
            days[way].step(controllers[way], t)
            row[f"{name}_s"] = time.perf_counter() - begin_s
            row[f"{name}_cpu_s"] = _cpu_s() - begin_cpu_s
        row["equal"] = _equal(*(days[way].recorder.records[t] for way in (HERE, THERE)))
        rows.append(row)
    return rows


def _equal(one: StepRecord, other: StepRecord) -> bool:
    """Whether a step went the same way in all of its arrays and in its objective."""
    tables = ("customers", "pv", "batteries", "buses", "lines")
    return one.steps["objective"] == other.steps["objective"] and all(
        values.tobytes() == getattr(other, table)[name].tobytes()
        for table in tables
        for name, values in getattr(one, table).items()
    )


def _cpu_s() -> float:
    """Processor's time of this process and of those that solve for it, NaN if it is not known."""
    if sys.platform != "linux":
        return np.nan
    others = (time.clock_gettime((~pid << 3) | _CPU_OF_PROCESS) for pid in shared_workers().pids)
    return time.process_time() + sum(others)


def summary(steps: pd.DataFrame) -> Row:
    """Medians of the steps, of the ratios of each pair, and the ratio of the sums."""
    ratio = steps["there_s"] / steps["here_s"]
    cpu = steps["there_cpu_s"] / steps["here_cpu_s"]
    return {
        "steps": len(steps),
        "equal": int(steps["equal"].sum()),
        "here_median_s": float(steps["here_s"].median()),
        "there_median_s": float(steps["there_s"].median()),
        "ratio_median": float(ratio.median()),
        "ratio_of_sums": float(steps["there_s"].sum() / steps["here_s"].sum()),
        "cpu_ratio_median": float(cpu.median()),
        "cpu_ratio_of_sums": float(steps["there_cpu_s"].sum() / steps["here_cpu_s"].sum()),
    }


def worker_table(row: Row) -> pd.DataFrame:
    """What was measured."""
    return pd.DataFrame(
        [
            {
                "steps": row["steps"],
                "equal answers": row["equal"],
                "in this process, median s": row["here_median_s"],
                "in another, median s": row["there_median_s"],
                "ratio, median": row["ratio_median"],
                "ratio of sums": row["ratio_of_sums"],
                "processor's time, ratio, median": row["cpu_ratio_median"],
                "processor's time, ratio of sums": row["cpu_ratio_of_sums"],
            }
        ]
    )
