"""Cost against buses, horizon and step length, with fitted exponents, memory and stages."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from rich.progress import Progress
from scipy import stats

from benchmarks.clock import Clock, in_fresh_process, limit_memory, peak_memory_mb, watched
from benchmarks.feeders import FEEDERS, feeder_scenario, with_days, with_step
from benchmarks.frame.store import Row, Store
from benchmarks.instances import packaged
from vppres.core.errors import SolveError
from vppres.kinds.customer.physics import Owed
from vppres.model.data import WindowData
from vppres.model.parts import Parts
from vppres.model.site import Site
from vppres.report.plots.drawing import BLUE, GREY, RULE_COLOUR
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

Axis = Literal["buses", "steps", "minutes"]

SIZES: dict[Axis, tuple[int, ...]] = {
    "buses": tuple(FEEDERS),
    "steps": (1, 2, 3, 6, 12, 24, 48, 96),
    "minutes": (60, 15, 5),
}
QUICK_SIZES: dict[Axis, tuple[int, ...]] = {
    "buses": (33, 69, 115),
    "steps": (1, 3, 6),
    "minutes": (60, 15),
}
SHOWN_STEPS = (1, 3, 6, 12, 24, 48, 72, 96)
"""Numbers of steps that the figure names."""
H5_HOURS = 6
FIRST_HOURS = (8, 10, 12)
"""Windows begin before and at the outage of 12:00: all of them meet it."""
STATES = (0.35, 0.6)
"""Mean states of charge."""
DRAWS = 4
"""Windows of each hour and mean state: 24 in all."""
FEW: dict[tuple[Axis, int], int] = {("buses", 2993): 6, ("buses", 9997): 2, ("minutes", 5): 6}
"""Windows of the points that are too large for as many."""
CONFIDENCE = 0.95
STEP_LIMIT_S = 8.0
"""Time limit along the buses: a step may take 10 s, and what has begun by then is ended."""
LIMITS_S = {2993: 27.0, 9997: 110.0}
"""The same of the largest feeders, which may take 30 s and 120 s."""
FITTED_BUSES = 1021
"""Buses up to which the exponent is fitted: larger feeders are not solved to the same gap."""
DAYS = 6
"""Days in a row along the horizon: 96 steps begin in the first two."""
OUT_OF_MEMORY = "out of memory"


@dataclass(frozen=True)
class Case:
    """One point of an axis; ``size`` is in the axis's unit."""

    axis: Axis
    size: int
    time_s: float

    def scenario(self) -> Scenario:
        """The scenario of the point."""
        if self.axis == "buses":
            return feeder_scenario(self.size)
        if self.axis == "steps":
            return with_days(packaged(), DAYS)
        return with_step(packaged(), self.size)

    def n_steps(self, day: Scenario) -> int:
        """Steps of the point's windows: H = 5 except along the horizon."""
        return self.size if self.axis == "steps" else round(H5_HOURS / day.grid.dt_h)


def windows_of(case: Case, day: Scenario) -> list[WindowData]:
    """Windows of a point, in random states; the first few of a large feeder."""
    b = day.batteries
    rng = np.random.default_rng(case.size)
    steps = case.n_steps(day)
    delta = np.zeros((steps, day.network.n_lines))
    found = []
    for _, mean, hour in product(range(DRAWS), STATES, FIRST_HOURS):
        first = round(hour / day.grid.dt_h)
        rows = slice(first, first + steps)
        found.append(
            WindowData(
                day.load_kw[rows],
                day.pv_kw[rows],
                day.price_gbp_per_kwh[rows],
                day.grid_limit_kw[rows],
                rng.uniform(mean - 0.1, mean + 0.1, len(b)),
                b.eta_charge,
                b.eta_discharge,
                delta,
                owed=Owed.of(day.customers, day.grid.dt_h),
                parts=Parts.one(day.network, len(b), steps),
            )
        )
    return found[: FEW.get((case.axis, case.size), len(found))]


def measure(case: Case) -> Row:
    """Compilation, solves, memory and stages of one point, in this process."""
    limit_memory()
    day = case.scenario()
    solver = WindowSolver(Site.of(day), limits=SolveLimits(time_s=case.time_s))
    windows = windows_of(case, day)
    solved = []
    first = _timed(solver, windows[0])
    with watched() as clock:
        begin = time.perf_counter()
        solved = [_timed(solver, data) for data in windows]
        wall_s = time.perf_counter() - begin
    seconds = [row["solve_s"] for row in solved]
    return {
        "n_steps": case.n_steps(day),
        "windows": len(windows),
        "certified": sum(row["status"] == "optimal" for row in solved),
        "first_s": first["solve_s"],
        "median_s": float(np.median(seconds)),
        "mean_s": float(np.mean(seconds)),
        "p95_s": float(np.quantile(seconds, 0.95)),
        "max_s": max(seconds),
        "gap_max": max(row["gap"] for row in solved),
        "memory_mb": peak_memory_mb(),
        "library_share": clock.library_s / wall_s,
        "stages_s": dict(clock.stages_s),
        "main_stage": _largest(clock),
    }


