"""How much the main results hang on what the paper leaves open."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments import efficiency
from experiments.config import Config
from experiments.drawing import FULL, LINES, MPC, legend, panels
from experiments.jobs import Day, Job
from experiments.results import DayResult
from experiments.rows import Row
from experiments.runner import Results
from vppres.contract.forecast import ForecastErrors
from vppres.day.options import RunOptions

LABEL = "not in the paper"
TITLE = "Sensitivities"
PAPER = (
    "The paper leaves open: whether the outage has six or seven hourly steps, the prices, the "
    "critical customers' share of the load, all data per bus, how the plan's PV split is "
    "checked, the zones' thermal constants, and numerical choices."
)

NOT_RUN = "\N{EN DASH}"

CASES: Mapping[str, Job] = {MPC: Job(), FULL: Job(options=RunOptions(controller="full-horizon"))}


@dataclass(frozen=True)
class Variation:
    """One variation of the packaged day."""

    #: What is varied, and to what.
    group: str
    value: str
    jobs: Mapping[str, Job]  #: by controller


@dataclass(frozen=True)
class Line:
    """A variation's figures, as text; a dash where a controller was not run."""

    group: str
    value: str
    mpc: str
    full: str
    note: str


def variations(config: Config) -> list[Variation]:
    """Every variation, in the order of the report."""
    groups: tuple[Callable[[Config], list[Variation]], ...] = (
        _of_the_day,
        _of_the_numerics,
        _of_the_heating,
        _of_the_check,
    )
    return [variation for group in groups for variation in group(config)]


def jobs(config: Config) -> list[Job]:
    """All days."""
    return [job for variation in variations(config) for job in variation.jobs.values()]


def rows(config: Config, results: Results) -> list[Row]:
    """No published statement is judged here."""
    return []


def lines(config: Config, results: Results) -> list[Line]:
    """The table of sensitivities."""
    return [_line(variation, results) for variation in variations(config)]


def figure(config: Config, results: Results) -> Figure:
    """Ideal resilience of every variation of the day."""
    shown = _of_the_day(config)
    picture, (ax,) = panels((1,), 1.6 + 0.2 * len(shown), "Resilience, ideal conditions")
    for name, marker, size in ((MPC, "o", 7), (FULL, "D", 4)):
        values = [results[variation.jobs[name]].resilience for variation in shown]
        ax.plot(
            values,
            np.arange(len(shown)),
            marker=marker,
            linestyle="none",
            markersize=size,
            color=LINES[name]["color"],
            label=name,
        )
    ax.set_yticks(range(len(shown)), labels=[f"{v.group}: {v.value}" for v in shown], fontsize=8)
    ax.invert_yaxis()
    ax.axvspan(0.91, 0.93, color="#E4EFE4", zorder=0)
    ax.set_xlabel("Resilience R (shaded: published, with tolerance)")
    return legend(picture, ax, 2)


def ours(config: Config, results: Results) -> str:
    """What the variations show, in a sentence."""
    drawn = [v for v in _of_the_day(config) if v.group == "data per bus"]
    of_mpc = np.array([results[v.jobs[MPC]].resilience for v in drawn])
    apart = np.array(
        [results[v.jobs[MPC]].resilience - results[v.jobs[FULL]].resilience for v in drawn]
    )
    return (
        f"Over {len(drawn)} drawings of the data per bus the ideal MPC has R = "
        f"{of_mpc.min():.3f} to {of_mpc.max():.3f} (median {np.median(of_mpc):.3f}) and "
        f"differs from the full horizon by at most {np.abs(apart).max():.4f}."
    )


def _of_the_day(config: Config) -> list[Variation]:
    """What the builder leaves open, both controllers under ideal conditions."""
    days = [
        *(("outage steps", str(n), Day(outage_steps=n)) for n in config["outage_steps"]),
        *(("price rebuild", p, Day(price=p)) for p in config["prices"]),
        *(("critical share", f"{s:g}", Day(critical_share=s)) for s in config["critical_shares"]),
        *(
            ("data per bus", f"seed {n}", Day(seed=n))
            for n in range(1, config["builder_seeds"] + 1)
        ),
    ]
    return [
        Variation(group, value, {name: replace(job, day=day) for name, job in CASES.items()})
        for group, value, day in days
    ]


def _of_the_numerics(config: Config) -> list[Variation]:
    """Polygon sides (MPC), and the linearisation centre (both controllers)."""
    sides = [
        Variation("polygon sides", str(n), {MPC: _with(CASES[MPC], polygon_sides=n)})
        for n in config["polygon_sides"]
    ]
    centres = [
        Variation(
            "linearisation centre",
            centre,
            {name: _with(job, centre=centre) for name, job in CASES.items()},
        )
        for centre in config["centres"]
    ]
    return [*sides, *centres]


def _of_the_heating(config: Config) -> list[Variation]:
    """Pairing of the zones' thermal constants (full horizon)."""
    return [
        Variation(
            f"zone pairing, {scheme}",
            "".join(map(str, pairing)),
            {
                FULL: Job(
                    Day(zone_pairing=tuple(pairing)),
                    RunOptions(controller="full-horizon", thermal=scheme),
                )
            },
        )
        for scheme in config["thermal_schemes"]
        for pairing in config["zone_pairings"]
    ]


def _of_the_check(config: Config) -> list[Variation]:
    """Both readings of the full horizon's PV check, at a level of every kind of error."""
    found = []
    for level in config["literal_levels"]:
        ((name, value),) = level.items()
        for reading in ("absorbing", "literal"):
            job = _with(CASES[FULL], errors=ForecastErrors(**level), pv_check=reading)
            found.append(Variation(f"PV check, {name} = {value:g}", reading, {FULL: job}))
    return found


def _with(job: Job, **options: Any) -> Job:
    return replace(job, options=replace(job.options, **options))


def _line(variation: Variation, results: Results) -> Line:
    days = {name: results[job] for name, job in variation.jobs.items()}
    texts = {name: f"{day.resilience:.4f}" for name, day in days.items()}
    return Line(
        variation.group,
        variation.value,
        texts.get(MPC, NOT_RUN),
        texts.get(FULL, NOT_RUN),
        "; ".join(_note(variation, name, day) for name, day in days.items()),
    )


def _note(variation: Variation, name: str, day: DayResult) -> str:
    """The figure beside resilience that the variation may change."""
    if variation.group.startswith("zone pairing"):
        return (
            f"{efficiency.shortfall_kwh(day):,.0f} kWh short at hour 11, import "
            f"{day.summary['import_kwh']:,.0f} kWh"
        )
    if variation.group.startswith("PV check"):
        hours = day.corrected_hours
        before = sum(hour < day.steps["outage"].index(True) for hour in hours)
        return (
            f"GBP {day.summary['cost_gbp']:,.0f}, {len(hours)} hours corrected, {before} "
            "before the outage"
        )
    if variation.group in ("polygon sides", "linearisation centre"):
        return (
            f"{name}: voltage error {day.summary['v_error_max_pu']:.4f} pu, "
            f"{day.summary['solve_s']['total']:.1f} s"
        )
    return (
        f"{name}: import {day.summary['import_kwh']:,.0f} kWh, mean lowest voltage "
        f"{day.summary['v_mean_of_min_ac_pu']:.4f} pu"
    )
