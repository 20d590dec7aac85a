"""Phased feeders: OpenDSS's admittances and voltages, and closed loops beside balanced plans.

``python -m experiments.studies.phases --verify FOLDER`` compares the own power flow with OpenDSS on
the circuits of a folder. ``python -m experiments.studies.phases --loops FOLDER`` runs a day with an
outage of six hours on each, planned by phase and as its balanced equivalent. Both are carried out
on the feeder with its phases, and printed as the table of the page.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import fields, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.frame.pages import put_table
from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation
from vppres.control.passes import Passes
from vppres.core.errors import VerificationError, VppresError
from vppres.day.assembly import make_controller
from vppres.day.metrics import resilience
from vppres.day.options import RunOptions
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.feeders.dss.phases import flow_of_source
from vppres.feeders.new.assets import BATTERY_INVERTER_RATIO
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import write_new_scenario
from vppres.feeders.sources import import_network
from vppres.io import read_scenario
from vppres.model.beyond_paper.losses import lit_steps
from vppres.model.data import WindowData
from vppres.scenario.phases import BALANCED
from vppres.scenario.scenario import REPORT, Scenario
from vppres.solve.result import SolveLimits, WindowSolution

FEEDERS = {
    "13": "13Bus/IEEE13Nodeckt.dss",
    "34": "34Bus/ieee34Mod1.dss",
    "37": "37Bus/ieee37.dss",
    "123": "123Bus/IEEE123Master.dss",
}
SOLVES = 50


def say(text: str) -> None:
    """Write a line at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def verify(folder: Path, names: list[str]) -> None:
    """Print how far admittances and voltages are from OpenDSS's, and the CPU time of a flow."""
    say("| feeder | nodes | admittances, relative | voltages, pu | CPU of a flow, ms |")
    say("| --- | --- | --- | --- | --- |")
    for name in names:
        feeder = import_network(folder / FEEDERS[name])
        phased = feeder.phased
        assert phased is not None
        flow, p_kw, q_kvar = flow_of_source(phased)
        flow.solve(p_kw, q_kvar)
        began = time.process_time()
        for _ in range(SOLVES):
            flow.solve(p_kw, q_kvar)
        cpu_ms = 1000.0 * (time.process_time() - began) / SOLVES
        apart = admittances_apart(folder / FEEDERS[name], flow)
        say(
            f"| IEEE {name} | {len(phased.phases.nodes)} | {apart:.1e} | "
            f"{phased.difference_pu:.1e} | {cpu_ms:.2f} |"
        )


def admittances_apart(file: Path, flow: Any) -> float:
    """Largest difference of an entry from OpenDSS's, as a share of its row's diagonal."""
    import opendssdirect as dss

    from vppres.feeders.dss import engine, script

    circuit, problems = engine.build({**script.read_script(file).job(), "open_deltas": True})
    assert not problems
    engine.settled(circuit)
    for kind in ("load", "generator", "pvsystem"):
        for element in circuit.of(kind):
            dss.Circuit.Disable(f"{kind}.{element}")
    dss.Text.Command("set controlmode=off")
    dss.Solution.Solve()
    names = [node.lower() for node in dss.Circuit.YNodeOrder()]
    flat = np.array(dss.Circuit.SystemY())
    theirs = (flat[::2] + 1j * flat[1::2]).reshape(len(names), len(names))
    place = {f"{bus}.{phase + 1}": i for i, (bus, phase) in enumerate(flow.phases.nodes)}
    at = [place[node] for node in names]
    own = flow.y.toarray()[np.ix_(at, at)]
    return float((np.abs(own - theirs).max(axis=1) / np.abs(np.diag(theirs))).max())


FORMER_SHARE = 0.1
"""Rating of the battery that forms islands, as a share of the peak load: 345 kVA on IEEE 13."""

FORMER_HOURS = 2.0

BATTERIES = 8
"""Batteries of a scenario, the former among them; the others hold what all others did."""

LIMIT_S = 600.0
"""Time limit of a window: tables are made on machines that do other things too."""

DAYS = {"usual": (1.0, 1.0), "little sun": (1.3, 0.3), "much sun": (0.6, 1.6)}
"""Factors of load and sun."""


BEGIN, END = "<!-- phases: begin -->", "<!-- phases: end -->"

