"""Foreign feeders without an outage: who is off while the grid is on, and how loaded lines are.

``python -m experiments.studies.with_grid --folder ../shared/networks``. Each network runs on random
days: loads of each customer are drawn around the source's, batteries and PV systems are invented. A
day runs with hard voltage limits and ratings that are only reported, and as new scenarios begin.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from benchmarks.pages import markdown_table, write_pages
from experiments.studies.networks import CURES, Candidate, candidates
from experiments.studies.seeds import PATIENT, STUDIES
from vppres.core.errors import InputError
from vppres.day.metrics import line_loading, summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.feeders import import_network
from vppres.feeders.feeder import ImportedFeeder
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.scenario.scenario import HARD, LIMIT, REPORT, SOFT, Scenario

STEP_MINUTES = 240.0
HORIZON_H = 8.0
LOAD_FACTORS = (0.7, 1.3)
SPREAD = 0.3
MOST_BUSES = 150
AN_OUTAGE = (pd.Timestamp("2025-07-01T00:00Z"), pd.Timestamp("2025-07-01T04:00Z"))
RULES = {
    "hard": RunOptions(horizon_h=HORIZON_H, voltage_limits=HARD, ratings=REPORT, limits=PATIENT),
    "new": RunOptions(horizon_h=HORIZON_H, voltage_limits=SOFT, ratings=LIMIT, limits=PATIENT),
}
OFF = "Off with the grid on: "


@dataclass(frozen=True)
class Day:
    """One random day of a network by one rule."""

    #: Which day.
    label: str
    seed: int
    rule: str
    #: How many there are, and how many were off in any step.
    customers: int
    off: int
    said: bool  #: whether the first line of the run names those that were off
    v_min_pu: float  #: lowest AC voltage
    loading: float | None  #: largest AC current as a share of a rating; None where no line has one
    fallbacks: int  #: steps with a fallback
    solve_s: float  #: time of all decisions


def feeder_of(candidate: Candidate) -> ImportedFeeder | None:
    """The feeder with the options that refusals name, None where it cannot be imported."""
    chosen: dict[str, Any] = {}
    while True:
        try:
            return import_network(candidate.make(), candidate.source, **chosen)
        except InputError as error:
            text = str(error)
            cure = next((c for c in CURES if c[0] in text and not c[1].keys() & chosen), None)
            if cure is None:
                return None
            chosen |= cure[1]


def random_day(feeder: ImportedFeeder, seed: int) -> Scenario:
    """A day without outage, with drawn loads, PV at most customers and a battery at each."""
    rules = NewScenarioOptions(
        step_minutes=STEP_MINUTES,
        outages=(AN_OUTAGE,),
        pv="sized",
        add_batteries=seed % 2 == 1,
        draw_tiers=True,
        accept_deviation=True,
        seed=seed,
    )
    day = new_scenario(feeder, rules)
    rng = np.random.default_rng(seed)
    level = rng.uniform(*LOAD_FACTORS)
    each = rng.lognormal(0.0, SPREAD, day.load_kw.shape)
    return replace(
        day, load_kw=day.load_kw * level * each, grid_limit_kw=np.full(day.grid.n_steps, np.inf)
    )


def ran(label: str, day: Scenario, seed: int, rule: str) -> Day:
    """A day by a rule."""
    run = run_day(day, RULES[rule])
    summary = summarise(run)
    off = run.customers.loc[~run.customers["served"].astype(bool), "id"].nunique()
    loading = line_loading(run)
    return Day(
        label,
        seed,
        rule,
        len(day.customers),
        int(off),
        any(words.startswith(OFF) for words in summary["cautions"]),
        float(summary["v_min_ac_pu"]),
        float(np.nanmax(loading)) if np.isfinite(loading).any() else None,
        int(summary["fallbacks"]),
        float(summary["solve_s"]["total"]),
    )


def days(folder: Path, only: str, seeds: int) -> Iterator[Day]:
    """All days of all networks that are not too large."""
    for candidate in candidates(folder):
        if not re.search(only, candidate.label) or candidate.source == "simbench":
            continue
        feeder = feeder_of(candidate)
        if feeder is None or feeder.network.n_buses > MOST_BUSES:
            continue
        for seed in range(seeds):
            day = random_day(feeder, seed)
            for rule in RULES:
                if rule == "hard" and day.phases:
                    continue  # of a phased feeder only soft limits are stated
                found = ran(candidate.label, day, seed, rule)
                typer.echo(" ".join(map(str, asdict(found).values())))
                yield found


def row(label: str, found: list[Day]) -> tuple[str, ...]:
    """A network's days in words: hard limits, then the limits of new scenarios."""
    cells = [label, str(found[0].customers)]
    for rule in RULES:
        of_rule = [day for day in found if day.rule == rule]
        lowest = min((day.v_min_pu for day in of_rule), default=float("nan"))
        loadings = [day.loading for day in of_rule if day.loading is not None]
        cells += [
            ", ".join(str(day.off) for day in of_rule),
            f"{lowest:.3f}",
            f"{max(loadings):.3f}" if loadings else "none",
        ]
    new = [day for day in found if day.rule == "new"]
    silent = sum(bool(day.off) and not day.said for day in new)
    return (*cells, str(silent), str(sum(day.fallbacks for day in new)))


def main(
    folder: Annotated[Path, typer.Option(help="Folder of opendss/ and matpower/.")] = Path(
        "../shared/networks"
    ),
    results: Annotated[Path, typer.Option(help="Folder of the tables.")] = STUDIES,
    only: Annotated[str, typer.Option(help="Pattern of the names to try.")] = "",
    seeds: Annotated[int, typer.Option(help="Random days of each network.")] = 2,
) -> None:
    """Run all days, and write the table."""
    found = list(days(folder, only, seeds))
    head = (
        "network",
        "customers",
        "off, hard",
        "lowest pu",
        "loading",
        "off, new",
        "lowest pu",
        "loading",
        "off in silence",
        "fallbacks",
    )
    labels = dict.fromkeys(day.label for day in found)
    rows = [row(label, [day for day in found if day.label == label]) for label in labels]
    text = markdown_table(head, rows)
    record = {"days": [asdict(day) for day in found]}
    write_pages(results, "with-grid", "Foreign feeders with the grid on", text, record)


if __name__ == "__main__":
    typer.run(main)
