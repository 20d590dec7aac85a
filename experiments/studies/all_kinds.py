"""Windows with every kind of asset: two generating sets, 20 vehicles and 20 cooled homes.

``python -m experiments.studies.all_kinds`` plays the heat-wave day in each mode and order of
priority, and writes the time of its 24 windows into ``docs/benchmarks.md``, beside the whole
problem.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import typer

from benchmarks.frame.pages import markdown_table, put_table
from benchmarks.frame.whole import monolith
from experiments.studies.precooling import heat_wave
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.kinds.gensets import Gensets
from vppres.kinds.vehicles import Chargers, Sessions
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.priority import STRICT
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution
from vppres.solve.solvers import SOLVERS

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"
BEGIN, END = "<!-- all kinds: begin -->", "<!-- all kinds: end -->"
VEHICLES = 20
WEIGHTS = "weights"
LIMIT_S = 10.0
COLUMNS = ("mode", "priority", "certified", "largest gap", "median s", "worst s")
OF_WHOLE = ("whole problem certified", "its median s", "its worst s")


def with_all_kinds(seed: int) -> Scenario:
    """The heat-wave day with cooled homes, vehicles that are drawn, and two sets."""
    day = heat_wave("uk-heatwave-2022", seed)
    chargers, sessions = vehicles(day, np.random.default_rng([seed, 20]))
    return replace(day, chargers=chargers, sessions=sessions, gensets=two_sets(day))


def vehicles(day: Scenario, rng: np.random.Generator) -> tuple[Chargers, Sessions]:
    """A session a vehicle, at a charger behind a customer; one in four chargers is two-way."""
    count = VEHICLES
    names = np.array([f"k{i:02d}" for i in range(count)], dtype=object)
    two_way = np.arange(count) % 4 == 0
    chargers = Chargers(
        id=names,
        customer=rng.choice(day.customers.id, count, replace=False),
        bus=np.full(count, None, dtype=object),
        p_charge_kw=np.full(count, 7.4),
        p_charge_min_kw=np.full(count, 1.4),
        p_discharge_kw=np.where(two_way, 7.4, 0.0),
        eta_charge=np.full(count, 0.92),
        eta_discharge=np.full(count, 0.92),
    )
    begin = rng.uniform(0.0, day.grid.n_steps * day.grid.dt_h - 6.0, count)
    hours = rng.uniform(4.0, 12.0, count)
    sessions = Sessions(
        charger=names,
        vehicle=np.array([f"car{i:02d}" for i in range(count)], dtype=object),
        plug_in=np.array([day.grid.start + pd.Timedelta(hours=h) for h in begin], dtype=object),
        plug_out=np.array(
            [day.grid.start + pd.Timedelta(hours=h) for h in begin + hours], dtype=object
        ),
        capacity_kwh=np.full(count, 60.0),
        soc_at_plug_in=rng.uniform(0.2, 0.6, count),
        soc_needed=np.full(count, 0.8),
        energy_needed_kwh=np.full(count, np.nan),
        v2g_soc_floor=np.full(count, 0.3),
        tier=np.full(count, day.tiers[-1], dtype=object),
        weight=np.full(count, day.customers.weight.min()),
        announced=np.ones(count, dtype=bool),
    )
    return chargers, sessions


def two_sets(day: Scenario) -> Gensets:
    """Two sets beside the two largest critical customers, with fuel for four hours each."""
    load_kw = day.load_kw.max(axis=0) * (day.customers.tier == day.tiers[0])
    at = day.customers.bus[np.argsort(-load_kw)[:2]]
    p_max_kw = np.array([200.0, 400.0])
    litres_per_h = (0.246 + 0.08415) * p_max_kw
    return Gensets(
        id=np.array(["set0", "set1"], dtype=object),
        bus=at,
        p_max_kw=p_max_kw,
        p_min_kw=0.3 * p_max_kw,
        ramp_up_kw_per_h=np.full(2, np.inf),
        ramp_down_kw_per_h=np.full(2, np.inf),
        min_on_h=np.array([1.0, 2.0]),
        min_off_h=np.ones(2),
        on_before_h=np.full(2, -24.0),
        start_cost_gbp=np.full(2, 10.0),
        fuel_price_gbp_per_litre=np.full(2, 1.5),
        litres_per_kwh=np.full(2, 0.246),
        litres_per_h_idle=0.08415 * p_max_kw,
        tank_litres=4.0 * litres_per_h,
        fuel_level_litres=4.0 * litres_per_h,
        only_in_outage=np.ones(2, dtype=bool),
    )


class Last(WindowSolver):
    """A solver that keeps the window that it was asked for last."""

    asked: WindowData

    def solve(self, data: WindowData, within_s: float = np.inf) -> WindowSolution:
        """The window's solution."""
        self.asked = data
        return super().solve(data, within_s)


def windows(seed: int, mode: str, priority: str) -> pd.DataFrame:
    """A row for each step of a day: CPU seconds of its decision, its gap, and the whole problem's.

    The whole problem has tiers by weight, so that windows in strict order have none beside them.
    """
    scenario = with_all_kinds(seed)
    options = RunOptions(mode=mode, priority=priority, isolate=False).on(scenario)
    day = Day(scenario, options)
    solvers: list[Last] = []

    def make(site: Site) -> Last:
        solvers.append(Last(site, limits=options.limits))
        return solvers[-1]

    controller = make_controller(scenario, options, make_solver=make)
    rows = []
    for t in range(scenario.grid.n_steps):
        began = time.process_time()
        decision = controller.decide(day.observe(controller, t))
        cpu_s = time.process_time() - began
        day.recorder.add(day.settle(t, decision))
        row = {"cpu_s": cpu_s}
        if priority == WEIGHTS:
            solver = solvers[0]
            found = monolith(solver.site, solver.asked, SOLVERS["highs"], LIMIT_S)
            row["whole_s"] = float(found["s"])
        rows.append(row)
    steps = day.recorder.finish(options.as_record()).steps
    return pd.DataFrame(rows).assign(gap=steps["gap"], status=steps["status"])


def summary(mode: str, priority: str, rows: pd.DataFrame) -> tuple[str, ...]:
    """A line of the table."""
    own = [
        f"{int((rows['status'] == 'optimal').sum())} of {len(rows)}",
        f"{rows['gap'].max():.1e}",
        f"{rows['cpu_s'].median():.2f}",
        f"{rows['cpu_s'].max():.1f}",
    ]
    if "whole_s" not in rows:
        return (mode, priority, *own, "", "", "")
    whole_s = rows["whole_s"].clip(upper=LIMIT_S)
    ended = f"{int(np.isfinite(rows['whole_s']).sum())} of {len(rows)}"
    return (mode, priority, *own, ended, f"{whole_s.median():.2f}", f"{whole_s.max():.1f}")


def main(seed: int = 0) -> None:
    """Write the time of the day's windows, in each mode and order of priority, into the page."""
    lines = [
        summary(mode, priority, windows(seed, mode, priority))
        for mode in ("paper", "physical")
        for priority in (WEIGHTS, STRICT)
    ]
    table = markdown_table((*COLUMNS, *OF_WHOLE), lines)
    typer.echo(table)
    put_table(PAGE, table, BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
