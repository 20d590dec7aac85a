"""The paper's rows at the precision of a weighted solve: the problem's, or the tolerance's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.frame.pages import markdown_table, save_figure, write_pages
from benchmarks.frame.seeds import STUDIES, Jobs
from benchmarks.frame.seeds import Results as Folder
from benchmarks.frame.terminal import Scheduler, plain_errors, show_report
from experiments import efficiency, ideal
from experiments.config import Config, read_config
from experiments.drawing import FULL, LINES, MPC, SPREAD, draw_grid, legend
from experiments.jobs import Day, Job, scenario
from experiments.results import DayResult
from experiments.rows import Row, order
from experiments.runner import Results, run_jobs
from experiments.studies.settings import At, Setting, jobs_of, rows_of
from experiments.studies.weighted_gap import service_of, terms_beside_gap
from vppres.report.plots.drawing import BLACK

TITLE = "The paper at the precision of a weighted solve"
NAME = "precision"
FOLDER = Path(__file__).parent
WIDTH = 160

RowKey = tuple[str, str]


@dataclass(frozen=True)
class Quantity:
    """A figure of a day that the paper publishes, or that stands beside one that it does."""

    title: str
    key: str
    published: Mapping[str, float]


QUANTITIES = (
    Quantity("Resilience R", "resilience", {MPC: 0.92, FULL: 0.92}),
    Quantity("Cost (GBP)", "cost_gbp", {}),
    Quantity("Import (kWh), published with heating", "import_kwh", {MPC: 60854.07, FULL: 60691.72}),
    Quantity("Mean lowest AC voltage (pu)", "v_mean_of_min_ac_pu", {MPC: 0.9607, FULL: 0.9601}),
)


def named(config: Config) -> Setting:
    """The setting that stands first in the tables."""
    return Setting(**config["named"])


def row_key(row: Row) -> RowKey:
    """What a row is about, whatever was found."""
    return row.id, row.quantity


def open_text(config: Config) -> str:
    """The arithmetic of the gap, for a window of the chosen horizon."""
    day = scenario(Day())
    gap = named(config).gap
    n_steps = config["horizon_h"] + 1
    terms = {term.name: term for term in terms_beside_gap(day, n_steps, gap)}
    cost = terms["the cost that batteries move"]
    losses = terms["line losses"]
    service = service_of(day, n_steps)
    return (
        f"A window of {n_steps} h in which everyone is served is worth {service:.1f} weighted "
        f"customer hours. A gap of {gap:g} leaves {gap * service:.2g} of them open, as much as "
        f"GBP {cost.left_open:,.0f}; batteries can move about {cost.whole:,.0f} of the cost, and "
        f"all losses, {losses.whole:,.0f} kWh, weigh {losses.whole / losses.left_open:.0e} of the "
        "gap."
    )


def settings(config: Config) -> list[Setting]:
    """The study's solvers, units and seeds, the named setting first."""
    study = config["study"]
    first = named(config)
    found = [
        replace(first, solver=solver, unit_kw=unit, seed=seed)
        for solver, unit, seed in product(study["solvers"], study["units_kw"], study["seeds"])
    ]
    return list(dict.fromkeys([first, *found]))


def sharp_settings(config: Config) -> list[Setting]:
    """The named gap and smaller ones, in each unit."""
    study = config["study"]
    first = named(config)
    gaps = [first.gap, *study["sharp_gaps"]]
    units = study["sharp_units_kw"]
    return [replace(first, unit_kw=unit, gap=gap) for unit, gap in product(units, gaps)]


def sharp_days(config: Config) -> list[Job]:
    """Ideal days whose windows end at small gaps too."""
    return [ideal.mpc(h) for h in config["study"]["sharp_horizons_h"]]


def study_config(quick: bool = False) -> Config:
    """The configuration with the study's further days."""
    config = read_config(NAME, quick, FOLDER)
    return config if quick else {**config, **config["study"]}


