"""Which stage closed each of 406 windows: ``python -m benchmarks.stages``.

The table says which stages of ``vppres.solve`` are worth their code; it is published in
``docs/method.md``. Windows are the instances of ``instances.csv``, random feeders, random feeders
with switching rules, and random feeders in physical mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.progress import track

from benchmarks.instances import Instance, packaged, read_instances, window_data
from experiments.random_feeders import Window, random_state, random_window
from experiments.terminal import plain_errors
from vppres.control.converged import ConvergedPlanner, dark_steps, physics_of, without_power
from vppres.core.errors import SolveError
from vppres.io.atomic import atomic_write_text
from vppres.model.beyond_paper.losses import linearised, lossless
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.solve.fleet.masters import fleets_of
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

DOCUMENT = Path(__file__).parents[1] / "docs" / "method.md"
BEGIN = "<!-- stages begin -->"
END = "<!-- stages end -->"

HEADROOM = 0.1
"""Share of the inverters that physical windows keep free, the default of a run."""

RUNGS = {
    "full": "whole problem",
    "full_outer": "whole problem",
    "network_terms": "all terms, in the network",
    "relaxed": "whole problem, relaxed",
    "network_service": "in the network",
    "modes": "modes of all batteries",
    "aggregate": "all terms at once",
    "binary_service": "binaries",
    "service": "counts",
}
"""Stages that decide who is served, the last to be tried first, and the rung of the ladder that
each belongs to."""
OPEN = "left open"
EVERYONE = "everyone served"


@dataclass(frozen=True)
class Case:
    """A window of the table: its group, its name and how it is made."""

    group: str
    name: str
    make: Callable[[], tuple[Site, WindowData]]


def cases() -> Iterator[Case]:
    """All windows: 124 instances, 200 random ones, 50 with rules, 32 in physical mode."""
    for instance in read_instances():
        yield Case("benchmark", instance.name, partial(_of_instance, instance))
    for group, make, counts in (
        ("random", random_window, (100, 100)),
        ("switching rules", ruled_window, (30, 20)),
        ("physical", physical_window, (16, 16)),
    ):
        for stressed, count in zip((False, True), counts, strict=True):
            for seed in range(count):
                name = f"{'stressed ' if stressed else ''}{seed}"
                yield Case(group, name, partial(_of_window, make, seed, stressed))


def _of_instance(instance: Instance) -> tuple[Site, WindowData]:
    """Site and data of a window of the benchmark."""
    return Site.of(packaged()), window_data(instance)


def _of_window(
    make: Callable[[int, bool], Window], seed: int, stressed: bool
) -> tuple[Site, WindowData]:
    """Site and data of a random window."""
    case = make(seed, stressed)
    return Site.of(case.scenario), case.data


def ruled_window(seed: int, stressed: bool) -> Window:
    """A random window with random switching rules and a random past."""
    case = random_window(seed, stressed)
    state = random_state(seed, case.scenario)
    data = replace(case.data, switching=state.window(case.data.n_steps))
    return Window(case.scenario, data)


def physical_window(seed: int, stressed: bool) -> Window:
    """A random window with headroom, and losses as at the AC points of its lossless answer."""
    case = random_window(seed, stressed)
    site = Site.of(case.scenario)
    lit = without_power(case.data, dark_steps(site, case.data))
    start = lossless(lit, physics_of(site, lit, HEADROOM))
    planner = ConvergedPlanner(WindowSolver(site))
    points = planner.ac_points(start, planner.solver.solve(start).dispatch)
    return Window(case.scenario, linearised(start, site.network, points))


def measure(case: Case, time_s: float) -> dict[str, object]:
    """Solve a window and say which stage closed it."""
    site, data = case.make()
    row: dict[str, object] = {"group": case.group, "window": case.name}
    try:
        answer = WindowSolver(site, limits=SolveLimits(time_s=time_s)).solve(data)
    except SolveError as error:
        # Random rules can leave nothing; the proof closes the window as well as an answer does.
        return row | {"rung": "proven infeasible", "status": type(error).__name__}
    certified = str(answer.status) == "optimal"
    return row | {
        "rung": rung(answer.stages, data) if certified else OPEN,
        "status": str(answer.status),
        "objective": answer.objective,
        "bound": answer.bound,
        "cost_gbp": answer.terms.f2,
        "cost_gap_gbp": answer.cost_gap_gbp,
        "service_gap": answer.service_gap,
        "solve_s": answer.solve_s,
        "stages": " ".join(answer.stages),
    }


def rung(stages: tuple[str, ...], data: WindowData) -> str:
    """The last rung that was tried, which closed the window since none came after it.

    Counts are tried with a lumped battery first, where batteries are alike, and a second time with
    every battery apart.
    """
    names = [stage.partition("[")[0] for stage in stages]
    for name, words in RUNGS.items():
        if name not in names:
            continue
        if name != "service":
            return words
        lumped = fleets_of(data)[0] and names.count(name) == 1
        return f"{words}, {'one lumped battery' if lumped else 'every battery'}"
    return EVERYONE


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """Windows of each group that each rung closed, and their share of all."""
    counted = rows.pivot_table(
        index="rung", columns="group", values="window", aggfunc="count", fill_value=0, sort=False
    )
    counted["all"] = counted.sum(axis=1)
    counted["share"] = (counted["all"] / len(rows)).map("{:.1%}".format)
    return counted.sort_values("all", ascending=False).reset_index()


def publish(rows: pd.DataFrame, time_s: float, document: Path = DOCUMENT) -> None:
    """Put the table between the marks of the document."""
    text = document.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    words = f"{len(rows)} windows, {rows['solve_s'].sum():.0f} s in all, at most {time_s:g} s each:"
    found = f"{before}{BEGIN}\n{words}\n\n{markdown(table(rows))}\n{END}{after}"
    atomic_write_text(document, found)


def markdown(counted: pd.DataFrame) -> str:
    """A table in Markdown."""
    lines = [
        "| closed by | " + " | ".join(counted.columns[1:]) + " |",
        "|---" * len(counted.columns) + "|",
    ]
    lines += [
        "| " + " | ".join(str(value) for value in row) + " |"
        for row in counted.itertuples(index=False)
    ]
    return "\n".join(lines)


def main(
    time_limit: Annotated[float, typer.Option(metavar="S", help="Limit of a window.")] = 20.0,
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the rows.")] = Path(
        "results/stages"
    ),
    to_docs: Annotated[
        bool, typer.Option("--publish", help="Put the table into docs/method.md.")
    ] = False,
) -> None:
    """Count which stage closed each window, in this process."""
    with plain_errors("Nothing"):
        found = list(cases())
        rows = pd.DataFrame(
            [measure(case, time_limit) for case in track(found, "windows", transient=True)]
        )
        results.mkdir(parents=True, exist_ok=True)
        rows.to_csv(results / "rows.csv", index=False)
        if to_docs:
            publish(rows, time_limit)
    typer.echo(markdown(table(rows)))


if __name__ == "__main__":
    typer.run(main)
