"""All figures by name, and their files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from vppres.day.trajectory import Trajectory
from vppres.report.plots.base import Runs, save_figure
from vppres.report.plots.energy import energy_and_price, import_load_pv, voltages
from vppres.report.plots.feeder import feeder_maps, line_loadings, solve_times
from vppres.report.plots.outages import has_beliefs, outage_belief
from vppres.report.plots.service import service_by_tier
from vppres.report.plots.strips import timeline

# Figures of one run or of several.
FIGURES: dict[str, Callable[[Runs], Figure]] = {
    "energy_and_price": energy_and_price,
    "import_load_pv": import_load_pv,
    "voltages": voltages,
    "service_by_tier": service_by_tier,
    "line_loadings": line_loadings,
    "solve_times": solve_times,
}

# Figures of one run alone.
RUN_FIGURES: dict[str, Callable[[Trajectory], Figure]] = {
    "timeline": timeline,
    "feeder_maps": feeder_maps,
}

# Figures of one run that did not know the outages ahead.
BELIEF_FIGURES: dict[str, Callable[[Trajectory], Figure]] = {"outage_belief": outage_belief}

FIGURE_TEXTS = {
    "energy_and_price": "Stored energy, net charging power of all batteries and import price.",
    "import_load_pv": "Import at the slack bus (above); demand, supplied demand and available PV "
    "power (below).",
    "voltages": "Lowest bus voltage of each step, and the largest difference between optimisation "
    "and AC power flow at any bus.",
    "service_by_tier": "Supply of each customer in each step, and the share of each tier.",
    "line_loadings": "The most loaded line of each step, from the AC power flow.",
    "solve_times": "Time from forecast to decision, and relative gap (linear below 1e-6).",
    "timeline": "The day at a glance; numbers count customers off supply.",
    "feeder_maps": "A row per bus with its AC voltage, and a row per line with its loading or "
    "current; dashed: the outage.",
    "outage_belief": "Forecast probability of an outage in each step, some hours before, and the "
    "expected value of one more stored kWh.",
}
"""What each figure shows."""


def save_figures(runs: Runs, folder: Path) -> list[Path]:
    """Write every figure as PNG and SVG into a folder, which is made if missing.

    Those of one run alone are left out for several.

    Returns
    -------
    list of Path
        The files written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [file for name in figure_names(runs) for file in draw_figure(runs, name, folder)]


def figure_names(runs: Runs) -> list[str]:
    """Names of the figures that one run, or several side by side, have."""
    if not isinstance(runs, Trajectory):
        return [*FIGURES]
    return [*FIGURES, *RUN_FIGURES, *(BELIEF_FIGURES if has_beliefs(runs) else ())]


def draw_figure(runs: Runs, name: str, folder: Path) -> list[Path]:
    """Write one figure as PNG and SVG into an existing folder."""
    if name in FIGURES:
        return save_figure(FIGURES[name](runs), folder / name)
    assert isinstance(runs, Trajectory)
    return save_figure((RUN_FIGURES | BELIEF_FIGURES)[name](runs), folder / name)
