"""Large feeders that faults of lines cut into parts, with and without switches that move.

``python -m benchmarks.cut_feeders`` plans the first step of each case as a run does, by the
processor's clock, which others on the machine do not change.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from rich.progress import track

from benchmarks.deadlines import by_processor
from benchmarks.feeders import CASE69, FEEDERS, feeder_scenario
from benchmarks.frame.store import Row
from vppres.contract.decision import Decision
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches
from vppres.solve.result import SolveLimits

LIMIT_S = 27.0
"""Time limit of a step's decision, which may take 30 s: what has begun by then is ended."""

WIDTH = int(pd.read_csv(CASE69, comment="#")["to_bus"].max())
"""Buses of a copy of the 69-bus feeder: copy ``i`` has bus 7 as bus ``7 + i * WIDTH``."""

SECTION = 9
"""Bus of a copy on whose line a sectionaliser stands: the lateral with most of the load is next."""

TAILS = (27, 65)
"""Last buses of a copy's trunk and of its longest lateral, from which ties lead to the next."""

N_SECTIONS = 10
"""Copies with a sectionaliser; with as many ties there are 20 switches."""


@dataclass(frozen=True)
class Cut:
    """A step of the packaged day on a large feeder with lines that are out."""

    name: str
    buses: int
    seed: int
    #: Buses whose lines are out, each as copy and bus of the 69-bus feeder.
    lines: tuple[tuple[int, int], ...]
    hours: tuple[int, int] = (12, 18)  #: in which they are out
    first: int = 11  #: hour of the step
    outage: bool = True  #: whether the packaged day's outage is there too
    mode: str = "paper"
    switches: bool = False  #: whether there are 20 switches, five of them operable


CASES = (
    Cut("one line, outage", 1021, 0, ((0, 7),)),
    Cut("one line, with grid", 1021, 2, ((3, 5),), outage=False, first=10),
    Cut("two lines", 1021, 1, ((0, 20), (2, 22)), hours=(11, 15), first=10),
    Cut("all of a feeder", 1021, 3, ((5, 2),), hours=(9, 20), first=12),
    Cut("one line, outage, physical", 1021, 0, ((0, 7),), mode="physical"),
    Cut("20 switches", 1021, 0, ((0, 7),), first=12, switches=True),
    Cut("20 switches, with grid", 1021, 2, ((3, 5),), first=12, outage=False, switches=True),
    Cut("20 switches, two lines", 1021, 1, ((4, 7), (4, 20)), first=13, switches=True),
)


def cut_day(cut: Cut) -> Scenario:
    """The day of a case; every battery may form an island."""
    day = feeder_scenario(cut.buses, cut.seed)
    start, hour = day.grid.start, pd.Timedelta(hours=1)
    begin, end = (start + each * hour for each in cut.hours)
    day = replace(
        day,
        faults=tuple(LineFault(begin, end, bus + copy * WIDTH) for copy, bus in cut.lines),
        batteries=replace(day.batteries, grid_forming=np.ones(len(day.batteries), dtype=bool)),
    )
    if not cut.outage:
        day = replace(day, grid_limit_kw=np.full(day.grid.n_steps, np.inf))
    return replace(day, switches=switches_of(cut, day)) if cut.switches else day


def switches_of(cut: Cut, day: Scenario) -> Switches:
    """Ten sectionalisers and ten ties; operable are five around the first fault.

    They are the sectionalisers of its copy of the feeder and of the next, both ties between these,
    and one tie to the copy before.
    """
    copies, (faulted, _) = FEEDERS[cut.buses][1], cut.lines[0]
    order = [(faulted + i) % copies for i in range(-1, N_SECTIONS - 1)]
    net = day.network
    upper = dict(zip(net.to_bus, net.from_bus, strict=True))
    sections = [SECTION + copy * WIDTH for copy in order]
    rows = [(f"section {copy}", upper[bus], bus) for copy, bus in zip(order, sections, strict=True)]
    n_pairs = N_SECTIONS // len(TAILS)
    for one, other in [*pairwise(order)][:n_pairs]:
        rows += [
            (f"tie {one}-{other}, {tail}", tail + one * WIDTH, tail + other * WIDTH)
            for tail in TAILS
        ]
    names, from_bus, to_bus = (np.array(each, dtype=object) for each in zip(*rows, strict=True))
    closed = np.arange(len(rows)) < N_SECTIONS
    operable = np.isin(np.arange(len(rows)), (1, 2, *(N_SECTIONS + i for i in (0, 2, 3))))
    return Switches(
        id=names,
        from_bus=from_bus,
        to_bus=to_bus,
        kind=np.where(closed, "sectionaliser", "tie").astype(object),
        closed=closed,
        operable=operable,
        r_ohm=np.where(closed, np.nan, np.median(net.r_ohm)),
        x_ohm=np.where(closed, np.nan, np.median(net.x_ohm)),
    )


def decided(cut: Cut, limit_s: float = LIMIT_S) -> Decision:
    """The decision of a case's step, within a limit of the processor's time."""
    day = cut_day(cut)
    options = RunOptions(
        mode=cut.mode,
        isolate=False,
        limits=SolveLimits(time_s=limit_s),
        move_switches=cut.switches,
    ).on(day)
    controller = make_controller(day, options)
    seen = Day(day, options).observe(controller, cut.first)
    with by_processor():
        return controller.decide(seen)


def measure(cut: Cut, limit_s: float) -> Row:
    """How a case ended, with its bound, and its seconds of the processor."""
    begin_s = time.process_time()
    decision = decided(cut, limit_s)
    cpu_s = time.process_time() - begin_s
    info, moved = decision.info, decision.switched
    row: Row = {
        "case": cut.name,
        "seed": cut.seed,
        "fallback": decision.fallback,
        "status": info.status,
        "objective": info.objective,
        "bound": info.bound,
        "gap_rel": info.gap,
        "cpu_s": cpu_s,
    }
    if moved is not None:
        row |= {
            "configurations": moved.configurations,
            "bounded": moved.bounded,
            "planned": moved.planned,
            "moved": moved.moved or moved.why,
        }
    return row


def main(
    case: Annotated[list[int], typer.Option(help="Numbers of cases; all if not given.")] = [],  # noqa: B006 (typer copies it)
    limit: Annotated[float, typer.Option(metavar="S", help="Limit of a decision in s.")] = LIMIT_S,
) -> None:
    """Measure by the processor's clock."""
    chosen = [CASES[number] for number in case] or CASES
    rows = [measure(cut, limit) for cut in track(chosen, "cases", transient=True)]
    typer.echo(pd.DataFrame(rows).to_string(index=False))


if __name__ == "__main__":
    typer.run(main)
