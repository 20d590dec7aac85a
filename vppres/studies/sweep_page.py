"""The page and the figure of a sweep."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.io.atomic import atomic_write_text
from vppres.report.key_figures import KEY_FIGURES, OF_TIERS, number
from vppres.report.pages import page
from vppres.report.plots.palette import BLUE, TIER_STYLES
from vppres.scenario.scenario import Scenario
from vppres.studies.drawing import draw_grid, embedded, plain, save_figure
from vppres.studies.sweep import SweepRow, outcome_table
from vppres.studies.sweep_parameters import Value, value_text

PAGE_FILE = "sweep.html"
FIGURE_NAME = "sweep"
TEMPLATE = "sweep.html.j2"

# Panels beside that of the tiers: column of the table, and its axis.
_PANELS = (
    ("resilience", "Resilience"),
    ("cost_gbp", "Cost of import (GBP)"),
    ("import_kwh", "Imported energy (kWh)"),
    ("v_min_ac_pu", "Lowest AC voltage (pu)"),
    ("solve_s.total", "Time for decisions (s)"),
)
# Key figures that fit on a page side by side; the table of the folder has all of them.
LINES = (("-", "o"), ("--", "s"), ("-.", "^"), (":", "D"))
"""Line and marker of each tier."""

_ON_PAGE = ("cost_gbp", "import_kwh", "pv_curtailed_kwh", "v_min_ac_pu", "corrections", "gap_max")


def write_sweep_page(
    parameter: str, scenario: Scenario, outcomes: Sequence[SweepRow], folder: Path
) -> None:
    """Write the page, and the figure as PNG and SVG, into an existing folder."""
    figure = sweep_figure(parameter, outcomes, scenario.tiers)
    save_figure(figure, folder / FIGURE_NAME)
    text = page(
        TEMPLATE,
        {
            "title": scenario.title,
            "parameter": parameter,
            "image": embedded(figure),
            "columns": [words for _, words, *_ in _columns(scenario)],
            "rows": [_row(outcome, scenario) for outcome in outcomes],
        },
    )
    atomic_write_text(folder / PAGE_FILE, text)


def sweep_figure(parameter: str, outcomes: Sequence[SweepRow], tiers: Sequence[str]) -> Figure:
    """Key figures over the parameter, one panel each; failed runs leave a gap."""
    ordered = _by_value(outcomes)
    table = outcome_table(ordered)
    x, labels = _positions([outcome.value for outcome in ordered])
    figure = Figure(figsize=(9.2, 8.4), layout="constrained")
    panels = list(figure.subplots(3, 2, sharex=True).flat)
    for ax, (column, words) in zip(panels[1:], _PANELS, strict=True):
        ax.plot(x, _column(table, column), color=BLUE, marker="o", linestyle="" if labels else "-")
        ax.set_ylabel(words)
    looks = itertools.cycle(zip(TIER_STYLES, LINES, strict=True))
    for tier, (style, (linestyle, marker)) in zip(tiers, looks, strict=False):
        share = 100.0 * _column(table, f"served_share.{tier}")
        panels[0].plot(
            x,
            share,
            color=style.color,
            marker=marker,
            label=plain(tier),
            linewidth=style.width,
            linestyle="" if labels else linestyle,
        )
    panels[0].set_ylabel("Served in the outage (%)")
    panels[0].set_ylim(-4.0, 104.0)
    panels[0].legend(frameon=False, fontsize=8)
    for ax in panels:
        _finish(ax, x, labels)
    for ax in panels[-2:]:
        ax.set_xlabel(plain(parameter))
    return figure


def _by_value(outcomes: Sequence[SweepRow]) -> list[SweepRow]:
    """Numbers in their order, so that a line runs from left to right; words as given."""
    return sorted(outcomes, key=lambda o: 0.0 if isinstance(o.value, str) else o.value)


def _positions(values: Sequence[Value]) -> tuple[list[float], list[str]]:
    """Places on the axis; words stand side by side and label their places."""
    if any(isinstance(value, str) for value in values):
        return [float(i) for i in range(len(values))], [plain(value) for value in values]
    return [float(value) for value in values], []


def _column(table: Any, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A column of the table as numbers, NaN where it has none."""
    if name not in table:
        return np.full(len(table), np.nan)
    return np.asarray(table[name], dtype=float)


def _finish(ax: Axes, x: list[float], labels: list[str]) -> None:
    draw_grid(ax)
    ax.ticklabel_format(axis="y", useOffset=False)
    if labels:
        ax.set_xticks(x, labels=labels)


def _columns(scenario: Scenario) -> list[tuple[str, str, str]]:
    """Column of the table, words with the unit, and format."""
    figures = [
        (key, f"{words} ({unit})" if unit else words, form)
        for key, words, unit, form in KEY_FIGURES
        if key in _ON_PAGE
    ]
    tiers = [
        (f"{key}.{tier}", f"{words}, {tier}" + (f" ({unit})" if unit else ""), form)
        for key, words, unit, form in OF_TIERS
        for tier in scenario.tiers
    ]
    return [
        ("resilience", "Resilience", ".4f"),
        *tiers,
        *figures,
        ("solve_s.total", "Time for decisions (s)", ".2f"),
    ]


def _row(outcome: SweepRow, scenario: Scenario) -> dict[str, Any]:
    figures = outcome_table([outcome]).iloc[0]
    return {
        "value": value_text(outcome.value),
        "folder": outcome.folder,
        "error": outcome.error,
        "texts": [number(figures.get(key), form) for key, _, form in _columns(scenario)],
    }