def table(config: Config, results: Results, found: Sequence[Setting]) -> list[list[str]]:
    """Each row of the paper's table term by term, at the named setting and over all."""
    exact = rows_of(config, results)
    over = [
        {row_key(row): row for row in rows_of(config, At(setting, results))} for setting in found
    ]
    return [_line(row, [seen[row_key(row)] for seen in over]) for row in sorted(exact, key=order)]


def _line(row: Row, over: Sequence[Row]) -> list[str]:
    """One row of the study's table."""
    holding = sum(again.holds for again in over)
    same = all(again.holds == row.holds for again in over)
    return [
        row.id,
        row.quantity,
        row.published,
        f"{row.ours} ({row.verdict})",
        f"{over[0].ours} ({over[0].verdict})",
        _range([again.ours for again in over]),
        f"{holding} of {len(over)}",
        "the problem" if same else "the tolerance",
    ]


def _range(values: Sequence[str]) -> str:
    """Least and largest of values that are numbers."""
    try:
        numbers = [float(value) for value in values]
    except ValueError:
        return ""
    low = values[int(np.argmin(numbers))]
    high = values[int(np.argmax(numbers))]
    return low if low == high else f"{low} to {high}"


HEAD = (
    "",
    "Quantity",
    "Published",
    "Term by term",
    "At the named setting",
    "Over all settings",
    "Holds in",
    "Verdict hangs on",
)


def effort_text(config: Config, results: Results, found: Sequence[Setting]) -> str:
    """How many windows of how many days ended as they should."""
    days = [results[setting.of(job)] for setting in found for job in jobs_of(config)]
    statuses = [status for day in days for status in day.steps["status"]]
    solved = sum(status not in ("planned", "not_solved") for status in statuses)
    late = statuses.count("time_limit")
    fallbacks = sum(int(day.summary["fallbacks"]) for day in days)
    solve_s = sum(day.summary["solve_s"]["total"] for day in days)
    return (
        f"{len(found)} settings, {len(days)} days, {solved:,} windows, {solve_s / 60:.0f} min of "
        f"solve time; {late} windows ended at their time limit, {fallbacks} steps had a fallback."
    )


def sharp_text(config: Config, results: Results) -> str:
    """What smaller gaps change: key figures by horizon, term by term, by unit and by gap."""
    days = sharp_days(config)
    head = ("", *(f"H = {day.options.horizon_h:g}" for day in days), "Windows at their limit")
    lines = [["term by term", *(_key_figures(results[day]) for day in days), ""]]
    for setting in sharp_settings(config):
        found = [results[setting.of(day)] for day in days]
        late = sum(list(day.steps["status"]).count("time_limit") for day in found)
        lines.append([str(setting), *map(_key_figures, found), str(late)])
    return "R, cost and import of ideal days.\n\n" + markdown_table(head, lines)


def _key_figures(day: DayResult) -> str:
    """Resilience, cost and import of a day."""
    cost = day.summary["cost_gbp"]
    return f"{day.resilience:.4f}; GBP {cost:,.0f}; {day.summary['import_kwh']:,.0f} kWh"


def write_study(
    config: Config, results: Results, found: Sequence[Setting], sharp: str, folder: Path
) -> Path:
    """Write tables and figure of the study; the Markdown's path."""
    lines = table(config, results, found)
    text = "\n\n".join(
        [
            f"Named setting: {found[0]}. {effort_text(config, results, found)}",
            open_text(config),
            f"![{TITLE}]({NAME}.svg)",
            markdown_table(HEAD, lines),
            sharp,
        ]
    )
    record = {"settings": [str(setting) for setting in found], "rows": lines}
    page = write_pages(folder, NAME, TITLE, text, record)
    save_figure(_figure(config, results, found), folder / NAME)
    return page


