"""IEEE 123 with its own switches and one line out: who is supplied with and without switching.

``python -m experiments.studies.switched_phases FOLDER --page docs/switches.md`` runs a day on the
circuit of a folder, by phase: with few batteries as in :mod:`experiments.studies.phases`, its own
normally closed switches, and the normally open ones 151-300 and 54-94. From noon on a line is out
for six hours, with grid, or with an outage of the same hours.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import fields, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.frame.pages import put_table
from experiments.studies.phases import FEEDERS, LIMIT_S, scenario_of, table_of
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches
from vppres.solve.result import SolveLimits

BEGIN, END = "<!-- switched: begin -->", "<!-- switched: end -->"
COLUMNS = (
    "line out",
    "from 12:00 to 18:00",
    "switches",
    "R in these hours",
    "customer hours off",
    "what was moved",
    "windows not certified",
    "largest voltage off plan, pu",
    "CPU of a step, s: median, most",
)
OPEN = (("151", "300"), ("54", "94"))
"""Switches that the circuit has at an end of its own, where the feeder's are open.

Both of their sides hang at one substation: they may close a loop, and compare both sides.
"""

OHM = 1e-3
LINES = ("18", "67")
"""Lines that are out, by the buses that they feed: 13-18, and 60-67."""

NOON, HOURS = pd.Timedelta(hours=12), pd.Timedelta(hours=6)


def switched(day: Scenario, line: str, outage: bool) -> Scenario:
    """The day with its switches and a line out, with an outage beside it or without."""
    first, second = (np.array(side, dtype=object) for side in zip(*OPEN, strict=True))
    n = len(OPEN)
    names = np.array(["-".join(pair) for pair in OPEN], dtype=object)
    kind, closed = np.full(n, "tie", dtype=object), np.zeros(n, dtype=bool)
    ohm = np.full(n, OHM)
    able = np.ones(n, dtype=bool)
    ties = Switches(
        names,
        first,
        second,
        kind,
        closed,
        r_ohm=ohm,
        x_ohm=ohm,
        parallel_allowed=able,
        sync_check=able,
    )
    both = {
        f.name: np.concatenate([getattr(day.switches, f.name), getattr(ties, f.name)])
        for f in fields(Switches)
    }
    start = day.grid.start.normalize() + NOON
    fault = LineFault(start, start + HOURS, line=line)
    dark = (day.grid.times >= start) & (day.grid.times < start + HOURS) & outage
    limit_kw = np.where(dark, 0.0, np.inf)
    return replace(day, switches=Switches(**both), faults=(fault,), grid_limit_kw=limit_kw)


def row(day: Scenario, horizon_h: float, moves: bool) -> str:
    """Cells of a day's run."""
    limits = SolveLimits(time_s=LIMIT_S)
    options = RunOptions(horizon_h=horizon_h, move_switches=moves, limits=limits)
    cpu_s = [time.process_time()]
    run = run_day(day, options, lambda *_: cpu_s.append(time.process_time()))
    day, steps = run.scenario, run.steps
    during = steps["lines_out"].ne("").to_numpy()
    supplied = run.by_step("customers", "served")[during] @ day.customers.weight
    share = float(supplied.mean() / day.customers.weight.sum())
    off_h = float((~run.by_step("customers", "served").astype(bool)).sum() * day.grid.dt_h)
    moved = "; ".join(words for words in steps.get("switched", ()) if words) or "none"
    seconds = np.diff(cpu_s)
    return (
        f"{share:.4f} | {off_h:.0f} | {moved} | {int((steps['status'] != 'optimal').sum())} | "
        f"{steps['v_error_pu'].max():.1e} | {np.median(seconds):.1f}, {seconds.max():.1f}"
    )


def main() -> int:
    """Read the arguments and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--lines", nargs="*", default=[*LINES])
    parser.add_argument("--horizon", type=float, default=5.0)
    parser.add_argument("--rows", type=Path, help="file of the rows so far")
    parser.add_argument("--page", type=Path, help="page whose table is written anew")
    given = parser.parse_args()
    day = scenario_of(given.folder / FEEDERS["123"])
    runs = {}
    for line, outage, moves in product(given.lines, (False, True), (False, True)):
        above = day.network.from_bus[day.network.bus_index[line] - 1]
        words = "outage" if outage else "grid", "move" if moves else "stay"
        of_line = partial(row, switched(day, line, outage), given.horizon, moves)
        runs[" | ".join((f"{above}-{line}", *words))] = of_line
    table = table_of(COLUMNS, runs, given.rows)
    if given.page:
        put_table(given.page, table, BEGIN, END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
