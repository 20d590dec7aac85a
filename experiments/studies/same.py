"""Whether two checkouts compute the same: ``python -m experiments.studies.same ONE OTHER``.

Run the same command in two checkouts, then lay their folders side by side: a run folder each, a
results folder of ``make reproduce`` each, or golden sets of ``python -m tests.support.golden``.
Every number must be equal to the last bit; what only tells how long something took, or which
version ran, is left out.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from benchmarks.frame.terminal import plain_errors
from vppres.core.errors import InputError, Problem

NOT_COMPARED = {
    "options",
    "solve_s",
    "solver_s",
    "versions",
    "input_digest",
    "digest",
    "stages",
    "compilations",
}
"""Names of what was asked, of what differs between two runs of the same code, or of effort."""
MOST_SHOWN = 20
CACHE = "cache"
SUMMARY = "summary.json"


def same_run(one: Path, other: Path) -> Iterator[str]:
    """What differs between two run folders, a line each."""
    names = {file.name for folder in (one, other) for file in folder.glob("*.parquet")}
    for name in sorted(names):
        if not ((one / name).exists() and (other / name).exists()):
            yield f"{name}: is in one folder only"
            continue
        yield from _tables(name, pd.read_parquet(one / name), pd.read_parquet(other / name))
    summaries = [folder / SUMMARY for folder in (one, other)]
    if any(file.exists() for file in summaries):
        yield from _values(
            SUMMARY, *(_plain(json.loads(file.read_text(encoding="utf-8"))) for file in summaries)
        )


def _runs(folder: Path) -> set[str]:
    """Names of the folders of tables in a folder."""
    return {file.parent.name for file in folder.glob("*/*.parquet")}


def same_reproduction(one: Path, other: Path) -> Iterator[str]:
    """What differs between the simulated days of two results folders, a line each.

    The days carry no name that two checkouts share, since the digest of their sources is part of
    it: they are compared as two collections.
    """
    days = [_days(one), _days(other)]
    known = set.intersection(*({*day["summary"]} for folder in days for day in folder))
    left, right = (Counter(_text(day, known) for day in folder) for folder in days)
    alike = sum((left & right).values())
    if left != right:
        yield (f"{CACHE}: {alike} of {sum(left.values())} and {sum(right.values())} days are equal")
        yield from (f"{CACHE}: only in the first: {_headline(day)}" for day in left - right)
        yield from (f"{CACHE}: only in the second: {_headline(day)}" for day in right - left)


def _days(folder: Path) -> list[dict[str, Any]]:
    """The simulated days without what tells of effort alone."""
    files = sorted((folder / CACHE).glob("*.json"))
    return [_plain(json.loads(file.read_text(encoding="utf-8"))) for file in files]


def _text(day: Mapping[str, Any], known: set[str]) -> str:
    """A day as text, with the figures that every day of both folders has."""
    summary = {name: value for name, value in day["summary"].items() if name in known}
    return json.dumps({**day, "summary": summary}, sort_keys=True)


def _headline(day: str) -> str:
    """What tells a day from others."""
    summary = json.loads(day)["summary"]
    return ", ".join(
        f"{name} {summary[name]}"
        for name in ("controller", "horizon_h", "seed", "resilience", "cost_gbp", "import_kwh")
    )


def _plain(record: Any) -> Any:
    """A record without what tells of effort alone."""
    if isinstance(record, Mapping):
        return {name: _plain(item) for name, item in record.items() if name not in NOT_COMPARED}
    return record


def _tables(name: str, one: pd.DataFrame, other: pd.DataFrame) -> Iterator[str]:
    """Columns in which two tables differ."""
    if len(one) != len(other):
        yield f"{name}: {len(one)} and {len(other)} rows"
        return
    columns = sorted({str(column) for column in [*one, *other]} - NOT_COMPARED)
    for column in columns:
        if column not in one or column not in other:
            yield f"{name}, {column}: is in one folder only"
        elif not one[column].equals(other[column]):
            both_empty = one[column].isna() & other[column].isna()
            changed = ~((one[column] == other[column]) | both_empty)
            row = int(changed.to_numpy().argmax())
            yield (
                f"{name}, {column}: {int(changed.sum())} of {len(one)} rows, the first in row "
                f"{row}: {one[column].iloc[row]} and {other[column].iloc[row]}"
            )


def _values(name: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[str]:
    """Entries in which two records differ."""
    for key in sorted(one.keys() | other.keys()):
        if one.get(key) != other.get(key):
            yield f"{name}, {key}: {one.get(key)} and {other.get(key)}"


def main(
    one: Annotated[Path, typer.Argument(metavar="ONE", help="Folder of one checkout.")],
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Folder of the other.")],
) -> None:
    """Compare what two checkouts computed; the status is 1 if anything differs."""
    with plain_errors("Nothing"):
        if (one / CACHE).is_dir() and (other / CACHE).is_dir():
            differences = list(same_reproduction(one, other))
        elif (one / SUMMARY).is_file() and (other / SUMMARY).is_file():
            differences = list(same_run(one, other))
        elif names := _runs(one) | _runs(other):
            differences = [
                f"{name}: {line}"
                for name in sorted(names)
                for line in same_run(one / name, other / name)
            ]
        else:
            raise InputError(
                Problem(
                    str(one),
                    "and the other folder are not two of one kind",
                    "Give two run folders, two results of make reproduce, or two golden sets.",
                )
            )
    for line in differences[:MOST_SHOWN]:
        typer.echo(line)
    typer.echo(f"{len(differences)} differences" if differences else "the same to the last bit")
    raise typer.Exit(bool(differences))


if __name__ == "__main__":
    typer.run(main)
