"""Figure 2's four parts: resilience and cost of both controllers under forecast errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from experiments import ideal
from experiments.config import Config
from experiments.drawing import (
    FULL,
    LINES,
    MPC,
    PUBLISHED_RANGE,
    SPREAD,
    SPREAD_RANGE,
    STYLES,
    legend,
    panels,
)
from experiments.jobs import Day, Job
from experiments.published import STATEMENTS
from experiments.results import DayResult
from experiments.rows import Row, measured_all
from experiments.runner import Results
from vppres.contract.forecast import ForecastErrors
from vppres.core.arrays import Floats
from vppres.day.options import RunOptions
from vppres.report.plot import line_of

Quantity = Callable[[DayResult], float]

CONTROLLERS = {MPC: "mpc", FULL: "full-horizon"}
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Point:
    """Days of one controller at one error level."""

    level: float  #: bias, or growth of the standard deviation per hour
    days: Sequence[DayResult]  #: the packaged day, once for each seed of the errors
    #: The packaged day and further drawings of the unpublished data, one seed of errors each.
    drawings: Sequence[DayResult]

    def mean(self, quantity: Quantity) -> float:
        """Mean over the seeds."""
        return float(np.mean([quantity(day) for day in self.days]))

    def half_width(self, quantity: Quantity) -> float:
        """Half the 95 % confidence interval of the mean; zero where there is nothing to draw."""
        values = np.array([quantity(day) for day in self.days])
        error = stats.sem(values) if len(values) > 1 else 0.0
        return float(error * stats.t.ppf((1 + CONFIDENCE) / 2, max(len(values) - 1, 1)))

    def spread(self) -> Floats:
        """Resilience of every drawing, sorted."""
        return np.sort([day.resilience for day in self.drawings])


def jobs(config: Config) -> list[Job]:
    """All days of a figure: ideal ones, both controllers on every seed, further drawings."""
    return [
        ideal.mpc(5),
        ideal.FULL_HORIZON,
        *(
            job
            for level in config["levels"]
            for name in CONTROLLERS
            for job in (*_seeded(config, name, level), *_drawn(config, name, level))
        ),
    ]


def points(config: Config, results: Results, name: str) -> list[Point]:
    """One point for each level, the ideal day among them, in rising order."""
    perfect = results[ideal.mpc(5) if name == MPC else ideal.FULL_HORIZON]
    found = [Point(0.0, [perfect], [perfect])]
    for level in config["levels"]:
        days = [results[job] for job in _seeded(config, name, level)]
        drawn = [results[job] for job in _drawn(config, name, level)]
        found.append(Point(level, days, [days[0], *drawn]))
    return sorted(found, key=lambda point: point.level)


def figure(config: Config, results: Results, title: str, axis: str) -> Figure:
    """Resilience above, cost below, with confidence intervals and the spread over drawings."""
    picture, (above, below) = panels((3, 1.6), 6.2, title)
    for name in CONTROLLERS:
        found = points(config, results, name)
        _errorbars(
            above, found, resilience, LINES[name], "MPC" if name == MPC else "full horizon, actual"
        )
        _errorbars(below, found, cost_gbp, LINES[name], "_")
    full = points(config, results, FULL)
    _errorbars(above, full, planned, line_of(STYLES[FULL].thin()), "full horizon, planned")
    _draw_spread(above, full)
    _draw_published(above)
    above.set_ylabel("Resilience R")
    below.set_ylabel("Cost (GBP)")
    below.set_xlabel(axis)
    below.set_xticks([point.level for point in full])
    return legend(picture, above, 2)


def rows(config: Config, results: Results, case: str) -> list[Row]:
    """R13, R14 and R18 over the levels of one figure."""
    mpc, full = (_erroneous(config, results, name) for name in (MPC, FULL))
    means = [point.mean(resilience) for point in mpc]
    medians = [float(np.median(point.spread())) for point in full]
    gains = [ours / theirs - 1.0 for ours, theirs in zip(means, medians, strict=True)]
    levels = ", ".join(f"{point.level:g}" for point in mpc)
    case = f"{case} {levels}"
    return [
        measured_all("R13", means, ".3f", case, mpc[-1].days[0].evidence),
        measured_all("R14", medians, ".3f", case, lambda: spread_text(full)),
        measured_all("R18", gains, ".3f", case, lambda: spread_text(full)),
    ]


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    mpc, full = (_erroneous(config, results, name) for name in (MPC, FULL))
    of_mpc = [point.mean(resilience) for point in mpc]
    of_full = [point.mean(resilience) for point in full]
    of_plan = [point.mean(planned) for point in full]
    medians = [float(np.median(point.spread())) for point in full]
    return (
        f"On the packaged day the MPC keeps R = {_range(of_mpc)}; the full horizon promises "
        f"{_range(of_plan)} and reaches {_range(of_full)} "
        f"(median over {len(full[0].drawings)} drawings of the unpublished data: "
        f"{_range(medians)}). {_corrections_text(full)}"
    )


def resilience(day: DayResult) -> float:
    """Actual resilience."""
    return day.resilience


def planned(day: DayResult) -> float:
    """Resilience that the plan promised."""
    return float(day.summary["resilience_planned"])


def cost_gbp(day: DayResult) -> float:
    """Cost of the import."""
    return float(day.summary["cost_gbp"])


def stored_kwh(day: DayResult) -> float:
    """Energy with which the plan enters the outage."""
    return float(day.planned["energy_kwh"][day.steps["outage"].index(True)])


def selection_text(point: Point) -> str:
    """How much more the customers whom the plan serves need than it thought."""
    forecast, actual = (
        float(np.mean([_in_outage(day, name) for day in point.days]))
        for name in ("served_forecast_kw", "served_actual_kw")
    )
    return (
        f"at {point.level:g} those whom the plan serves in the outage were forecast to need "
        f"{forecast:,.0f} kWh and need {actual:,.0f}"
    )


def spread_text(found: Sequence[Point]) -> str:
    """Smallest and largest resilience over the drawings, for each level."""
    parts = [
        f"{point.spread()[0]:.3f} to {point.spread()[-1]:.3f} at {point.level:g}" for point in found
    ]
    return f"Spread over {len(found[0].drawings)} drawings: {'; '.join(parts)}."


def _erroneous(config: Config, results: Results, name: str) -> list[Point]:
    return [point for point in points(config, results, name) if point.level != 0.0]


def _seeded(config: Config, name: str, level: float) -> list[Job]:
    """The packaged day, once for each seed of the errors."""
    return [_job(config, name, level, seed) for seed in range(config["error_seeds"])]


def _drawn(config: Config, name: str, level: float) -> list[Job]:
    """Further drawings of the unpublished data, for the full horizon."""
    if name == MPC:
        return []
    return [
        _job(config, name, level, seed, Day(seed=seed))
        for seed in range(1, config["builder_seeds"] + 1)
    ]


def _job(config: Config, name: str, level: float, seed: int, day: Day | None = None) -> Job:
    errors = ForecastErrors(**{config["field"]: level})
    return Job(day or Day(), RunOptions(controller=CONTROLLERS[name], errors=errors, seed=seed))


def _errorbars(
    ax: Axes, found: Sequence[Point], quantity: Quantity, line: dict[str, Any], label: str
) -> None:
    """Means over the seeds with their confidence intervals."""
    levels = [point.level for point in found]
    ax.errorbar(
        levels,
        [point.mean(quantity) for point in found],
        yerr=[point.half_width(quantity) for point in found],
        marker="o",
        markersize=4,
        capsize=4,
        label=label,
        **line,
    )


def _draw_spread(ax: Axes, found: Sequence[Point]) -> None:
    """Every drawing as a dot, the range as a line."""
    shown = [point for point in found if len(point.drawings) > 1]
    for position, point in enumerate(shown):
        values = point.spread()
        levels = np.full(len(values), point.level)
        ax.plot(
            levels[[0, -1]],
            values[[0, -1]],
            color=SPREAD_RANGE,
            linewidth=6,
            zorder=1,
            solid_capstyle="butt",
        )
        ax.scatter(
            levels,
            values,
            s=9,
            color=SPREAD,
            zorder=2,
            label="_" if position else "full horizon, drawings of the unpublished data",
        )
        ax.scatter(
            point.level,
            np.median(values),
            marker="_",
            s=160,
            color=SPREAD,
            linewidths=2.0,
            label="_" if position else "their median",
        )


def _draw_published(ax: Axes) -> None:
    """Shade the published ranges of both controllers."""
    for position, id in enumerate(("R13", "R14")):
        low = STATEMENTS[id].low
        high = STATEMENTS[id].high
        if low is not None and high is not None:
            ax.axhspan(
                low,
                high,
                color=PUBLISHED_RANGE,
                zorder=0,
                label="_" if position else "published ranges",
            )


def _in_outage(day: DayResult, name: str) -> float:
    """A planned power summed over the outage (kWh: the steps are hours)."""
    return float(np.array(day.planned[name])[day.series("outage") > 0].sum())


def _corrections_text(found: Sequence[Point]) -> str:
    """How often the plan is overruled, and before the outage how often."""
    days = [day for point in found for day in point.days]
    first = days[0].steps["outage"].index(True)
    number = [len(day.corrected_hours) for day in days]
    early = [sum(hour < first for hour in day.corrected_hours) for day in days]
    return (
        f"The plan is overruled in {np.mean(number):.1f} of 24 hours on average, "
        f"{np.mean(early):.1f} of them before the outage."
    )


def _range(values: Sequence[float]) -> str:
    low = min(values)
    high = max(values)
    return f"{low:.3f}" if high - low < 5e-4 else f"{low:.3f} to {high:.3f}"
