"""Cases that are tried one after another, each kept as it ends, and their table on a page."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import typer
from pydantic import TypeAdapter

from benchmarks.frame.pages import markdown_table, put_table, write_pages
from vppres.io.atomic import atomic_write_text

Page = Annotated[Path | None, typer.Option(help="Page whose table is written anew.")]
Kept = Annotated[Path, typer.Option(help="Folder of the tables; what is there is not tried again.")]
Only = Annotated[str, typer.Option(help="Pattern of the names to try.")]


class Case(Protocol):
    """A case with a name."""

    @property
    def label(self) -> str:
        """Its name, that of a row and of a file."""


C = TypeVar("C", bound=Case)
T = TypeVar("T")


def tried(
    cases: Iterable[C],
    attempt: Callable[[C], T],
    kind: type[T],
    shown: Callable[[T], Iterable[str]],
    kept: Path,
    only: str = "",
) -> list[T]:
    """Outcomes of cases, from files where a former run kept them.

    Parameters
    ----------
    cases : iterable
        The cases.
    attempt : callable
        Makes the outcome of a case.
    kind : type
        The outcome's dataclass.
    shown : callable
        Cells that the terminal shows of a new outcome.
    kept : Path
        Folder of the outcomes, a file each.
    only : str
        Pattern of the names that are tried.
    """
    kept.mkdir(parents=True, exist_ok=True)
    adapter = TypeAdapter(kind)
    outcomes = []
    for case in cases:
        if not re.search(only, case.label):
            continue
        file = kept / f"{re.sub(r'[^A-Za-z0-9.-]+', '-', case.label)}.json"
        if file.is_file():
            outcomes.append(adapter.validate_json(file.read_text("utf-8")))
            continue
        outcomes.append(attempt(case))
        atomic_write_text(file, adapter.dump_json(outcomes[-1], indent=2).decode() + "\n")
        typer.echo(" | ".join(shown(outcomes[-1])))
    return outcomes


def write_table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    outcomes: Sequence[Any],
    stem: Path,
    title: str,
    page: Path | None,
    marks: tuple[str, str],
) -> None:
    """Write the table as a report of its own, and between two marks of a page if one is given."""
    text = markdown_table(head, rows)
    record = {"outcomes": [asdict(outcome) for outcome in outcomes]}
    write_pages(stem.parent, stem.name, title, text, record)
    if page is not None:
        put_table(page, text, *marks)
