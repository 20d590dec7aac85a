"""The MPC beside what it has to beat, on the same days: no control, a reserve, plans of the day.

``python -m experiments.studies.baselines --days 50``
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
from matplotlib.figure import Figure

import data.uk_heatwave_2022.build as builder
from benchmarks.frame.pages import markdown_table
from benchmarks.frame.paired import Estimate, by_seed
from benchmarks.frame.seeds import Study, report
from experiments.drawing import draw_grid
from experiments.jobs import Day, scenario
from experiments.report import machine
from experiments.studies.random_days import DRAWINGS
from vppres.contract.forecast import ForecastErrors
from vppres.core.arrays import Floats
from vppres.day.metrics import summarise
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.report.plots.drawing import BLUE

CONTROLLERS = {
    "mpc": "MPC, H = 5 h",
    "full-horizon": "full horizon",
    "reserve": "reserve by rule",
    "idle": "no control",
    "perfect": "perfect information",
}
TABLE_WIDTH = 120


@dataclass(frozen=True)
class Run:
    """What a controller made of a day."""

    seed: int  #: the day, the same for every controller
    controller: str  #: who decided
    #: Of the day as it happened.
    resilience: float
    cost_gbp: float
    critical_share: float  #: share of critical customers served in the outage
    #: What the certificates leave open of a plan's service in the outage, as resilience; NaN where
    #: nothing was proven.
    resilience_gap: float
    fallbacks: int  #: steps with a fallback
    process_s: float  #: processor time


def errors_of(seed: int) -> ForecastErrors:
    """Forecast errors of a day: random biases, and random errors that grow with the distance."""
    rng = np.random.default_rng([seed, 4004])
    return ForecastErrors(float(rng.uniform(-0.1, 0.1)), 0.05, float(rng.uniform(-0.2, 0.2)), 0.05)


def run_seed(seed: int) -> list[Run]:
    """All controllers on one day: a drawing of the paper's, with its outage."""
    day = scenario(Day(seed=builder.SEED + seed % DRAWINGS))
    outage_h = float(day.outage.sum() * day.grid.dt_h)
    whole = float(day.customers.weight.sum()) * outage_h
    runs = []
    for controller in CONTROLLERS:
        begin = time.process_time()
        run = run_day(day, RunOptions(controller=controller, errors=errors_of(seed), seed=seed))
        figures = summarise(run)
        runs.append(
            Run(
                seed,
                controller,
                figures["resilience"],
                figures["cost_gbp"],
                figures["served_share"][day.tiers[0]],
                float(run.steps["gap_service"].max()) / whole,
                figures["fallbacks"],
                time.process_time() - begin,
            )
        )
    return runs


def column(runs: Sequence[Run], controller: str, value: Callable[[Run], float]) -> Floats:
    """A value of each day of a controller, in the order of the seeds."""
    return by_seed(runs, value, controller=controller)


def figure(runs: Sequence[Run]) -> Figure:
    """Resilience and cost of every controller: every day as a dot, mean and interval beside."""
    drawn = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = drawn.subplots(1, 2, sharey=True)
    values: Mapping[str, Callable[[Run], float]] = {
        "resilience": lambda run: run.resilience,
        "cost of imported energy (GBP)": lambda run: run.cost_gbp,
    }
    names = list(CONTROLLERS)[::-1]
    for ax, (label, value) in zip(axes, values.items(), strict=True):
        for row, name in enumerate(names):
            found = column(runs, name, value)
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
        ax.set_xlabel(label)
        draw_grid(ax, axis="x")
    axes[0].set_yticks(range(len(names)), [CONTROLLERS[name] for name in names])
    days = len({run.seed for run in runs})
    drawn.suptitle(
        f"The same {days} days: every day (grey), mean and 95 % interval (blue)", fontsize=11
    )
    return drawn


def write_report(runs: Sequence[Run], wall_s: float, folder: Path) -> Path:
    """Write figure, ``baselines.json``, ``.md`` and ``.html``; returns the Markdown file."""
    title, text = "The MPC beside the baselines", _text(runs, wall_s)
    return report(folder / "baselines", title, text, runs, wall_s, figure(runs))


def _text(runs: Sequence[Run], wall_s: float) -> str:
    """The report in words and a table."""
    best = column(runs, "perfect", lambda run: run.resilience)
    rows = []
    for name, words in CONTROLLERS.items():
        served = column(runs, name, lambda run: run.resilience)
        rows.append(
            (
                words,
                Estimate.of(served).text(".4f"),
                Estimate.of(best - served).text(".4f"),
                Estimate.of(column(runs, name, lambda run: run.cost_gbp)).text(",.0f"),
                f"{column(runs, name, lambda run: run.critical_share).mean():.3f}",
                f"{column(runs, name, lambda run: run.process_s).mean():.1f}",
            )
        )
    gap = column(runs, "perfect", lambda run: run.resilience_gap).max()
    fallbacks = sum(run.fallbacks for run in runs)
    return "\n\n".join(
        [
            markdown_table(
                (
                    "controller",
                    "resilience",
                    "regret to perfect information",
                    "cost (GBP)",
                    "critical served",
                    "processor time of a day (s)",
                ),
                rows,
            ),
            "![Resilience and cost](baselines.svg)",
            f"Means over {len(best)} days with 95 % intervals (bootstrap over the days). A day "
            "is one "
            f"of {DRAWINGS} drawings of the paper's, with its outage; load and PV forecasts have "
            "random biases (up to 10 % and 20 %) and random errors (5 % per hour). Perfect "
            "information "
            "is the full horizon on the actual day; what its certificates leave open is at most "
            f"{gap:.1e} of resilience. Steps with a fallback: {fallbacks}. Wall time "
            f"{wall_s / 60:.1f} min, {machine()}.",
        ]
    )


def _report(days: Sequence[list[Run]], wall_s: float, folder: Path) -> Path:
    return write_report([run for day in days for run in day], wall_s, folder)


STUDY = Study(run_seed, _report, width=TABLE_WIDTH)


main = STUDY.command(days=50, words="Run the MPC and the baselines on the same days.")


if __name__ == "__main__":
    typer.run(main)
