"""The run folder, and the report a person can open: one HTML file that needs nothing beside it."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from vppres.io.atomic import atomic_folder
from vppres.io.scenario_folder import write_scenario
from vppres.metrics import service_by_customer, service_by_tier, summarise
from vppres.plots import FIGURES, save_figures
from vppres.trajectory import Trajectory, write_tables

SUMMARY_FILE = "summary.json"
REPORT_FILE = "report.html"
TEMPLATE = "run_report.html.j2"
NOT_DEFINED = "n/a"

# Key figures of the report: key of the summary, words, unit, format.
KEY_FIGURES = (
    ("resilience", "Resilience: weighted share served in the outage", "", ".4f"),
    ("resilience_planned", "Resilience that was planned", "", ".4f"),
    ("cost_gbp", "Cost of imported energy", "GBP", ",.2f"),
    ("import_kwh", "Imported energy", "kWh", ",.1f"),
    ("pv_curtailed_kwh", "Curtailed PV energy", "kWh", ",.1f"),
    ("v_min_ac_pu", "Lowest AC voltage", "pu", ".4f"),
    ("v_max_ac_pu", "Highest AC voltage", "pu", ".4f"),
    ("v_mean_of_min_ac_pu", "Mean over the steps of the lowest AC voltage", "pu", ".4f"),
    ("v_error_max_pu", "Largest voltage difference, optimisation to AC", "pu", ".4f"),
    ("island_import_max_kw", "Largest power drawn from the slack bus in the outage", "kW", ",.2f"),
    ("island_export_max_kw", "Largest surplus at the slack bus in the outage", "kW", ",.2f"),
    ("island_reactive_max_kvar", "Largest reactive power of the slack bus in the outage", "kvar",
     ",.1f"),
    ("corrections", "Steps in which the plan was corrected", "", "d"),
    ("gap_max", "Largest relative optimality gap", "", ".1e"),
)
FIGURE_TEXTS = {
    "energy_and_price": "Stored energy, net charging power of all batteries and import price.",
    "import_load_pv": "Import at the slack bus (above); demand, demand served and available PV "
                      "power (below).",
    "voltages": "Lowest bus voltage of each step, and the largest difference between optimisation "
                "and AC power flow at any bus.",
    "service_by_tier": "Who was served in each step, customer by customer, and the share of each "
                       "tier.",
}


def write_run(trajectory: Trajectory, folder: Path) -> dict[str, Any]:
    """Write a run folder, whole or not at all.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    folder : Path
        The folder to make; an older run in its place is replaced.

    Returns
    -------
    dict
        The summary, as in ``summary.json``.

    Raises
    ------
    InputError
        If the folder holds something other than a run, or cannot be written.
    """
    summary = summarise(trajectory)
    with atomic_folder(folder) as aside:
        write_tables(trajectory, aside)
        write_scenario(trajectory.scenario, aside / "scenario")
        save_figures(trajectory, aside / "figures")
        _write(aside / REPORT_FILE, render_report(trajectory, summary, aside / "figures"))
        _write(aside / SUMMARY_FILE, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def render_report(trajectory: Trajectory, summary: dict[str, Any], figures: Path) -> str:
    """The report as HTML.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.
    summary : dict
        Its figures, from :func:`vppres.metrics.summarise`.
    figures : Path
        Folder with the SVG files of :func:`vppres.plots.save_figures`; they are embedded.
    """
    environment = Environment(loader=PackageLoader("vppres"), autoescape=True, trim_blocks=True,
                              lstrip_blocks=True, undefined=StrictUndefined)
    unserved = service_by_customer(trajectory)
    return environment.get_template(TEMPLATE).render(
        title=trajectory.scenario.title, summary=summary, key_figures=key_figures(summary),
        options=_option_words(summary["options"]),
        figures=[(FIGURE_TEXTS[name], embedded_svg(figures / f"{name}.svg")) for name in FIGURES],
        tiers=trajectory.scenario.tiers, service=_service_rows(trajectory),
        unserved=unserved[unserved["unserved_h"] > 0].to_dict("records"),
        n_customers=len(unserved), steps=_step_rows(trajectory), number=number)


def _option_words(options: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Options in words with their values, those of nested groups one by one."""
    words = []
    for name, value in options.items():
        if isinstance(value, Mapping):
            words += _option_words(value)
        else:
            words.append((name.replace("_", " "), f"{value:g}" if isinstance(value, float)
                          else str(value)))
    return words


def key_figures(summary: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Words, value and unit of each key figure that the summary has."""
    return [(words, number(summary[key], form), unit)
            for key, words, unit, form in KEY_FIGURES if key in summary]


def number(value: float | None, form: str) -> str:
    """A number in the given format, or "n/a" where it is not defined.

    >>> number(0.91873, ".3f"), number(None, ".3f")
    ('0.919', 'n/a')
    """
    return NOT_DEFINED if value is None or pd.isna(value) else format(value, form)


def _service_rows(trajectory: Trajectory) -> list[dict[str, Any]]:
    """Time, outage and the share served of each tier, one row per step."""
    shares = service_by_tier(trajectory)
    return [{"time": f"{time:%d %b %H:%M}", "outage": bool(outage),
             "shares": [row.get(tier) for tier in trajectory.scenario.tiers]}
            for time, outage, row in zip(trajectory.steps["time"].dt.tz_convert("UTC"),
                                         trajectory.steps["outage"], shares.to_dict("records"),
                                         strict=True)]


def _step_rows(trajectory: Trajectory) -> list[dict[str, Any]]:
    """The steps table with the time as text."""
    times = trajectory.steps["time"].dt.tz_convert("UTC").dt.strftime("%d %b %H:%M")
    return [{str(name): value for name, value in row.items()}
            for row in trajectory.steps.assign(time=times).to_dict("records")]


def embedded_svg(svg: Path) -> str:
    """An SVG file as a data URI."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg.read_bytes()).decode("ascii")


def _write(file: Path, text: str) -> None:
    file.write_text(text, encoding="utf-8", newline="\n")
