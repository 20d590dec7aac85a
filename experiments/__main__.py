"""The command line: ``python -m experiments``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.frame.terminal import Scheduler, plain_errors, show_report
from experiments.catalogue import ALL, EXPERIMENTS
from experiments.config import read_config
from experiments.report import HTML, MARKDOWN, Effort, write_report
from experiments.runner import processes_for, run_jobs
from vppres.core.errors import InputError, Problem

TABLE_WIDTH = 110  # narrower, the table of R1 to R24 is unreadable


def reproduce(
    names: list[str], folder: Path, quick: bool, processes: int, scheduler: str | None = None
) -> Path:
    """Run experiments and write their report.

    Parameters
    ----------
    names : list of str
        Experiments; none means all of the paper.
    folder : Path
        Folder of the report, the figures and the cache.
    quick : bool
        Whether to run fewer levels and seeds.
    processes : int
        How many days run at a time; -1 is one for each core.
    scheduler : str, optional
        Of the Dask cluster that runs them, in place of this machine.

    Returns
    -------
    Path
        The report as Markdown.

    Raises
    ------
    InputError
        If an experiment is unknown.
    """
    unknown = [name for name in names if name not in ALL]
    if unknown:
        raise InputError(
            Problem(
                "experiments",
                "is not known",
                f"Use one of: {', '.join(ALL)}.",
                field="only",
                value=unknown[0],
            )
        )
    begin = time.perf_counter()
    configs = {name: read_config(name, quick) for name in names or EXPERIMENTS}
    jobs = [job for name, config in configs.items() for job in ALL[name].jobs(config)]
    results, computed = run_jobs(jobs, folder / "cache", processes, scheduler)
    solve_s = sum(day.summary["solve_s"]["total"] for day in results.values())
    effort = Effort(
        len(results), computed, time.perf_counter() - begin, solve_s, processes_for(processes)
    )
    write_report(configs, results, effort, folder)
    return folder / MARKDOWN


def main(
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Run this experiment alone; may be repeated."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer levels and seeds.")] = False,
    jobs: Annotated[
        int, typer.Option(metavar="N", help="Days that run at a time; -1 is one for each core.")
    ] = -1,
    results: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of report, figures and cache.")
    ] = Path("results"),
    scheduler: Scheduler = None,
) -> None:
    """Reproduce the paper's figures and tables, or run further experiments by name."""
    with plain_errors("Days that were finished"):
        report = reproduce(only or [], results, quick, jobs, scheduler)
    show_report(report, TABLE_WIDTH)
    typer.echo(f"Written to {results / HTML}")


if __name__ == "__main__":
    typer.run(main)
