"""Two weeks of outages with each rule of sharing supply within a tier, and what each costs.

``python -m experiments.studies.fairness`` runs the packaged feeder with outages on nearly every
day, which the controller knows for five hours ahead, and prints the table of
``docs/howto/priorities.md``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.seeds import STUDIES, Span, run_seeds
from experiments.studies.outage_days import OutageClimate, draw_outage_day
from vppres.day.inversions import inversions
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.reliability import fairness_figures
from vppres.day.simulate import run_day
from vppres.io.find import load_scenario
from vppres.scenario.outage_warnings import OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.studies.side_by_side import Where

DAYS = 7
CLIMATE = OutageClimate(warned=1.0, comes=0.99, duration_median_h=5.5)
"""An outage on nearly every day, of the length of a storm's."""

RULES: dict[str, dict[str, Any]] = {
    "weights": {},
    "weights, rotation 0.2": {"rotation": 0.2},
    "weights, rotation 1": {"rotation": 1.0},
    "weights, minimum 1 h": {"minimum_on_h": 1.0},
    "strict": {"priority": "strict"},
    "strict, rotation 0.2": {"priority": "strict", "rotation": 0.2},
}


@dataclass(frozen=True)
class Week:
    """What came of a week with a rule."""

    rule: str  #: name of the rule
    week: int  #: seed of the week
    outage_h: float  #: hours without grid
    resilience: float  #: R of the week
    #: By tier, hours of the customer that was off longest, and the Gini coefficient.
    longest_h: dict[str, float]
    gini: dict[str, float]
    inversions: int  #: customers and hours off while a lower tier took what they needed
    relaxed: int  #: steps in which a minimum could not be kept
    fallbacks: int  #: steps that a fallback decided


def week_of(day: Scenario, week: int) -> Scenario:
    """Seven times a day of hours, with outages and warnings of their own."""
    grid = replace(day.grid, n_steps=DAYS * day.grid.n_steps)
    series: dict[str, Any] = {
        name: np.concatenate([value] * DAYS) for name, value in day.series.items()
    }
    limit_kw = np.full(grid.n_steps, np.inf)
    warnings: list[OutageWarning] = []
    for k in range(DAYS):
        midnight = grid.start + pd.Timedelta(days=k)
        drawn = draw_outage_day(DAYS * week + k, midnight, CLIMATE)
        warnings += drawn.warnings
        for outage in drawn.outages:
            steps = [24 * k + hour for hour in outage.steps if 24 * k + hour < grid.n_steps]
            limit_kw[steps] = 0.0
    return replace(
        day,
        grid=grid,
        **series | {"grid_limit_kw": limit_kw},
        warnings=tuple(sorted(warnings, key=lambda one: one.issued_at)),
        outage_statistics=CLIMATE.statistics,
    )


def week_with_rule(seed: int) -> Week:
    """The week and the rule that a seed names: rules of one week follow each other."""
    week, place = divmod(seed, len(RULES))
    name = list(RULES)[place]
    scenario = week_of(load_scenario("uk-heatwave-2022"), week)
    run = run_day(scenario, RunOptions(**RULES[name]))
    found = fairness_figures(run)
    return Week(
        rule=name,
        week=week,
        outage_h=float(scenario.outage.sum()) * scenario.grid.dt_h,
        resilience=float(summarise(run)["resilience"]),
        longest_h={tier: (m or 0.0) / 60.0 for tier, m in found["minutes_off_max"].items()},
        gini={tier: g or 0.0 for tier, g in found["minutes_off_gini"].items()},
        inversions=len(inversions(run)),
        relaxed=int(run.steps["switching_relaxed"].astype(bool).sum()),
        fallbacks=int((run.steps["fallback"] != "none").sum()),
    )


def table_of(weeks: list[Week]) -> pd.DataFrame:
    """A row for each rule and week: R, its price, the longest time off and Gini by tier."""
    first = {one.week: one.resilience for one in weeks if one.rule == next(iter(RULES))}
    rows = [
        {
            "week": f"{one.week}, {one.outage_h:.0f} h",
            "rule": one.rule,
            "R": f"{one.resilience:.4f}",
            "price": f"{one.resilience - first.get(one.week, np.nan):+.4f}",
            **{f"longest, {tier}": f"{hours:.0f} h" for tier, hours in one.longest_h.items()},
            **{f"Gini, {tier}": f"{gini:.2f}" for tier, gini in one.gini.items()},
            "inversions": one.inversions,
            "not kept": one.relaxed,
            "fallbacks": one.fallbacks,
        }
        for one in sorted(weeks, key=lambda one: (one.week, list(RULES).index(one.rule)))
    ]
    return pd.DataFrame(rows)


def main(
    weeks: Annotated[int, typer.Option(min=1, help="Number of weeks.")] = 2,
    jobs: Annotated[int, typer.Option(help="Weeks at a time; -1 is one for each core.")] = 1,
    results: Annotated[Path, typer.Option(metavar="DIR", help="Folder of finished weeks.")] = (
        STUDIES / "fairness"
    ),
) -> None:
    """Run the weeks with each rule, and print the table."""
    span = Span(0, weeks * len(RULES))
    found, _ = run_seeds(week_with_rule, span, Where(jobs), results)
    table = table_of(found)
    typer.echo(markdown_table([str(name) for name in table], table.to_numpy().tolist()))


if __name__ == "__main__":
    typer.run(main)