COLUMNS = (
    "feeder",
    "day",
    "plan",
    "R planned",
    "R",
    "former's worst phase as planned, of its rating",
    "hours over it",
    "blacked out, h",
    "node-hours outside",
    "V, pu",
    "off plan, pu",
    "off plan before passes, pu: 95% of steps",
    "CPU of a window, s: median, most",
    "windows not certified",
)


def loops(folder: Path, names: list[str], days: list[str], kept: Path | None) -> str:
    """The table with rows for each feeder and day: planned by phase, and as balanced equivalent."""
    runs = {
        f"IEEE {name} | {day} | {plan}": partial(_tried, folder / FEEDERS[name], day, plan)
        for name, day, plan in product(names, days, ("by phase", "balanced"))
    }
    return table_of(COLUMNS, runs, kept)


def table_of(
    columns: Sequence[str], runs: Mapping[str, Callable[[], str]], kept: Path | None
) -> str:
    """A table of runs, each with its first cells and what makes the others.

    Rows that a file of them has are not run again; those that are run are added to it.
    """
    rows = kept.read_text("utf-8").splitlines() if kept is not None and kept.is_file() else []
    table = [f"| {' | '.join(columns)} |", "| --- " * len(columns) + "|"]
    for key, cells in runs.items():
        row = next((each for each in rows if each.startswith(f"| {key} |")), None)
        row = row or f"| {key} | {cells()} |"
        say(row)
        table.append(row)
        if kept is not None and row not in rows:
            rows.append(row)
            kept.write_text("".join(f"{each}\n" for each in rows), "utf-8")
    return "\n".join(table)


def _tried(file: Path, day: str, plan: str) -> str:
    """A loop, or that the import refuses the balanced equivalent."""
    try:
        if plan == "balanced":
            import_network(file, balance=True)
        return loop(of_day(scenario_of(file), day), plan == "balanced")
    except VppresError as error:
        say(str(error))
        return "refused"


@cache
def scenario_of(file: Path) -> Scenario:
    """A first scenario of a circuit, with a battery that can hold its island."""
    options = NewScenarioOptions(pv="sized", draw_tiers=True, add_batteries=True)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "feeder"
        write_new_scenario(import_network(file), options, target)
        return _equipped(read_scenario(target))


def _equipped(scenario: Scenario) -> Scenario:
    """The scenario with few batteries, and a former of a size that can hold an island."""
    b = scenario.batteries
    phases = scenario.phases
    assert phases
    rating = FORMER_SHARE * scenario.load_kw.max(axis=0).sum()
    others = np.flatnonzero(~b.grid_forming)
    spread = np.linspace(0, len(others) - 1, BATTERIES - 1).round().astype(int)
    kept = np.sort(np.append(np.flatnonzero(b.grid_forming), others[spread]))
    more = b.energy_kwh[others].sum() / b.energy_kwh[others[spread]].sum()
    sizes = {
        "energy_kwh": np.where(b.grid_forming, FORMER_HOURS * rating, more * b.energy_kwh),
        "p_max_kw": np.where(b.grid_forming, rating / BATTERY_INVERTER_RATIO, more * b.p_max_kw),
        "s_max_kva": np.where(b.grid_forming, rating, more * b.s_max_kva),
    }
    resized = replace(b, **sizes)
    batteries = replace(b, **{f.name: getattr(resized, f.name)[kept] for f in fields(b)})
    gone = {*b.id} - {*batteries.id}
    connections = tuple(row for row in phases.connections if row.id not in gone)
    return replace(scenario, batteries=batteries, phases=replace(phases, connections=connections))


def of_day(scenario: Scenario, day: str) -> Scenario:
    """A scenario with more or less load and sun."""
    load, sun = DAYS[day]
    pv_kw = np.minimum(sun * scenario.pv_kw, scenario.pv.p_max_kw)
    return replace(scenario, load_kw=load * scenario.load_kw, pv_kw=pv_kw)


