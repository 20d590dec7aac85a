"""What each mechanism of the solver is worth: ``python -m benchmarks.ablation``.

Every window is solved as the package solves it, and again with one mechanism, or a group of them,
switched off by a patch from outside. A mechanism that is never entered in a window changes nothing
there, and is not measured. A mechanism lives only if switching it off loses a certificate, of the
objective or of the cost, or more than 2 % of the whole time; evidence from a single day or window
is none.
"""

from __future__ import annotations

import inspect
import pkgutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import numpy as np
import pandas as pd
import typer
from rich.progress import track

from benchmarks.cases import Case, cases, sample
from benchmarks.clock import on_cpu_time
from benchmarks.frame.terminal import plain_errors
from benchmarks.mechanisms import GROUPS, MECHANISMS, SOLVE, Mechanism
from vppres.core.errors import SolveError
from vppres.model.data import WindowData
from vppres.solve.cache import ModelCache
from vppres.solve.certificate import cost_gap_gbp
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

TABLE = Path(__file__).parents[1] / "docs" / "_static" / "benchmarks" / "ablation.csv"
CERTIFY_S = 10.0
"""CPU time in s in which a window is to be certified."""
LIMIT_S = 15.0
"""Limit of a window in s of CPU time."""
COMPILE_MATTERS_S = 2.5
"""CPU time in s beyond which a window is not solved again for what compiling took."""
WORSE = 1e-4
"""Share of an objective by which another is worse."""
SAMPLE = {
    "packaged day": 10,
    "users": 4,
    "random": 12,
    "switching rules": 5,
    "physical": 6,
    "large": 5,
    "long": 5,
}
"""Every N-th window of each group in a sample."""
BASE = "as it is"


@dataclass(frozen=True)
class Variant:
    """Mechanisms that are off together, by name."""

    name: str
    off: tuple[Mechanism, ...]


def variants() -> list[Variant]:
    """Each mechanism alone, then the groups."""
    by_name = {m.name: m for m in MECHANISMS}
    alone = [Variant(m.name, (m,)) for m in MECHANISMS]
    groups = [Variant(name, tuple(by_name[n] for n in of)) for name, of in GROUPS.items()]
    return [*alone, *groups]


@contextmanager
def switched_off(variant: Variant) -> Iterator[None]:
    """Patch every switch of a variant while the block runs."""
    with ExitStack() as stack:
        for mechanism in variant.off:
            for target, off in mechanism.switches.items():
                holder, _, name = target.rpartition(".")
                stack.enter_context(patch.object(pkgutil.resolve_name(SOLVE + holder), name, off))
        yield


@contextmanager
def watched() -> Iterator[set[str]]:
    """Names of the mechanisms that are entered while the block runs."""
    entered: set[str] = set()

    def counted(original: Callable[..., Any], name: str) -> Callable[..., Any]:
        @wraps(original)
        def call(*args: Any, **options: Any) -> Any:
            entered.add(name)
            return original(*args, **options)

        return call

    with ExitStack() as stack:
        for mechanism in MECHANISMS:
            for target in mechanism.switches:
                holder, _, name = target.rpartition(".")
                of = pkgutil.resolve_name(SOLVE + holder)
                original = getattr(of, name)
                if callable(original):
                    stack.enter_context(patch.object(of, name, counted(original, mechanism.name)))
                else:
                    entered.add(mechanism.name)
        yield entered


def solve(solver: WindowSolver, data: WindowData) -> dict[str, Any]:
    """CPU time, value and bound of a window; solved again where compiling may have mattered."""
    while True:
        compiled = solver.compilations
        begin_s = time.process_time()
        row: dict[str, Any] = dict.fromkeys(("value", "bound", "cost_gbp", "cost_gap_gbp"), np.nan)
        row["stages"] = ""
        try:
            answer = solver.solve(data)
        except SolveError as error:
            row["status"] = type(error).__name__
        else:
            row |= {
                "status": str(answer.status),
                "value": answer.objective,
                "bound": answer.bound,
                "cost_gbp": answer.terms.f2,
                "cost_gap_gbp": answer.cost_gap_gbp,
                "stages": " ".join(answer.stages),
            }
        row["cpu_s"] = time.process_time() - begin_s
        if solver.compilations == compiled or row["cpu_s"] > COMPILE_MATTERS_S:
            return row


