"""Figure 3 and its table: batteries that heat, and efficiencies that follow."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from experiments.config import Config
from experiments.drawing import FULL, MPC, STYLES, day_axis, panels
from experiments.jobs import Day, Job
from experiments.results import DayResult
from experiments.rows import Row, measured
from experiments.runner import Results
from vppres.day.options import RunOptions
from vppres.physics.thermal import ThermalScheme
from vppres.report import plot

LABEL = "fig:3, tab:eff"
TITLE = "Time-varying battery efficiency"
PAPER = (
    "With efficiencies that fall as cells heat, the full horizon stores about 150 kWh less "
    "than it planned by hour 11 and reaches R = 0.81. The MPC, with H = 6, sees the "
    "efficiencies, charges more, holds more energy before and in the outage, and reaches "
    "0.90. It imports 60854.07 kWh, the full horizon 60691.72 kWh."
)

OUTAGE = 12
"""The outage begins: stored energy at this instant is that of the end of hour 11."""


def jobs(config: Config) -> list[Job]:
    """Both controllers in every temperature scheme, and further drawings of the full horizon."""
    return [
        *(job for scheme in schemes(config) for job in pair(config, scheme).values()),
        *_drawn(config),
    ]


def schemes(config: Config) -> list[ThermalScheme]:
    """The main scheme and the others."""
    return [config["scheme"], *config["other_schemes"]]


def pair(config: Config, scheme: ThermalScheme) -> dict[str, Job]:
    """The day of each controller in one scheme."""
    return {
        MPC: Job(options=RunOptions(horizon_h=float(config["horizon_h"]), thermal=scheme)),
        FULL: Job(options=RunOptions(controller="full-horizon", thermal=scheme)),
    }


def figure(config: Config, results: Results) -> Figure:
    """Stored energy above, mean charging efficiency below."""
    days = _days(config, results, config["scheme"])
    picture, (energy, efficiency) = panels(
        (3, 1.3), 5.8, f"Battery energy with heating, {config['scheme']} temperature step"
    )
    plot.energy(days, energy)
    for name, day in days.items():
        plot.steps(efficiency, day, day.series("eta_charge"), STYLES[name])
    plot.limit(efficiency, 0.95, "nominal")
    efficiency.set_ylabel("Charging\nefficiency,\nmean")
    day_axis([energy, efficiency], days[MPC])
    return picture


def rows(config: Config, results: Results) -> list[Row]:
    """R19, R20, R21 and R24 in every scheme."""
    packaged = [
        row
        for scheme in schemes(config)
        for row in _rows_of(scheme, _days(config, results, scheme))
    ]
    return [*packaged, *_rows_of_drawings(config, results)]


def ours(config: Config, results: Results) -> str:
    """What our figure shows."""
    days = _days(config, results, config["scheme"])
    mpc = days[MPC]
    full = days[FULL]
    return (
        f"With the {config['scheme']} step the full horizon stores {shortfall_kwh(full):,.0f} "
        "kWh less than planned at the end of hour 11 and reaches R = "
        f"{full.resilience:.3f}; the MPC reaches {mpc.resilience:.3f}. They import "
        f"{full.summary['import_kwh']:,.0f} and {mpc.summary['import_kwh']:,.0f} kWh. The "
        "hottest cell of the MPC's day has "
        f"{mpc.series('temperature_max_c').max():,.0f} °C."
    )


def shortfall_kwh(day: DayResult) -> float:
    """How far the stored energy at the end of hour 11 lies below the plan."""
    return float(day.planned["energy_kwh"][OUTAGE] - day.series("energy_kwh")[OUTAGE])


def _days(config: Config, results: Results, scheme: ThermalScheme) -> dict[str, DayResult]:
    return {name: results[job] for name, job in pair(config, scheme).items()}


def _drawn(config: Config) -> list[Job]:
    """The full horizon on further drawings of the unpublished data, in the main scheme."""
    options = pair(config, config["scheme"])[FULL].options
    return [Job(Day(seed=seed), options) for seed in range(1, config["builder_seeds"] + 1)]


def _rows_of_drawings(config: Config, results: Results) -> list[Row]:
    """R19b and R21 as medians over the packaged day and the further drawings."""
    found = [results[job] for job in (pair(config, config["scheme"])[FULL], *_drawn(config))]
    case = f"{config['scheme']}, median over {len(found)} drawings"
    resilience = np.array([day.resilience for day in found])
    short_kwh = np.array([shortfall_kwh(day) for day in found])
    return [
        measured(
            "R19b",
            float(np.median(resilience)),
            ".3f",
            case,
            f"Spread: {resilience.min():.3f} to {resilience.max():.3f}.",
        ),
        measured(
            "R21",
            float(np.median(short_kwh)),
            ".0f",
            case,
            f"Spread: {short_kwh.min():.0f} to {short_kwh.max():.0f}.",
        ),
    ]


def _rows_of(scheme: ThermalScheme, days: dict[str, DayResult]) -> list[Row]:
    mpc = days[MPC]
    full = days[FULL]
    imported = {name: float(day.summary["import_kwh"]) for name, day in days.items()}

    def reason() -> str:
        return _reason(full)

    return [
        measured("R19a", mpc.resilience, ".3f", scheme, reason),
        measured("R19b", full.resilience, ".3f", scheme, reason),
        measured("R19c", mpc.resilience / full.resilience - 1.0, ".3f", scheme, reason),
        measured("R20a", imported[MPC], ".0f", scheme, reason),
        measured("R20b", imported[FULL], ".0f", scheme, reason),
        measured("R21", shortfall_kwh(full), ".0f", scheme, reason),
        measured("R24", imported[MPC] - imported[FULL], ".0f", scheme, reason),
    ]


def _reason(full: DayResult) -> str:
    """Which hours were corrected, and how hot and inefficient the cells became."""
    hottest = full.series("temperature_max_c")
    eta = full.series("eta_charge")
    followed = sum(full.series("outage") > full.series("corrected"))
    return (
        f"{full.why_corrected()} {followed:.0f} hours of the outage follow the plan and are "
        f"served as planned. Hottest cell before the outage: "
        f"{hottest[:OUTAGE].max():,.0f} °C; mean charging efficiency at its lowest: "
        f"{eta[:OUTAGE].min():.3f}."
    )
