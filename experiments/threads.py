"""Controllers in two threads: whether they answer as they do one after another.

``python -m experiments.threads --days 50``
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer

from benchmarks.pages import markdown_table, write_pages
from benchmarks.random_feeders import random_scenario
from benchmarks.terminal import show_report
from experiments.report import machine
from experiments.seeds import STUDIES, Days, FirstSeed, Results
from vppres.core.arrays import Floats
from vppres.day.metrics import versions
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.scenario.scenario import Scenario

STEPS = 10
THREADS = 2


def day_of(seed: int, variant: int) -> Scenario:
    """A day of ten steps; all variants of a seed are on one feeder, with other demand."""
    scenario = random_scenario(seed, n_steps=STEPS)
    rng = np.random.default_rng([seed, variant, 31])
    return replace(scenario, load_kw=scenario.load_kw * rng.uniform(0.3, 1.0, (STEPS, 1)))


def answers(scenario: Scenario, isolate: bool = False) -> list[Floats]:
    """All set-points of a day whose plant does what it is told, one array a step.

    Where windows are solved in this very process, controllers of a feeder share their problems.
    """
    controller = Controller.of(scenario, RunOptions(horizon_h=scenario.grid.dt_h, isolate=isolate))
    soc = dict(zip(scenario.batteries.id, scenario.batteries.soc_initial, strict=True))
    found = []
    for moment in controller.times:
        done = controller.step(Measurement(moment, soc))
        soc = dict(done.batteries["soc_end"])
        found.append(
            np.concatenate(
                [
                    done.customers["served"].to_numpy(float),
                    done.batteries[["p_kw", "q_kvar", "soc_end"]].to_numpy(float).ravel(),
                    done.pv[["p_kw", "curtailed_kw", "q_kvar"]].to_numpy(float).ravel(),
                    done.buses["v_ac_pu"].to_numpy(float),
                    [done.import_kw],
                ]
            )
        )
    return found


def differing(seeds: Sequence[int]) -> tuple[int, int, float, float]:
    """Steps, those whose answers differ in two threads in any bit, and the wall times of both in s.

    Both threads work on the same feeders at the same time, with other demand.
    """
    days = [day_of(seed, variant) for seed in seeds for variant in range(THREADS)]
    begin = time.perf_counter()
    one_by_one = [answers(day) for day in days]
    middle = time.perf_counter()
    with ThreadPoolExecutor(THREADS) as pool:
        together = list(pool.map(answers, days))
    end = time.perf_counter()
    pairs = [
        pair for a, b in zip(one_by_one, together, strict=True) for pair in zip(a, b, strict=True)
    ]
    wrong = sum(not np.array_equal(a, b) for a, b in pairs)
    return len(pairs), wrong, middle - begin, end - middle


def main(
    days: Days = 50,
    seed: FirstSeed = 0,
    results: Results = STUDIES,
) -> None:
    """Compare the answers of two threads with those of one; 20 steps for each seed."""
    steps, wrong, alone_s, together_s = differing(range(seed, seed + days))
    text = markdown_table(
        ("", ""),
        [
            ("steps", steps),
            ("steps whose answer differs in two threads", wrong),
            ("wall time one after another (s)", f"{alone_s:.0f}"),
            ("wall time in two threads (s)", f"{together_s:.0f}"),
        ],
    )
    record = {
        "steps": steps,
        "wrong": wrong,
        "alone_s": alone_s,
        "together_s": together_s,
        "versions": versions(),
    }
    page: Path = write_pages(results, "threads", "Two threads", f"{text}\n\n{machine()}.", record)
    show_report(page)
    if wrong:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