def measure(case: Case, chosen: Sequence[Variant]) -> Iterator[dict[str, Any]]:
    """Rows of a window: as it is, then each variant of which a mechanism was entered."""
    site, data = case.make()
    solver = WindowSolver(site, limits=SolveLimits(time_s=LIMIT_S))
    solver.cache = ModelCache(site)
    key = {"group": case.group, "window": case.name}
    with watched() as entered:
        solve(solver, data)
    yield {**key, "variant": BASE, **solve(solver, data)}
    for variant in chosen:
        if entered & {m.name for m in variant.off}:
            with switched_off(variant):
                yield {**key, "variant": variant.name, **solve(solver, data)}


def lines_of(variant: Variant) -> int:
    """Lines of the sources that a variant would delete."""
    parts = {part for mechanism in variant.off for part in mechanism.code}
    return sum(
        len(inspect.getsource(pkgutil.resolve_name(SOLVE + part)).splitlines()) for part in parts
    )


def table(rows: pd.DataFrame, chosen: Sequence[Variant]) -> pd.DataFrame:
    """One line for each variant: what it loses in the windows that it was entered in."""
    base = rows[rows["variant"] == BASE].set_index("window")
    total_s = base["cpu_s"].clip(upper=CERTIFY_S).sum()
    found = []
    for variant in chosen:
        off = rows[rows["variant"] == variant.name].set_index("window")
        on = base.loc[off.index]
        scale = on["value"].abs().clip(lower=1e-2)
        worse = (off["value"] < on["value"] - WORSE * scale) | (
            on["value"].notna() & off["value"].isna()
        )
        more_s = (off["cpu_s"].clip(upper=CERTIFY_S) - on["cpu_s"].clip(upper=CERTIFY_S)).sum()
        found.append(
            {
                "switched off": variant.name,
                "lines": lines_of(variant),
                "windows": len(off),
                "certified": int(certified(on).sum()),
                "without": int(certified(off).sum()),
                "cost certified": int(cost_certified(on).sum()),
                "cost without": int(cost_certified(off).sum()),
                "worse": int(worse.sum()),
                "share of all time": f"{more_s / total_s:+.1%}",
            }
        )
    return pd.DataFrame(found)


def certified(rows: pd.DataFrame) -> pd.Series[bool]:
    """Windows that are certified, or proven to have no dispatch, in time."""
    done = rows["status"].isin(["optimal", "InfeasibleError"])
    return done & (rows["cpu_s"] <= CERTIFY_S)


def cost_certified(rows: pd.DataFrame) -> pd.Series[bool]:
    """Windows in which no dispatch of the same service is cheaper by more than the gap of cost."""
    return rows["cost_gap_gbp"] <= rows["cost_gbp"].abs().map(cost_gap_gbp)


def main(
    sampled: Annotated[bool, typer.Option("--sample", help="Some windows of each group.")] = False,
    only: Annotated[list[str], typer.Option(metavar="NAME", help="Variants; all without.")] = [],  # noqa: B006 (typer copies it)
    groups: Annotated[
        list[str], typer.Option("--group", metavar="NAME", help="Groups of windows; all without.")
    ] = [],  # noqa: B006 (typer copies it)
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the rows.")] = Path(
        "results/ablation"
    ),
    to_docs: Annotated[
        bool, typer.Option("--publish", help="Write the table for the documentation.")
    ] = False,
) -> None:
    """Measure what each mechanism is worth; an interrupted run goes on where it stopped."""
    chosen = [v for v in variants() if not only or v.name in only]
    found = list(cases())
    found = sample(found, SAMPLE) if sampled else found
    found = [case for case in found if not groups or case.group in groups]
    results.mkdir(parents=True, exist_ok=True)
    file = results / "rows.csv"
    rows = pd.read_csv(file) if file.is_file() else pd.DataFrame({"window": []})
    with plain_errors("Finished windows"), on_cpu_time():
        todo = [case for case in found if case.name not in set(rows["window"])]
        for case in track(todo, "windows", transient=True):
            rows = pd.concat([rows, pd.DataFrame(measure(case, chosen))], ignore_index=True)
            rows.to_csv(file, index=False)
    summary = table(rows, chosen)
    if to_docs:
        summary.to_csv(TABLE, index=False)
    base = rows[rows["variant"] == BASE]
    typer.echo(
        f"{len(base)} windows, {certified(base).sum()} certified, {base['cpu_s'].sum():.1f} s"
    )
    typer.echo(summary.to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