class Timed:
    """A controller whose decisions' CPU times are kept."""

    def __init__(self, inner: Decider, cpu_s: list[float]) -> None:
        self.inner = inner
        self.cpu_s = cpu_s

    def horizon_steps(self, t0: int) -> range:
        """Steps of a window."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """A decision, timed with all of its passes."""
        began = time.process_time()
        decision = self.inner.decide(observation)
        self.cpu_s.append(time.process_time() - began)
        return decision


def _watching(off_pu: list[float]) -> AbstractContextManager[Any]:
    """Keep how far first candidates are off AC in their first step, in pu, before any pass."""
    plain = Passes.converged

    def converged(
        self: Passes, data: WindowData, solution: WindowSolution
    ) -> tuple[WindowData, WindowData, WindowSolution]:
        at, plan = self.linearisation, solution.dispatch
        if data.phased and lit_steps(data)[0]:
            points = at.points(data, plan)
            if points.converged[0]:
                planned = at.finished(data, plan).v_node_pu
                off_pu.append(float(np.abs(planned - np.sqrt(points.u_pu2))[0].max()))
        return plain(self, data, solution)

    return patch.object(Passes, "converged", converged)


class Watched(Day):
    """A day that keeps what the former's phases would carry if all followed the plan."""

    def __init__(self, scenario: Scenario, options: RunOptions) -> None:
        super().__init__(scenario, options)
        self.worst_kva: list[float] = []
        self.planned: list[Any] = []
        self.cpu_s: list[float] = []

    def play(self, controller: Decider, t: int) -> StepRecord:
        """One step, with the CPU time of its decision."""
        return super().play(Timed(controller, self.cpu_s), t)

    def settle(self, t: int, decision: Decision) -> StepRecord:
        """One step, with the former's phases at the set-points of the plan before it."""
        self.planned.append(np.asarray(decision.dispatch.served[decision.row]))
        if self.scenario.outage[t] and self.scenario.phases:
            planned = self.plant.apply(t, decision, self.state)
            former = int(np.argmax(self.scenario.batteries.grid_forming))
            injections = planned.p_injection_kw, planned.q_injection_kvar
            try:
                found = self.island_ac.solve(*injections, int(self.plant.places.batteries[former]))
                self.worst_kva.append(float(np.abs(found.source_kva).max()))
            except VerificationError:
                self.worst_kva.append(np.inf)
        return super().settle(t, decision)


def loop(scenario: Scenario, balanced: bool) -> str:
    """A closed loop on the feeder with its phases."""
    known = replace(scenario, phases=BALANCED) if balanced else scenario
    options = RunOptions(limits=SolveLimits(time_s=LIMIT_S), ratings=REPORT).on(scenario)
    day = Watched(scenario, options)
    first_pu: list[float] = []
    with _watching(first_pu):
        run = day.run(make_controller(known, options))
    steps = run.steps
    assert run.nodes is not None
    dark = scenario.outage
    rating = scenario.batteries.s_max_kva[scenario.batteries.grid_forming].max() / 3.0
    worst = np.array(day.worst_kva) / rating
    v = run.nodes["v_ac_pu"]
    net = scenario.network
    outside = int(((v < net.v_min_ac_pu) | (v > net.v_max_ac_pu)).sum())
    weight = scenario.customers.weight
    claimed = float(np.mean(np.array(day.planned)[dark] @ weight) / weight.sum())
    open_ = int((steps["status"] != "optimal").sum())
    off_plan = "" if balanced else f"{np.nanmax(steps['v_error_pu']):.1e}"
    off_first = f"{np.quantile(first_pu, 0.95):.4f}" if first_pu else ""
    return (
        f"{claimed:.4f} | {resilience(run) or 0.0:.4f} | {worst.max():.3f} | "
        f"{int((worst > 1.0).sum())} of {dark.sum()} | {int(steps['dark'].sum())} | "
        f"{outside} of {v.notna().sum()} | {v.min():.3f} to {v.max():.3f} | "
        f"{off_plan} | {off_first} | "
        f"{np.median(day.cpu_s):.2f}, {max(day.cpu_s):.2f} | {open_}"
    )


def main() -> int:
    """Read the arguments and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verify", type=Path)
    parser.add_argument("--loops", type=Path)
    parser.add_argument("--feeders", nargs="*", default=[*FEEDERS])
    parser.add_argument("--days", nargs="*", default=[*DAYS])
    parser.add_argument("--rows", type=Path, help="file of the rows so far")
    parser.add_argument("--page", type=Path, help="page whose table is written anew")
    given = parser.parse_args()
    if given.verify:
        verify(given.verify, given.feeders)
    if given.loops:
        table = loops(given.loops, given.feeders, given.days, given.rows)
        if given.page:
            put_table(given.page, table, BEGIN, END)
    return 0


if __name__ == "__main__":
    sys.exit(main())
