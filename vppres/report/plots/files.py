"""All figures of runs by name, and their files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from vppres.day.trajectory import Trajectory
from vppres.report.plots.by_phase import by_phase
from vppres.report.plots.chart import Chart, Runs
from vppres.report.plots.energy import energy_and_price, import_load_pv, voltages
from vppres.report.plots.feeder import feeder_maps, line_loadings, solve_times
from vppres.report.plots.outages import has_beliefs, outage_belief
from vppres.report.plots.pixels import png_of
from vppres.report.plots.rooms import indoor
from vppres.report.plots.service import service_by_tier
from vppres.report.plots.strips import timeline

# Figures of one run or of several.
FIGURES: dict[str, Callable[[Runs], Chart]] = {
    "energy_and_price": energy_and_price,
    "import_load_pv": import_load_pv,
    "voltages": voltages,
    "service_by_tier": service_by_tier,
    "line_loadings": line_loadings,
    "solve_times": solve_times,
}

# Figures of one run alone.
RUN_FIGURES: dict[str, Callable[[Trajectory], Chart]] = {
    "timeline": timeline,
    "feeder_maps": feeder_maps,
}

# Figures of one run that has what they show.
SOME_FIGURES: dict[str, tuple[Callable[[Trajectory], bool], Callable[[Trajectory], Chart]]] = {
    "by_phase": (lambda run: run.scenario.phases is not None, by_phase),
    "outage_belief": (has_beliefs, outage_belief),
    "indoor": (lambda run: run.thermal_loads is not None, indoor),
}

FIGURE_TEXTS = {
    "by_phase": "Lowest and, dotted, highest voltage of each phase; what the grid or the battery "
    "that forms the island gives on each phase; the phase nearest to its rating; unbalance.",
    "energy_and_price": "Stored energy, net charging power of all batteries and import price.",
    "import_load_pv": "Import at the slack bus (above); demand, supplied demand, available PV "
    "power, net charging power of vehicles, power of machines that cool or heat and of generating "
    "sets (below).",
    "indoor": "Temperature of each room and tank, their median, and the ends of the comfort band "
    "if all have the same.",
    "voltages": "Lowest bus voltage of each step, and the largest difference between optimisation "
    "and AC power flow at any bus.",
    "service_by_tier": "Supply of each customer in each step, and the share of each tier.",
    "line_loadings": "The most loaded line of each step, from the AC power flow.",
    "solve_times": "Time from forecast to decision, and relative gap (below 1e-9 at the bottom).",
    "timeline": "The day at a glance; numbers are customers off supply, and their kW.",
    "feeder_maps": "A row per bus with its AC voltage, and a row per line with its loading or "
    "current; dashed: the outage.",
    "outage_belief": "Forecast probability of an outage in each step, some hours before, and the "
    "expected value of one more stored kWh.",
}
"""What each figure shows."""

PNG, SVG = "png", "svg"
KINDS = (PNG, SVG)


def chart_of(runs: Runs, name: str) -> Chart:
    """A figure by its name."""
    if name in FIGURES:
        return FIGURES[name](runs)
    assert isinstance(runs, Trajectory)
    draw = RUN_FIGURES[name] if name in RUN_FIGURES else SOME_FIGURES[name][1]
    return draw(runs)


def figure_names(runs: Runs) -> list[str]:
    """Names of the figures that one run, or several side by side, have."""
    if not isinstance(runs, Trajectory):
        return [*FIGURES]
    some = [name for name, (has, _) in SOME_FIGURES.items() if has(runs)]
    return [*FIGURES, *RUN_FIGURES, *some]


def save_figures(runs: Runs, folder: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Write every figure into a folder, which is made if missing; the files written.

    Those of one run alone are left out for several of the same day, which come by their labels.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = figure_names(runs)
    return [file for name in names for file in save_chart(chart_of(runs, name), folder, kinds)]


def save_chart(chart: Chart, folder: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Write one figure into an existing folder, under its name; equal figures give equal files."""
    svg = chart.svg()
    written = []
    for kind in kinds:
        file = folder / f"{chart.key}.{kind}"
        file.write_bytes(svg.encode() if kind == SVG else png_of(svg))
        written.append(file)
    return written
