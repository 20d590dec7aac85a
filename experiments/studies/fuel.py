"""Fuel and cars in outages of unknown length: valued together, sets first, batteries first.

``python -m experiments.studies.fuel --days 60`` plays days with an outage, drawn by seed, with two
sets, 20 vehicles and 20 cooled homes (:mod:`experiments.studies.all_kinds`), and writes the table
of ``docs/gensets.md``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import typer

from benchmarks.frame.pages import markdown_table, put_into
from benchmarks.frame.paired import Estimate, by_seed
from benchmarks.frame.seeds import STUDIES, Days, FirstSeed, Jobs, Results, Span, run_seeds
from experiments.studies.all_kinds import with_all_kinds
from experiments.studies.outage_days import OutageClimate, draw_outage_day, with_outage_day
from experiments.studies.uncertain import worst
from vppres.contract.stored_value import StoredValue
from vppres.day.assembly import make_controller
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.outages import OutageView
from vppres.day.simulate import Day
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import Where

PAGE = Path(__file__).parents[2] / "docs" / "gensets.md"
BEGIN, END = "<!-- fuel: begin -->", "<!-- fuel: end -->"

TOGETHER = "together"
POLICIES = {TOGETHER: 1.0, "sets first": 0.0, "batteries first": 2.0}
"""How much a litre counts of what it stands for. One that counts nothing is burnt before a battery
is drawn, one that counts twice only where batteries do not suffice."""

LONG = OutageClimate(duration_median_h=6.0, duration_sigma=0.8)
"""Outages of which many last longer than the fuel, four hours."""

LATER = 1_000_000
"""Seeds between a day without an outage and the one that is drawn in its place."""


@dataclass(frozen=True, eq=False)
class CountedFuel(OutageView):
    """The value of stored energy, in which a litre counts more or less than it stands for."""

    factor: float = 1.0

    def _value(self, *known: Any) -> StoredValue:
        """The same at the fuel that is held now."""
        value, fuel = super()._value(*known), known[-1]["gensets"]
        uncounted_kwh = (1.0 - self.factor) * fuel.held_kwh
        kwh_each = {"gensets": self.factor * fuel.kwh_each}
        return replace(value.beside(uncounted_kwh), kwh_each=kwh_each)


@dataclass(frozen=True)
class Run:
    """What a policy made of a day."""

    seed: int  #: the day, the same for every policy
    policy: str  #: of :data:`POLICIES`
    resilience: float  #: R
    critical_lost_h: float  #: hours of critical customers without supply
    left_litres: float  #: fuel at the end of the day
    missed_kwh: float  #: what vehicles lacked when they left
    gap_max: float  #: largest relative gap of a window
    fallbacks: int  #: steps with a fallback


@cache
def base() -> Scenario:
    """The day with all kinds of assets and its grid."""
    day = with_all_kinds(0)
    return replace(day, grid_limit_kw=np.full(day.grid.n_steps, np.inf))


def day_of(seed: int) -> list[Run]:
    """All policies on a day with an outage."""
    drawn = draw_outage_day(seed, base().grid.start, LONG)
    while not drawn.outages:
        seed += LATER
        drawn = draw_outage_day(seed, base().grid.start, LONG)
    scenario = with_outage_day(base(), drawn, LONG)
    return [run_of(scenario, policy, seed % LATER) for policy in POLICIES]


def run_of(scenario: Scenario, policy: str, seed: int) -> Run:
    """A day under a policy."""
    options = RunOptions(outages="belief", isolate=False).on(scenario)
    day = Day(scenario, options)
    view = day.observer.outages
    known = {f.name: getattr(view, f.name) for f in fields(view)}
    counted = CountedFuel(**known, factor=POLICIES[policy])
    day.observer = replace(day.observer, outages=counted)
    run = day.run(make_controller(scenario, options))
    figures = summarise(run)
    critical = run.customers["tier"] == scenario.tiers[0]
    lost = critical & ~run.customers["served"].astype(bool)
    return Run(
        seed=seed,
        policy=policy,
        resilience=figures["resilience"],
        critical_lost_h=float(lost.sum()) * scenario.grid.dt_h,
        left_litres=figures["gensets"]["left_litres"],
        missed_kwh=figures["vehicles"]["missed_kwh"],
        gap_max=float(run.steps["gap"].max()),
        fallbacks=figures["fallbacks"],
    )


def table_of(runs: Sequence[Run]) -> str:
    """Means of each policy, and what it loses of R, paired by day."""
    rows = []
    best = by_seed(runs, lambda run: run.resilience, policy=TOGETHER)
    for policy in POLICIES:
        mine = by_seed(runs, lambda run: run.resilience, policy=policy)
        means = [
            f"{by_seed(runs, lambda run, n=name: getattr(run, n), policy=policy).mean():.{digits}f}"  # type: ignore[misc]
            for name, digits in (("critical_lost_h", 2), ("left_litres", 0), ("missed_kwh", 0))
        ]
        more = "" if policy == TOGETHER else Estimate.of(mine - best).text("+.4f")
        rows.append((policy, f"{mine.mean():.4f}", f"{worst(mine):.4f}", more, *means))
    return markdown_table(
        (
            "fuel and batteries",
            "R",
            "R of the worst 5%",
            "against together",
            "critical h lost",
            "fuel left, l",
            "missing in vehicles, kWh",
        ),
        rows,
    )


def main(days: Days = 60, seed: FirstSeed = 0, jobs: Jobs = -1, results: Results = STUDIES) -> None:
    """Fuel valued together with batteries, beside sets first and batteries first."""
    outcomes, lost = run_seeds(day_of, Span(seed, days), Where(jobs, None), results / "days")
    runs = [run for day in outcomes for run in day]
    table = table_of(runs)
    typer.echo(
        f"{table}\n{days} days, {len(lost)} lost; "
        f"largest gap {max(run.gap_max for run in runs):.1e}; "
        f"{sum(run.fallbacks for run in runs)} steps with a fallback."
    )
    put_into(PAGE, table, BEGIN, END)


if __name__ == "__main__":
    typer.run(main)
