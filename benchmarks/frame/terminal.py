"""Terminal output of the commands of studies and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markdown import Markdown
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from vppres.core.errors import VppresError

INTERRUPTED = 130  # the shell's convention: 128 + SIGINT
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS|FILE",
        envvar="DASK_SCHEDULER_ADDRESS",
        help="Run on a Dask cluster: the address of its scheduler (tcp://...), or its file.",
    ),
]


@contextmanager
def plain_errors(kept: str) -> Iterator[None]:
    """Turn an interrupt, and errors of vppres, into a sentence on stderr and an exit status.

    Parameters
    ----------
    kept : str
        What an interrupt leaves, in words.
    """
    try:
        yield
    except KeyboardInterrupt:
        typer.echo(f"Interrupted. {kept} are kept: run again to go on.", err=True)
        raise typer.Exit(INTERRUPTED) from None
    except VppresError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(error.exit_status) from None


def show_report(markdown: Path, least_width: int = 0) -> None:
    """Print a report; tables that a narrower terminal would break have the least width."""
    console = Console(width=max(Console().width, least_width))
    console.print(Markdown(markdown.read_text(encoding="utf-8")))


@contextmanager
def bar_of(what: str, total: int, total_s: float | None = None) -> Iterator[Callable[..., None]]:
    """A progress bar on stderr, if that is a terminal.

    Parameters
    ----------
    what : str
        What is counted.
    total : int
        How many there are.
    total_s : float, optional
        Expected time of all of them in s, if they differ: bar and time left follow from it.

    Yields
    ------
    callable
        Advances the bar by a number, and by their expected time in s.
    """
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[done]}/{task.fields[count]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=total_s or total, count=total, done=0)

        def advance(count: int, expected_s: float = 0.0) -> None:
            bar.advance(task, expected_s if total_s else count)
            bar.update(task, done=bar.tasks[0].fields["done"] + count)

        yield advance
