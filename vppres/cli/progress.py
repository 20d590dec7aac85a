"""The progress bar of the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from vppres.day.options import RunOptions
    from vppres.day.trajectory import Trajectory
    from vppres.scenario.scenario import Scenario


def progress_bar(quiet: bool) -> Progress:
    """A progress bar on stderr, if that is a terminal."""
    console = Console(stderr=True)
    # A parameter's name can hold a tier's, and brackets in it are no markup.
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=quiet or not console.is_terminal,
    )


def run_with_bar(day: Scenario, options: RunOptions, quiet: bool) -> Trajectory:
    """Run the day with a progress bar."""
    from vppres.day.simulate import run_day

    with progress_bar(quiet) as bar:
        task = bar.add_task(options.controller, total=day.grid.n_steps)

        def show(step: int, total: int) -> None:
            bar.update(task, completed=step, total=total)

        return run_day(day, options, progress=show)
