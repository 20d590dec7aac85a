"""All windows by this tree and by another: ``python -m benchmarks.two_trees TREE``.

Each tree has a process of its own. They take turns at every window, so that both meet the same
load, and windows come in random order, so that those that are finished say something of all. CPU
time is counted, without compiling.
"""

from __future__ import annotations

import os
import pickle
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import pandas as pd
import typer
from rich.progress import track

from benchmarks import ablation
from benchmarks.cases import Case, cases
from benchmarks.clock import on_cpu_time
from benchmarks.frame.terminal import plain_errors
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

HERE = Path(__file__).parents[1]
TABLE = HERE / "docs" / "_static" / "benchmarks" / "two-trees.csv"
TREES = ("before", "after")
SEED = 1
SLOW = 0.95
"""Share of a group's windows that take no longer than its slow ones."""


def serve(folder: Path) -> None:
    """Solve the windows that are named on standard input, in the tree that is imported."""
    found = {case.name: case for case in cases()}
    with on_cpu_time():
        for name in map(str.strip, sys.stdin):
            site, data = shared(folder / "window", found[name])
            solver = WindowSolver(site, limits=SolveLimits(time_s=ablation.LIMIT_S))
            (folder / "row").write_bytes(pickle.dumps(ablation.solve(solver, data)))
            sys.stdout.write("done\n")
            sys.stdout.flush()


def shared(file: Path, case: Case) -> Any:
    """A window as the first tree makes it: that of physical mode depends on its answers."""
    if not file.is_file():
        file.write_bytes(pickle.dumps(case.make()))
    return pickle.loads(file.read_bytes())


def rows_of(chosen: list[Case], other: Path, done: set[str]) -> Iterator[list[dict[str, Any]]]:
    """How each window ended by both trees; which of them begins alternates."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        with started(other, folder) as before, started(HERE, folder) as after:
            trees = dict(zip(TREES, (before, after), strict=True))
            for number, case in enumerate(chosen):
                if case.name in done:
                    continue
                (folder / "window").unlink(missing_ok=True)
                found = []
                for each in TREES if number % 2 == 0 else TREES[::-1]:
                    row = asked(trees[each], case.name, folder)
                    found.append({"group": case.group, "window": case.name, "tree": each, **row})
                yield found


def started(tree: Path, folder: Path) -> subprocess.Popen[str]:
    """The process of a tree, which need not know this module."""
    return subprocess.Popen(
        [sys.executable, "-P", __file__, ".", "--serve", str(folder)],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree.resolve())},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def asked(process: subprocess.Popen[str], name: str, folder: Path) -> dict[str, Any]:
    """What a tree answers for a window."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{name}\n")
    process.stdin.flush()
    if not process.stdout.readline():
        raise RuntimeError(f"a tree ended at {name}")
    row: dict[str, Any] = pickle.loads((folder / "row").read_bytes())
    return row


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """A line for each group, and one for all, with both trees beside each other."""
    groups = [(str(name), of) for name, of in rows.groupby("group", sort=False)]
    return pd.DataFrame([_line(name, of) for name, of in [*groups, ("all", rows)]])


def _line(group: str, rows: pd.DataFrame) -> dict[str, Any]:
    """What both trees certify of a group's windows, and in what time."""
    by_tree = [rows[rows["tree"] == each] for each in TREES]
    spent = [of["cpu_s"].clip(upper=ablation.CERTIFY_S) for of in by_tree]
    figures: dict[str, list[Any]] = {
        "certified": [int(ablation.certified(of).sum()) for of in by_tree],
        "cost certified": [int(ablation.cost_certified(of).sum()) for of in by_tree],
        "total s": [f"{s.sum():.1f}" for s in spent],
        "median s": [f"{s.median():.3f}" for s in spent],
        "95% s": [f"{s.quantile(SLOW):.2f}" for s in spent],
        "worst s": [f"{s.max():.2f}" for s in spent],
    }
    both = {name: f"{before} / {after}" for name, (before, after) in figures.items()}
    return {"windows of": group, "windows": len(by_tree[0]), **both}


def main(
    tree: Annotated[Path, typer.Argument(metavar="TREE", help="The other tree's folder.")],
    groups: Annotated[
        list[str], typer.Option("--group", metavar="NAME", help="Groups of windows; all without.")
    ] = [],  # noqa: B006 (typer copies it)
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the rows.")] = Path(
        "results/two-trees"
    ),
    to_docs: Annotated[
        bool, typer.Option("--publish", help="Write the table for the documentation.")
    ] = False,
    served: Annotated[Path | None, typer.Option("--serve", hidden=True)] = None,
) -> None:
    """Solve all windows by two trees; an interrupted run goes on where it stopped."""
    if served is not None:
        serve(served)
        return
    chosen = [case for case in cases() if not groups or case.group in groups]
    order = [case.group for case in chosen]
    random.Random(SEED).shuffle(chosen)
    results.mkdir(parents=True, exist_ok=True)
    file = results / "rows.csv"
    rows = pd.read_csv(file) if file.is_file() else pd.DataFrame({"window": []})
    done = set(rows["window"])
    with plain_errors("Finished windows"):
        found = rows_of(chosen, tree, done)
        todo = sum(case.name not in done for case in chosen)
        for pair in track(found, "windows", total=todo, transient=True):
            rows = pd.concat([rows, pd.DataFrame(pair)], ignore_index=True)
            rows.to_csv(file, index=False)
    rows = rows.sort_values("group", key=lambda of: of.map(order.index), kind="stable")
    summary = table(rows)
    if to_docs:
        summary.to_csv(TABLE, index=False)
    typer.echo(summary.to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
