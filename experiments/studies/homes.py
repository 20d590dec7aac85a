"""What real forecasts cost: days of 17 homes with perfect ones, and with those of their history.

``python -m experiments.studies.homes --days 60``
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.paired import Estimate, by_seed
from benchmarks.frame.seeds import Study, report
from data.homes.build import HELD_OUT, homes
from experiments.drawing import draw_grid
from experiments.report import machine
from vppres.core.arrays import Floats
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.report.plots.drawing import BLUE
from vppres.scenario.scenario import Scenario

FORECASTERS = {
    "paper": "perfect forecasts",
    "seasonal": "seasonal",
    "climatology": "hour of day",
}
HORIZON_H = 12.0
DAYS = 120
"""Days of the held-out months; the next seeds take them again, with other outages."""
PACE = 7
"""Consecutive seeds are as many days apart: a few of them see all the months."""
ONSETS_H = (6, 20)
LENGTHS_H = (4, 10)
HOURS = 30
"""Of a day from midnight on, and the night behind it: what is left in store then counts as well."""


@dataclass(frozen=True)
class Run:
    """What a forecaster led to on a day."""

    seed: int  #: the day, the same for every forecaster
    forecaster: str  #: who forecast
    #: Of the day as it happened.
    resilience: float
    net_cost_gbp: float
    critical_share: float  #: share of critical customers served in the outage
    unserved_kwh: float  #: demand that was not served in the outage
    fallbacks: int  #: steps with a fallback
    process_s: float  #: processor time


def day_of(seed: int) -> Scenario:
    """A held-out day with an outage that is known from midnight on."""
    rng = np.random.default_rng([seed, 1717])
    onset = int(rng.integers(*ONSETS_H))
    length = int(rng.integers(*LENGTHS_H))
    start = HELD_OUT + pd.Timedelta(days=PACE * seed % DAYS)
    return homes(start, HOURS, (onset, onset + length))


def run_seed(seed: int) -> list[Run]:
    """All forecasters on one day."""
    day = day_of(seed)
    runs = []
    for forecaster in FORECASTERS:
        begin = time.process_time()
        run = run_day(day, RunOptions(forecaster=forecaster, horizon_h=HORIZON_H))
        figures = summarise(run)
        off = ~run.customers["served"].to_numpy(bool)
        runs.append(
            Run(
                seed,
                forecaster,
                figures["resilience"],
                figures["net_cost_gbp"],
                figures["served_share"][day.tiers[0]],
                float(run.customers["p_load_kw"].to_numpy(float)[off].sum() * day.grid.dt_h),
                figures["fallbacks"],
                time.process_time() - begin,
            )
        )
    return runs


def column(runs: Sequence[Run], forecaster: str, value: Callable[[Run], float]) -> Floats:
    """A value of each day of a forecaster, in the order of the seeds."""
    return by_seed(runs, value, forecaster=forecaster)


def figure(runs: Sequence[Run]) -> Figure:
    """What each forecaster costs against perfect forecasts, day by day."""
    drawn = Figure(figsize=(8.0, 3.4), layout="constrained")
    axes = drawn.subplots(1, 2, sharey=True)
    values: dict[str, Callable[[Run], float]] = {
        "resilience lost to perfect forecasts": lambda run: -run.resilience,
        "cost above perfect forecasts (GBP)": lambda run: run.net_cost_gbp,
    }
    names = [name for name in FORECASTERS if name != "paper"][::-1]
    for ax, (label, value) in zip(axes, values.items(), strict=True):
        best = column(runs, "paper", value)
        for row, name in enumerate(names):
            found = column(runs, name, value) - best
            mean = Estimate.of(found)
            ax.plot(found, np.full(len(found), row - 0.2), ".", color="#8A8A8A", markersize=4)
            ax.errorbar(
                mean.mean,
                row,
                xerr=[[mean.mean - mean.low], [mean.high - mean.mean]],
                fmt="o",
                color=BLUE,
                capsize=4,
            )
        ax.axvline(0.0, color="#000000", linewidth=0.8)
        ax.set_xlabel(label)
        draw_grid(ax, axis="x")
    axes[0].set_yticks(range(len(names)), [FORECASTERS[name] for name in names])
    axes[0].set_ylim(-0.6, len(names) - 0.5)
    return drawn


def write_report(days: Sequence[list[Run]], wall_s: float, folder: Path) -> Path:
    """Write figure, ``homes.json``, ``.md`` and ``.html``; returns the Markdown file."""
    runs = [run for day in days for run in day]
    title, text = "What real forecasts cost", _text(runs, wall_s)
    return report(folder / "homes", title, text, runs, wall_s, figure(runs))


def _text(runs: Sequence[Run], wall_s: float) -> str:
    """The report in words and a table."""
    resilience = column(runs, "paper", lambda run: run.resilience)
    cost = column(runs, "paper", lambda run: run.net_cost_gbp)
    rows = []
    for name, words in FORECASTERS.items():
        served = column(runs, name, lambda run: run.resilience)
        paid = column(runs, name, lambda run: run.net_cost_gbp)
        rows.append(
            (
                words,
                Estimate.of(served).text(".4f"),
                Estimate.of(resilience - served).text(".4f"),
                Estimate.of(paid).text(".2f"),
                Estimate.of(paid - cost).text(".2f"),
                f"{column(runs, name, lambda run: run.critical_share).mean():.4f}",
                f"{column(runs, name, lambda run: run.unserved_kwh).mean():.1f}",
                f"{column(runs, name, lambda run: run.process_s).mean():.1f}",
            )
        )
    head = (
        "forecasts",
        "resilience",
        "lost to perfect",
        "net cost (GBP)",
        "above perfect (GBP)",
        "critical served",
        "not served (kWh)",
        "processor time (s)",
    )
    return "\n\n".join(
        [
            markdown_table(head, rows),
            "![Lost to perfect forecasts](homes.svg)",
            f"Means over {len(resilience)} days with 95 % intervals (bootstrap over the days): "
            f"{HOURS} h of the held-out months each, with an outage of {LENGTHS_H[0]} to "
            f"{LENGTHS_H[1] - 1} h that is known from midnight on, MPC of {HORIZON_H:g} h in "
            "the paper's mode on the full network. Every forecaster sees the same days, and none "
            "a step that is to come. "
            f"Steps with a fallback: {sum(run.fallbacks for run in runs)}. Wall time "
            f"{wall_s / 60:.1f} min, {machine()}.",
        ]
    )


STUDY = Study(run_seed, write_report, width=120)


main = STUDY.command(days=60, words="Run days of the homes with perfect and with real forecasts.")


if __name__ == "__main__":
    typer.run(main)
