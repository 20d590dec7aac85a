"""The command line: ``python -m benchmarks``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from joblib import cpu_count
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from benchmarks import findings
from benchmarks.day import run_days
from benchmarks.deadlines import run_deadlines
from benchmarks.frame.terminal import plain_errors, show_report
from benchmarks.frame.whole import BUSY
from benchmarks.instances import Instance, read_instances
from benchmarks.race import run_race
from benchmarks.report import Bar, Section, bar_table, publish, write_report
from benchmarks.scaling import QUICK_SIZES, SIZES, run_scaling
from benchmarks.throughput import run_throughput
from benchmarks.windows import Limits, run_windows
from benchmarks.worker import run_worker
from vppres.core.errors import InputError, Problem

DOCUMENT = Path(__file__).parents[1] / "docs" / "benchmarks.md"
TABLE_WIDTH = 140
QUICK_EVERY = 9
RACE_QUICK_EVERY = 30


@dataclass(frozen=True)
class Plan:
    """How much is run, where to, and in how many processes."""

    folder: Path
    quick: bool
    time_s: float
    processes: int
    busy: float = BUSY

    def instances(self) -> list[Instance]:
        """All instances, or every ninth of at most six steps."""
        found = read_instances()
        return [i for i in found if i.steps <= 6][::QUICK_EVERY] if self.quick else found

    def save(self, name: str, table: pd.DataFrame) -> None:
        """A table as Parquet and CSV."""
        self.folder.mkdir(parents=True, exist_ok=True)
        plain = table.map(lambda v: str(v) if isinstance(v, (dict, list)) else v)
        plain.to_csv(self.folder / f"{name}.csv", index=False)
        plain.to_parquet(self.folder / f"{name}.parquet", index=False)


Part = Callable[[Plan, Progress], tuple[Section, list[Bar]]]


def windows(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Every method and solver on every instance."""
    rows = run_windows(plan.instances(), Limits(plan.time_s), plan.folder, plan.processes, bar)
    plan.save("windows", rows)
    return findings.window_section(rows), findings.window_bars(rows)


def race(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Every window of both tables against the monoliths, as long as they can win."""
    rows = run_race(RACE_QUICK_EVERY if plan.quick else 1, plan.busy, plan.folder, bar)
    plan.save("race", rows)
    return findings.race_section(rows), findings.race_bars(rows)


def day(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Days in the closed loop."""
    tables = run_days(plan.folder, 1 if plan.quick else 3, plan.quick, bar)
    for name, table in tables.items():
        plan.save(f"day_{name}", table)
    return findings.day_section(tables), findings.day_bars(tables)


def scaling(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Cost against size."""
    sizes = QUICK_SIZES if plan.quick else SIZES
    rows = run_scaling(plan.folder, sizes, plan.time_s, plan.processes, bar)
    plan.save("scaling", rows)
    return findings.scaling_section(rows), findings.scaling_bars(rows)


def throughput(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Many days at once."""
    row = run_throughput(plan.folder, 8 if plan.quick else 60, plan.processes, bar)
    plan.save("throughput", pd.DataFrame([row]))
    return findings.throughput_section(row), findings.throughput_bars(row)


def worker(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """Solving in a process of its own."""
    row = run_worker(plan.folder, 1 if plan.quick else 5, bar)
    plan.save("worker", pd.DataFrame([row]))
    return findings.worker_section(row), findings.worker_bars(row)


def deadlines(plan: Plan, bar: Progress) -> tuple[Section, list[Bar]]:
    """How late answers are."""
    rows = run_deadlines(plan.instances(), 0 if plan.quick else 6, plan.folder, bar)
    plan.save("deadlines", rows)
    return findings.deadline_section(rows), findings.deadline_bars(rows)


PARTS: dict[str, Part] = {
    "windows": windows,
    "race": race,
    "day": day,
    "scaling": scaling,
    "throughput": throughput,
    "worker": worker,
    "deadlines": deadlines,
}


def run(names: list[str], plan: Plan) -> tuple[list[Section], str]:
    """Run parts and write their report.

    Returns
    -------
    list of Section, str
        The report's sections, and what the run took.

    Raises
    ------
    InputError
        If a part is unknown.
    """
    unknown = [name for name in names if name not in PARTS]
    if unknown:
        raise InputError(
            Problem(
                "benchmarks",
                "is not known",
                f"Use one of: {', '.join(PARTS)}.",
                field="only",
                value=unknown[0],
            )
        )
    begin = time.perf_counter()
    sections = []
    bars = []
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        for name in names or PARTS:
            section, found = PARTS[name](plan, bar)
            sections.append(section)
            bars += found
    summary = Section("What must be shown", "Each bar with the measured value.", (bar_table(bars),))
    minutes = (time.perf_counter() - begin) / 60.0
    effort = (
        f"A {'quick' if plan.quick else 'full'} run of {minutes:.1f} min on {cpu_count()} "
        f"cores, time limit {plan.time_s:g} s."
    )
    sections.insert(0, summary)
    write_report(sections, plan.folder, effort)
    return sections, effort


def main(
    only: Annotated[
        list[str] | None, typer.Option(metavar="PART", help="Run this part alone; may be repeated.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few instances, sizes and days.")] = False,
    time_limit: Annotated[
        float | None, typer.Option(metavar="S", help="Time limit of a solve; 60 s, quick 5 s.")
    ] = None,
    jobs: Annotated[
        int,
        typer.Option(
            metavar="N", help="Processes of windows, scaling, throughput; -1 is one for each core."
        ),
    ] = -1,
    busy: Annotated[
        float,
        typer.Option(
            min=1.0, help="Times that solvers of the race get on the wall; 1 on a quiet machine."
        ),
    ] = BUSY,
    results: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder of report, tables and finished rows.")
    ] = Path("results/bench"),
    to_docs: Annotated[
        bool, typer.Option("--publish", help="Put the tables into docs/benchmarks.md.")
    ] = False,
) -> None:
    """Measure the solving methods."""
    seconds = time_limit or (5.0 if quick else 60.0)
    plan = Plan(results, quick, seconds, int(cpu_count()) if jobs == -1 else jobs, busy)
    with plain_errors("Finished rows"):
        sections, effort = run(only or [], plan)
        if to_docs:
            publish(sections, DOCUMENT, effort)
    show_report(results / "report.md", TABLE_WIDTH)
    typer.echo(f"Written to {results / 'report.html'}")


if __name__ == "__main__":
    typer.run(main)
