"""Tables and page of a study of survival."""

from __future__ import annotations

import json
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from vppres.core.plain import json_safe
from vppres.day.unused import beyond_limits
from vppres.io.atomic import atomic_write_text
from vppres.report.key_figures import number
from vppres.report.pages import page
from vppres.report.plots.axes import Scale
from vppres.report.plots.chart import Chart, Curve, Curves
from vppres.report.plots.drawing import CIVIDIS, RUN_STYLES, TIER_STYLES
from vppres.report.plots.figures import save_chart
from vppres.report.plots.rows import HeatMap
from vppres.scenario.timegrid import TimeGrid
from vppres.studies.survival import KNOWN, MARK, Survival

PAGE_FILE, TABLE_FILE = "survival.html", "survival.csv"
CUSTOMERS_FILE, ONSETS_FILE = "customers.csv", "onsets.csv"
TEMPLATE = "survival.html.j2"
PANEL_PX = 200.0


def write_survival(study: Survival, folder: Path) -> dict[str, Any]:
    """Write tables, figures and page into the folder of the study; its record."""
    table = study.table()
    charts = [curve(study, table), *maps(study)]
    for chart in charts:
        save_chart(chart, folder)
    for name, frame in (
        (TABLE_FILE, table),
        (CUSTOMERS_FILE, study.customers()),
        (ONSETS_FILE, study.by_onset()),
    ):
        atomic_write_text(folder / name, frame.to_csv(index=False, lineterminator="\n"))
    text = page(
        TEMPLATE,
        {
            "title": study.variants[0].site.title,
            "answers": answers(study, table),
            "how": how(study),
            "charts": [Markup(chart.svg()) for chart in charts],
            "rows": table.to_dict("records"),
            "several": len(study.variants) > 1,
            "sampled": not study.every_step,
            "number": number,
        },
    )
    atomic_write_text(folder / PAGE_FILE, text)
    record = {"runs": len(study.by_onset()), "rows": table.to_dict("records")}
    atomic_write_text(folder / MARK, json.dumps(json_safe(record), indent=2) + "\n")
    safe: dict[str, Any] = json_safe(record)
    return safe


def answers(study: Survival, table: pd.DataFrame) -> list[str]:
    """Supply that the first tier can rely on, a sentence for each variant, and what limits say."""
    found = []
    for variant in study.variants:
        rows = table[table["variant"] == variant.name]
        first = rows[rows["tier"] == rows["tier"].iloc[0]]
        said = [
            f"{row.length_h:g} h in {row.throughout:.0%}{_interval(study, row)}"
            for row in first.itertuples()
        ]
        start = f"{variant.name}: " if len(study.variants) > 1 else ""
        found.append(
            f"{start}the tier {first['tier'].iloc[0]} keeps supply throughout an outage of "
            f"{', '.join(said)} of {int(first['onsets'].iloc[0])} onsets."
        )
    site, charged = study.variants[0].site, study.tried.charged
    beyond = [] if charged is None else beyond_limits("--charged", charged, site.batteries)
    return [*(words[:1].upper() + words[1:] for words in found), *beyond]


def _interval(study: Survival, row: Any) -> str:
    return "" if study.every_step else f" ({row.low:.0%} to {row.high:.0%})"


def how(study: Survival) -> str:
    """Which outages were tried, and how each was run."""
    options, tried = study.variants[0].options, study.tried
    count = len({one.onset for one in study.outcomes[study.variants[0].name]})
    which = (
        f"every one of {count} steps: the shares are exact for these series"
        if study.every_step
        else f"{count} of {study.variants[0].site.grid.n_steps} steps, drawn by chance: intervals "
        "are Wilson's, of 95%"
    )
    knowledge = "known ahead" if options.outages == KNOWN else f"not known ({options.outages})"
    charge = (
        "charged as operation without outages leaves them"
        if tried.charged is None
        else f"at a state of charge of {tried.charged:.0%}"
    )
    return (
        f"Outages began in {which}. Their end was {knowledge}; batteries were {charge}; "
        f"controller {options.controller}."
    )


def curve(study: Survival, table: pd.DataFrame) -> Chart:
    """Share of onsets over the length: of each tier, or of the first tier by variant."""
    hours = np.array(study.tried.lengths_h)
    several = len(study.variants) > 1
    first = table["tier"].iloc[0]
    kept = table[table["tier"] == first] if several else table
    styles = cycle(RUN_STYLES if several else TIER_STYLES)
    curves = [
        Curve(str(name), 100.0 * rows["throughout"].to_numpy(float), style, dots=True)
        for (name, rows), style in zip(
            kept.groupby("variant" if several else "tier", sort=False), styles, strict=False
        )
    ]
    axis = "Supplied\nthroughout (%)"
    panel = Curves(axis, curves, PANEL_PX, low=-4.0, high=104.0)
    title = f"Onsets that the tier {first} survives" if several else "Onsets that are survived"
    return Chart("survival", title, Scale("Length of the outage (h)", hours, room=0.03), [panel])


def maps(study: Survival) -> list[Chart]:
    """Share of onsets that the first tier survives, by hour of the day and length."""
    names = [f"{hours:g}" for hours in study.tried.lengths_h]
    scale = Scale("Length of the outage (h)", np.arange(len(names) + 1.0), names)
    found = []
    for i, variant in enumerate(study.variants):
        hours, shares = _by_hour(study, variant.name, variant.site.grid)
        zone = variant.site.grid.zone
        found.append(
            Chart(
                f"onsets_{i + 1}",
                f"Supplied throughout, by the hour in which the outage begins: {variant.name}",
                scale,
                [
                    HeatMap(
                        f"Onset ({zone})",
                        hours,
                        100.0 * shares,
                        "Onsets (%)",
                        CIVIDIS,
                        ends=(0.0, 100.0),
                    )
                ],
            )
        )
    return found


def _by_hour(study: Survival, variant: str, grid: TimeGrid) -> tuple[list[str], Any]:
    """Names of the hours that were tried, and shares by hour and length."""
    rows = study.by_onset()
    rows = rows[rows["variant"] == variant]
    column = next(name for name in rows if str(name).startswith("kept_h."))
    hour = pd.to_datetime(rows["onset"], utc=True).dt.tz_convert(grid.zone).dt.strftime("%H:00")
    whole = rows[column] >= rows["length_h"]
    shares = whole.groupby([hour, rows["length_h"]]).mean().unstack()
    return [str(name) for name in shares.index], shares.to_numpy(float)