def main(
    jobs: Jobs = -1,
    results: Folder = STUDIES,
    scheduler: Scheduler = None,
    unit_kw: Annotated[
        list[float] | None,
        typer.Option(help="Only this unit of power; may be given several times."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Only the first N seeds of a unit.")
    ] = None,
    report_days: Annotated[
        bool,
        typer.Option("--report-days", help="No battery heating, and no H above 5."),
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="The named setting alone, on few days.")
    ] = False,
) -> None:
    """The paper's rows over the settings of a weighted solve."""
    whole = read_config(NAME, folder=FOLDER) if report_days else study_config(quick)
    config = _narrowed(whole, unit_kw, seeds)
    found = [named(config)] if quick else settings(config)
    days = jobs_of(config)
    wanted = [*days, *(setting.of(day) for setting in found for day in days)]
    if not quick:
        exact = sharp_days(config)
        wanted += [*exact, *(one.of(day) for one in sharp_settings(config) for day in exact)]
    with plain_errors("Days that were finished"):
        known, _ = run_jobs(wanted, results / "days", jobs, scheduler)
    sharp = "" if quick else sharp_text(config, known)
    show_report(write_study(config, known, found, sharp, results), WIDTH)


def _narrowed(config: Config, units_kw: Sequence[float] | None, seeds: int | None) -> Config:
    """The configuration with fewer units and seeds."""
    study = config["study"]
    fewer = {"units_kw": units_kw or study["units_kw"], "seeds": study["seeds"][:seeds]}
    return {**config, "study": {**study, **fewer}}


# Figure.


def _figure(config: Config, results: Results, found: Sequence[Setting]) -> Figure:
    """Four key figures against the horizon: term by term, at each setting, as published."""
    picture = Figure(figsize=(9.0, 6.6), layout="constrained")
    axes = np.ravel(picture.subplots(2, 2, sharex=True))
    names = [*map(str, config["horizons_h"]), "full"]
    days = [*(ideal.mpc(h) for h in config["horizons_h"]), ideal.FULL_HORIZON]
    for ax, quantity in zip(axes, QUANTITIES, strict=True):
        draw_grid(ax)
        _draw(ax, quantity, [results[day] for day in days], None)
        for number, setting in enumerate(found):
            _draw(ax, quantity, [results[setting.of(day)] for day in days], number)
        _draw_heated(ax, quantity, config, results, found[0])
        for name, value in quantity.published.items():
            ax.axhline(value, color=BLACK, linewidth=0.9, linestyle=":" if name == FULL else "--")
        ax.set_title(quantity.title, fontsize=10)
        ax.set_xticks(range(len(names)), names)
    for ax in axes[2:]:
        ax.set_xlabel("Prediction horizon H (h); full horizon")
    axes[0].axhline(np.nan, color=BLACK, linewidth=0.9, linestyle="--", label="published, MPC")
    axes[0].axhline(
        np.nan, color=BLACK, linewidth=0.9, linestyle=":", label="published, full horizon"
    )
    picture.suptitle(TITLE, fontsize=11)
    return legend(picture, axes[0], 4)


def _draw(ax: Axes, quantity: Quantity, days: Sequence[DayResult], number: int | None) -> None:
    """A quantity of the days: a line term by term, marks at a setting."""
    values = [float(day.summary[quantity.key]) for day in days]
    positions = np.arange(len(values))
    if number is None:
        ax.plot(positions, values, marker="o", markersize=4, label="term by term", **LINES[MPC])
        return
    label = "weighted, named setting" if number == 0 else "weighted, other settings"
    ax.plot(
        positions,
        values,
        linestyle="none",
        marker="D" if number == 0 else "_",
        markersize=6 if number == 0 else 9,
        color=SPREAD,
        alpha=1.0 if number == 0 else 0.5,
        label=label if number < 2 else "_",
    )


def _draw_heated(
    ax: Axes, quantity: Quantity, config: Config, results: Results, setting: Setting
) -> None:
    """Import with battery heating, which is what the paper publishes, at the named setting."""
    horizon_h = config["heated_horizon_h"]
    horizons_h = config["horizons_h"]
    if quantity.key != "import_kwh" or not config["schemes"] or horizon_h not in horizons_h:
        return
    heated = efficiency.pair({"horizon_h": horizon_h}, config["schemes"][0])
    places = {MPC: horizons_h.index(horizon_h), FULL: len(horizons_h)}
    for name, job in heated.items():
        value = float(results[setting.of(job)].summary[quantity.key])
        ax.plot(places[name], value, marker="*", markersize=11, color=SPREAD, linestyle="none")


if __name__ == "__main__":
    typer.run(main)
