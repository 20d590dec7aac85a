"""The page and the figure of a sweep."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from vppres.core.arrays import Floats
from vppres.io.atomic import atomic_write_text
from vppres.report.key_figures import KEY_FIGURES, OF_TIERS, number
from vppres.report.pages import page
from vppres.report.plots.axes import Scale
from vppres.report.plots.chart import Chart, Curve, Curves
from vppres.report.plots.drawing import BLUE, TIER_STYLES, Style
from vppres.report.plots.figures import save_chart
from vppres.scenario.scenario import Scenario
from vppres.studies.sweep import SweepRow, outcome_table
from vppres.studies.sweep_parameters import Value, value_text

PAGE_FILE = "sweep.html"
FIGURE_NAME = "sweep"
TEMPLATE = "sweep.html.j2"
PANEL_PX = 105.0

# Panels below that of the tiers: column of the table, and its axis.
_PANELS = (
    ("resilience", "Resilience"),
    ("cost_gbp", "Cost of\nimport (GBP)"),
    ("import_kwh", "Imported\nenergy (kWh)"),
    ("v_min_ac_pu", "Lowest AC\nvoltage (pu)"),
    ("solve_s.total", "Time for\ndecisions (s)"),
)
# Key figures that fit on a page side by side; the table of the folder has all of them.
_ON_PAGE = ("cost_gbp", "import_kwh", "pv_curtailed_kwh", "v_min_ac_pu", "corrections", "gap_max")


def write_sweep_page(
    parameter: str, scenario: Scenario, outcomes: Sequence[SweepRow], folder: Path
) -> None:
    """Write the page, and the figure as PNG and SVG, into an existing folder."""
    figure = sweep_figure(parameter, outcomes, scenario.tiers)
    save_chart(figure, folder)
    text = page(
        TEMPLATE,
        {
            "title": scenario.title,
            "parameter": parameter,
            "figure": Markup(figure.svg()),
            "columns": [words for _, words, *_ in _columns(scenario)],
            "rows": [_row(outcome, scenario) for outcome in outcomes],
        },
    )
    atomic_write_text(folder / PAGE_FILE, text)


def sweep_figure(parameter: str, outcomes: Sequence[SweepRow], tiers: Sequence[str]) -> Chart:
    """Key figures over the parameter, one panel each; failed runs leave a gap."""
    ordered = sorted(outcomes, key=lambda o: 0.0 if isinstance(o.value, str) else o.value)
    table = outcome_table(ordered)
    scale = _scale(parameter, [outcome.value for outcome in ordered])
    joined = not scale.names

    def curve(name: str, column: str, style: Style, per_cent: bool = False) -> Curve:
        values = _column(table, column) * (100.0 if per_cent else 1.0)
        return Curve(name, values, style, in_legend=per_cent, dots=True, joined=joined)

    shares = [
        curve(tier, f"served_share.{tier}", style, per_cent=True)
        for tier, style in zip(tiers, itertools.cycle(TIER_STYLES), strict=False)
    ]
    panels = [Curves("Served in the\noutage (%)", shares, PANEL_PX, low=-4.0, high=104.0)]
    panels += [
        Curves(words, [curve(words, column, Style(BLUE))], PANEL_PX) for column, words in _PANELS
    ]
    return Chart(FIGURE_NAME, f"Key figures over {parameter}", scale, panels)


def _scale(parameter: str, values: Sequence[Value]) -> Scale:
    """Places on the axis; words stand side by side and label their places."""
    if any(isinstance(value, str) for value in values):
        return Scale(parameter, np.arange(len(values), dtype=float), [*map(str, values)], 0.1)
    return Scale(parameter, np.array(values, dtype=float), room=0.03)


def _column(table: pd.DataFrame, name: str) -> Floats:
    """A column of the table as numbers, NaN where it has none."""
    if name not in table:
        return np.full(len(table), np.nan)
    return np.asarray(table[name], dtype=float)


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
