"""Controllers in two threads: whether they answer as they do one after another."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from benchmarks.frame.random_feeders import random_scenario
from vppres.core.arrays import Floats
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


def differing(seeds: Sequence[int]) -> tuple[int, int]:
    """Steps, and those whose answers differ in two threads in any bit.

    Both threads work on the same feeders at the same time, with other demand.
    """
    days = [day_of(seed, variant) for seed in seeds for variant in range(THREADS)]
    one_by_one = [answers(day) for day in days]
    with ThreadPoolExecutor(THREADS) as pool:
        together = list(pool.map(answers, days))
    pairs = [
        pair for a, b in zip(one_by_one, together, strict=True) for pair in zip(a, b, strict=True)
    ]
    wrong = sum(not np.array_equal(a, b) for a, b in pairs)
    return len(pairs), wrong
