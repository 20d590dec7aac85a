"""What the studies of many days share: their options, and the days of consecutive seeds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from joblib import Parallel, delayed, parallel_config

T = TypeVar("T")

STUDIES = Path("results/studies")

Days = Annotated[int, typer.Option(min=1, help="Number of days.")]
FirstSeed = Annotated[int, typer.Option(help="Seed of the first day.")]
Jobs = Annotated[int, typer.Option(help="Days at a time; -1 is one for each core.")]
Results = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")]


def run_seeds(run: Callable[[int], T], first: int, days: int, jobs: int) -> list[T]:
    """What a function makes of each seed, in the order of the seeds.

    Parameters
    ----------
    run : callable
        Runs the day of a seed.
    first, days : int
        Seed of the first day, and how many seeds there are.
    jobs : int
        Days at a time; -1 is one for each core.

    Examples
    --------
    >>> run_seeds(abs, -1, 3, jobs=1)
    [1, 0, 1]
    """
    # One thread each: solvers and linear algebra would only fight for the cores.
    with parallel_config("loky", inner_max_num_threads=1):
        return list(
            Parallel(n_jobs=jobs)(delayed(run)(seed) for seed in range(first, first + days))
        )