def _point(case: Case) -> Row:
    """A point in a process of its own, or a row without times where memory does not suffice."""
    try:
        return in_fresh_process(measure, case)
    except (MemoryError, BrokenProcessPool):
        return {
            "n_steps": case.n_steps(case.scenario()),
            "windows": 0,
            "certified": 0,
            "main_stage": OUT_OF_MEMORY,
            "stages_s": {},
        }


def _timed(solver: WindowSolver, data: WindowData) -> Row:
    """Processor's time and status of a window; one without answer counts with the limit at least.

    A process has one thread, so that on a quiet machine the clock on the wall says the same.
    """
    begin = time.process_time()
    try:
        answer = solver.solve(data)
    except SolveError as error:
        spent_s = max(time.process_time() - begin, solver.limits.time_s)
        return {"solve_s": spent_s, "status": type(error).__name__, "gap": np.inf}
    spent_s = time.process_time() - begin
    return {"solve_s": spent_s, "status": str(answer.status), "gap": answer.gap}


def _largest(clock: Clock) -> str:
    return max(clock.stages_s, key=lambda stage: clock.stages_s[stage], default="")


def run_scaling(
    folder: Path,
    sizes: dict[Axis, tuple[int, ...]],
    time_s: float,
    processes: int,
    bar: Progress,
) -> pd.DataFrame:
    """One row for each point, each measured in a process of its own, some at the same time."""
    cases = [
        Case(axis, size, _limit_s(axis, size, time_s))
        for axis, values in sizes.items()
        for size in values
    ]
    task = bar.add_task("scaling", total=len(cases))
    store = Store(folder / "rows")

    def row(case: Case) -> Row:
        key = {"axis": case.axis, "size": case.size, "time_s": case.time_s}
        found = store.row(key, partial(_point, case))
        bar.advance(task)
        return found

    with ThreadPoolExecutor(processes) as pool:
        return pd.DataFrame(list(pool.map(row, cases)))


def _limit_s(axis: Axis, size: int, time_s: float) -> float:
    """Time limit of a point."""
    if axis != "buses":
        return time_s
    return LIMITS_S.get(size, min(time_s, STEP_LIMIT_S))


@dataclass(frozen=True)
class Exponent:
    """Least-squares fit of ``seconds = a size^b`` in logarithms.

    ``low`` and ``high`` bound the exponent at 95 % (Student's t), NaN with two points.
    """

    value: float
    low: float
    high: float
    points: int


def exponent(size: np.ndarray, seconds: np.ndarray) -> Exponent:
    """Fit the exponent of a power law.

    Examples
    --------
    >>> fit = exponent(np.array([1.0, 2.0, 4.0]), np.array([3.0, 12.0, 48.0]))
    >>> round(fit.value, 6), fit.points
    (2.0, 3)
    """
    fit = stats.linregress(np.log(size), np.log(seconds))
    free = len(size) - 2
    half = stats.t.ppf((1 + CONFIDENCE) / 2, free) * fit.stderr if free > 0 else np.nan
    return Exponent(float(fit.slope), float(fit.slope - half), float(fit.slope + half), len(size))


def exponents(rows: pd.DataFrame) -> pd.DataFrame:
    """Exponents of the mean and the median time, of compilation and of memory, by axis.

    Along the step length the size is the number of steps.
    """
    found = []
    fitted = (rows["windows"] > 0) & ((rows["axis"] != "buses") | (rows["size"] <= FITTED_BUSES))
    for axis, part in rows[fitted].groupby("axis", sort=False):
        size = part["size"] if axis == "buses" else part["n_steps"]
        for quantity in ("median_s", "mean_s", "first_s", "memory_mb"):
            fit = exponent(size.to_numpy(float), part[quantity].to_numpy(float))
            found.append(
                {
                    "axis": axis,
                    "quantity": quantity,
                    "exponent": fit.value,
                    "low": fit.low,
                    "high": fit.high,
                    "points": fit.points,
                }
            )
    return pd.DataFrame(found)


def draw_scaling(rows: pd.DataFrame) -> Figure:
    """Time against size on both logarithmic axes, one panel for each axis."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    names = {"buses": "buses, H = 5", "steps": "steps of 1 h", "minutes": "steps, H = 5"}
    axes = figure.subplots(1, rows["axis"].nunique(), squeeze=False)[0]
    for ax, (axis, part) in zip(axes, rows.groupby("axis", sort=False), strict=True):
        size = part["size"] if axis == "buses" else part["n_steps"]
        ax.loglog(size, part["median_s"], color=BLUE, marker="o", label="median")
        ax.loglog(size, part["max_s"], color=GREY, marker="v", linestyle=":", label="largest")
        ax.set_xlabel(names[str(axis)])
        if axis != "buses":  # few sizes: their own numbers, no powers of ten
            shown = size[size.isin(SHOWN_STEPS)]
            ax.set_xticks(shown, [f"{n:g}" for n in shown], minor=False)
            ax.xaxis.set_minor_locator(NullLocator())
        ax.grid(True, color=RULE_COLOUR, linewidth=0.5)
    axes[0].set_ylabel("Time of a window (s)")
    axes[0].legend(frameon=False)
    return figure
