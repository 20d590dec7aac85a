"""Studies of many days: their options, the days of consecutive seeds, their report."""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_type_hints

import numpy as np
import typer
from matplotlib.figure import Figure
from pydantic import TypeAdapter

from benchmarks.frame.pages import save_figure, write_pages
from benchmarks.frame.terminal import Scheduler, bar_of, plain_errors, show_report
from vppres.day.metrics import versions
from vppres.io.atomic import atomic_write_text
from vppres.solve.result import SolveLimits
from vppres.studies.side_by_side import FailedJob, Where, identity, map_unordered

J = TypeVar("J")
R = TypeVar("R")
T = TypeVar("T")

STUDIES = Path("results/studies")

PATIENT = SolveLimits(time_s=3600.0)
"""No window ends for want of time, however busy the machine is."""

Days = Annotated[int, typer.Option(min=1, help="Number of days.")]
FirstSeed = Annotated[int, typer.Option(help="Seed of the first day.")]
Jobs = Annotated[int, typer.Option(help="Days at a time; -1 is one for each core.")]
Results = Annotated[Path, typer.Option(metavar="DIR", help="Folder of the report.")]


@dataclass(frozen=True)
class Span:
    """The days of a study: seed of the first one, and how many."""

    first: int
    days: int

    @property
    def seeds(self) -> range:
        """Seeds of the days."""
        return range(self.first, self.first + self.days)


@dataclass(frozen=True)
class Kept(Generic[T]):
    """Finished days of a function, a JSON file each, by all that they depend on."""

    #: Makes a dataclass, or a list of some, of a seed; its annotation says which.
    run: Callable[[int], T]
    folder: Path  #: where the files are

    def get(self, seed: int) -> T | None:
        """What the function made of a seed, None if that is not known."""
        file = self._file(seed)
        if not file.is_file():
            return None
        return self._adapter.validate_python(json.loads(file.read_text(encoding="utf-8")))

    def put(self, seed: int, outcome: T) -> None:
        """Keep what the function made of a seed."""
        self.folder.mkdir(parents=True, exist_ok=True)
        record = self._adapter.dump_python(outcome)
        # NaN stays NaN, unlike in what others read.
        atomic_write_text(self._file(seed), json.dumps(record, default=np.generic.item))

    @property
    def _adapter(self) -> TypeAdapter[T]:
        return TypeAdapter(get_type_hints(self.run)["return"])

    def _file(self, seed: int) -> Path:
        name = f"{self.run.__module__}.{self.run.__qualname__}"
        inputs = {"run": name, "seed": seed, **identity("experiments"), **identity("frame")}
        digest = sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()
        return self.folder / f"{digest}.json"


def run_seeds(
    run: Callable[[int], T], span: Span, where: Where, folder: Path
) -> tuple[list[T], list[FailedJob[int]]]:
    """What a function makes of each seed, from files where they have it.

    Parameters
    ----------
    run : callable
        Runs the day of a seed; a function of a module.
    span : Span
        The seeds.
    where : Where
        Days at a time, or the cluster that runs them.
    folder : Path
        Where finished days are kept: a study that was interrupted goes on where it stopped.

    Returns
    -------
    list
        In the order of the seeds.
    list of FailedJob
        Seeds whose process died each time that they were tried.
    """
    run = by_name(run)
    kept = Kept(run, folder)
    found = {seed: known for seed in span.seeds if (known := kept.get(seed)) is not None}
    missing = [seed for seed in span.seeds if seed not in found]
    lost = []
    with bar_of("days", span.days) as advance:
        advance(len(found))
        with closing(map_unordered(run, missing, where)) as outcomes:
            for outcome in outcomes:
                advance(1)
                if isinstance(outcome, FailedJob):
                    lost.append(outcome)
                    continue
                kept.put(outcome.job, outcome.result)
                found[outcome.job] = outcome.result
    return [found[seed] for seed in span.seeds if seed in found], lost


def report(
    stem: Path,
    title: str,
    text: str,
    outcomes: Sequence[Any],
    wall_s: float,
    figure: Figure | None = None,
) -> Path:
    """Write ``stem.md``, ``.html`` and ``.json``, beside its figure; returns the Markdown file.

    Parameters
    ----------
    stem : Path
        File without its ending.
    title, text : str
        Title and body in Markdown.
    outcomes : sequence of dataclasses
        Kept in the JSON.
    wall_s : float
        Seconds that they took.
    figure : matplotlib.figure.Figure, optional
        Saved as SVG and PNG under the same name.
    """
    if figure is not None:
        stem.parent.mkdir(parents=True, exist_ok=True)
        save_figure(figure, stem)
    record = {
        "outcomes": [asdict(outcome) for outcome in outcomes],
        "wall_s": wall_s,
        "versions": versions(),
    }
    return write_pages(stem.parent, stem.name, title, text, record)


def nothing(_: object) -> bool:
    """Of studies in which nothing can be wrong."""
    return False


@dataclass(frozen=True)
class Study(Generic[T]):
    """A study of many days: what it runs, what it writes, what must not be."""

    run: Callable[[int], T]  #: runs the day of a seed
    #: Writes the report of outcomes, of the seconds that they took, into a folder.
    write: Callable[[Sequence[T], float, Path], Path]
    wrong: Callable[[T], Any] = nothing  #: whether an outcome holds something that must not be
    width: int = 0  #: least width of the report on a terminal

    def play(self, span: Span, where: Where, results: Path) -> None:
        """Run the days, write and show the report; status 1 where something must not be."""
        begin = time.perf_counter()
        with plain_errors("Finished days"):
            outcomes, lost = run_seeds(self.run, span, where, results / "days")
        show_report(self.write(outcomes, time.perf_counter() - begin, results), self.width)
        for day in lost:
            typer.echo(f"Day {day.job} has no outcome. {day.reason} Run again to try it.", err=True)
        if lost or any(self.wrong(outcome) for outcome in outcomes):
            raise typer.Exit(1)

    def command(self, days: int, words: str) -> Callable[..., None]:
        """The study as a command line.

        Parameters
        ----------
        days : int
            Number of days if none is given.
        words : str
            What it does, for its help.
        """

        def main(
            days: Days = days,
            seed: FirstSeed = 0,
            jobs: Jobs = -1,
            results: Results = STUDIES,
            scheduler: Scheduler = None,
        ) -> None:
            self.play(Span(seed, days), Where(jobs, scheduler), results)

        main.__doc__ = words
        return main


def by_name(function: Callable[[J], R]) -> Callable[[J], R]:
    """The function under the name by which other processes import it.

    A module that is run by ``python -m`` is called ``__main__``, and others do not find it there.
    """
    main = sys.modules["__main__"]
    spec = getattr(main, "__spec__", None)
    if function.__module__ != "__main__" or spec is None:
        return function
    found: Callable[[J], R] = getattr(importlib.import_module(spec.name), function.__qualname__)
    return found
