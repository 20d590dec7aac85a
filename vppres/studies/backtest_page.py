"""The page and the tables of a back-test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from vppres.core.arrays import Floats
from vppres.forecasts.interface import quantiles
from vppres.io.atomic import RUN_MARK, atomic_folder, atomic_write_text
from vppres.report.key_figures import number
from vppres.report.pages import page
from vppres.report.plots.axes import Scale
from vppres.report.plots.chart import Band, Chart, Curve, Curves, Limit
from vppres.report.plots.drawing import BLACK, BLUE, GREY, RUN_STYLES, VERMILLION, Style
from vppres.studies.backtest import Backtest
from vppres.studies.estimate_scores import EstimateScores
from vppres.studies.issue_scores import SHARES, came_in, totals_of
from vppres.studies.warning_scores import WarningScores

PAGE_FILE = "backtest.html"
TEMPLATE = "backtest.html.j2"
WORDS = {"load": "Load", "pv": "PV power", "net": "Load less PV power"}
PIT_BINS = 10
LENGTH_BINS = 5
TWO_SIGMA = 1.96


def write_backtest(
    result: Backtest, folder: Path, title: str, warned: WarningScores | None = None
) -> dict[str, Any]:
    """Write page, tables and summary into a folder, whole or not at all; returns the summary.

    ``title`` says what was tested; ``warned`` has the scores of outage warnings.
    """
    summary = {"title": title, **result.summary()}
    if warned is not None:
        summary["warnings"] = warned.summary()
    with atomic_folder(folder) as aside:
        result.by_lead().to_csv(aside / "by_lead.csv", index=False)
        result.energy().to_csv(aside / "energy.csv", index=False)
        result.by_month().to_csv(aside / "by_month.csv")
        atomic_write_text(aside / PAGE_FILE, render_backtest(result, title, warned))
        atomic_write_text(aside / RUN_MARK, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def render_backtest(result: Backtest, title: str, warned: WarningScores | None = None) -> str:
    """The back-test as one HTML page that needs nothing beside it."""
    table = result.by_lead()
    chosen = [lead for lead in (1, 2, 3, 6, 12, 24, 36, 48) if lead <= result.plan.horizon_h]
    rows = table[table["lead_h"].isin(chosen) & table["held_80%"].notna()]
    return page(
        TEMPLATE,
        {
            "title": title,
            "result": result,
            "first": f"{result.issues[0]:%Y-%m-%d}",
            "last": f"{result.issues[-1]:%Y-%m-%d}",
            "findings": backtest_findings(result, warned),
            "words": WORDS,
            "ranges": result.ranges().to_dict("records"),
            "leads": [
                {str(name): value for name, value in row.items()} for row in rows.to_dict("records")
            ],
            "energy": result.energy().to_dict("records"),
            "drift": result.drift().to_dict("records"),
            "band": _band(result),
            "shares": [f"{share:.0%}" for share in SHARES],
            "figures": [
                (WORDS[quantity], _figures(result, quantity)) for quantity in result.quantities
            ],
            "warned": warned,
            "warned_figures": [] if warned is None else _warned_figures(warned),
            "number": number,
        },
    )


def backtest_findings(result: Backtest, warned: WarningScores | None = None) -> list[str]:
    """Main findings for a reader, in sentences."""
    ranges = result.ranges()
    held = result.by_lead()
    energy = result.energy()
    sentences = []
    for quantity in result.quantities:
        changes = ranges[ranges["quantity"] == quantity].to_dict("records")
        against = ", ".join(
            f"{_less_or_more(row['to_climatology'])} up to {row['until_h']} h"
            for row in changes
            if not np.isnan(row["to_climatology"])
        )
        by_lead = held.loc[held["quantity"] == quantity, "held_80%"]
        sentences.append(
            f"{WORDS[quantity]}: error (CRPS) against what is usual at the time of day: "
            f"{against or 'none is usual'}. "
            f"The 80 % interval held {_percent(by_lead.mean())} ({_percent(by_lead.min())} to "
            f"{_percent(by_lead.max())} by lead)."
        )
    day = energy[(energy["quantity"] == result.quantities[-1]) & (energy["hours"] == 24)]
    if len(day):
        sentences.append(
            f"{WORDS[result.quantities[-1]]}, energy of 24 h: the 80 % interval held "
            f"{_percent(day['held_80%'].iloc[0])}."
        )
    band = _band(result)
    sentences += [
        f"{WORDS[row['quantity']]}: in the last 30 days the 80 % interval held "
        f"{_percent(row['held_80%_recent'])}, outside of {_percent(0.8 - band)} to "
        f"{_percent(min(0.8 + band, 1.0))}: the spread no longer fits."
        for row in result.drift().to_dict("records")
        if abs(row["held_80%_recent"] - 0.8) > band
    ]
    return sentences if warned is None else [*sentences, *_warned_findings(warned)]


def _warned_findings(warned: WarningScores) -> list[str]:
    """Findings on outage warnings, in sentences."""
    sentences = [
        f"Outage warnings: of {_counted(len(warned.pairs), 'announced outage')} {warned.n_came} "
        f"came, and {_counted(len(warned.unannounced), 'outage')} came unannounced."
    ]
    if warned.late:
        sentences.append(
            f"Outages announced only when they had begun or could no longer begin: {warned.late}. "
            "Such warnings score nothing."
        )
    if warned.brier > warned.brier_of_share:
        sentences.append(
            f"Their probabilities are off by more (Brier score {warned.brier:.3f}) than the share "
            f"that came, said each time, would be ({warned.brier_of_share:.3f})."
        )
    sentences += _restoration_findings(warned.restoration)
    table = warned.reliability
    sentences += [
        f"Where warnings said {_percent(row['said'])}, {_percent(row['came'])} of "
        f"{row['warnings']} came, outside of {_percent(row['low'])} to {_percent(row['high'])}."
        for row in table[(table["came"] < table["low"]) | (table["came"] > table["high"])].to_dict(
            "records"
        )
    ]
    return sentences


def _restoration_findings(found: EstimateScores) -> list[str]:
    """How long outages lasted of what was said of them, and what to write of it."""
    sentences = [
        f"Estimates of restoration, {row['said']} since the onset "
        f"({_counted(row['outages'], 'outage')}): one outage in ten lasted less than "
        f"{row['estimate_p10']:.2f} times the estimate, one in two less than "
        f"{row['estimate_p50']:.2f} times, nine in ten less than {row['estimate_p90']:.2f} times; "
        f"{_percent(row['wrong'])} missed by more than a quarter."
        for row in found.table.to_dict("records")
    ]
    if found.learned:
        lines = ", ".join(f"{name} = {value:g}" for name, value in found.learned.items())
        sentences.append(f"For [outage_statistics] of scenario.toml: {lines}.")
    return sentences


def _counted(number: int, thing: str) -> str:
    """A number of things.

    >>> _counted(1, "outage"), _counted(3, "outage")
    ('1 outage', '3 outages')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _warned_figures(warned: WarningScores) -> list[tuple[str, Markup]]:
    """Captions and drawings of what there is enough of."""
    if not len(warned.duration_pit):
        return []
    caption = "Where lengths lay in what was said of them; level is right."
    across = "Share of what was said below the length that came"
    drawn = _ranks("lengths", across, "Outages (%)", warned.duration_pit, LENGTH_BINS)
    return [(caption, Markup(drawn.svg()))]


def _band(result: Backtest) -> float:
    """How far a share of .8 strays by chance over the last days, of which each counts once."""
    days = len(set(result.issues[result.recent].date))
    return TWO_SIGMA * float(np.sqrt(0.8 * 0.2 / max(days, 1)))


def _less_or_more(change: float) -> str:
    return f"{abs(change):.0%} {'less' if change < 0 else 'more'}".replace("%", " %")


def _percent(share: float) -> str:
    """A share in words.

    >>> _percent(0.794)
    '79 %'
    """
    return f"{share:.0%}".replace("%", " %")


def _figures(result: Backtest, quantity: str) -> list[tuple[str, Markup]]:
    """Captions and drawings of a quantity."""
    ranks = result.scores["pit", quantity]
    drawn = (
        (
            "By lead: error beside the references, lower is better; what intervals covered, dashed "
            "is what they should; the last forecast with its 50% and 90% intervals, and what came.",
            _by_lead(result, quantity),
        ),
        (
            "Where what came lay in the forecast; level is right, a hump too wide, a bowl too "
            "narrow.",
            _ranks(
                f"ranks_{quantity}",
                "Share of the forecast below what came",
                "Steps (%)",
                ranks[~np.isnan(ranks)],
                PIT_BINS,
            ),
        ),
        ("What the 80% interval covered, month by month.", _months(result, quantity)),
    )
    return [(caption, Markup(chart.svg())) for caption, chart in drawn]


def _by_lead(result: Backtest, quantity: str) -> Chart:
    """Errors, coverage and the last forecast over the lead."""
    references = (
        ("crps", result.forecaster, Style(BLUE, "", 2.2)),
        ("climatology", "hour of day", Style(BLACK, "6 3", 1.4)),
        ("weekly", "a week before", Style(GREY, "2 2", 1.4)),
    )
    errors = [Curve(words, result.mean(name, quantity), look) for name, words, look in references]
    covered = [
        Curve(f"{share:.0%} interval", 100.0 * result.mean(f"held {share}", quantity), style)
        for share, style in zip(SHARES, RUN_STYLES, strict=False)
    ]
    issued = f"{result.last.start:%Y-%m-%d %H:%M} UTC"
    return Chart(
        f"by_lead_{quantity}",
        f"{WORDS[quantity]}: error, coverage and the last forecast by lead",
        Scale("Lead (h)", np.append(0.0, result.leads_h)),
        [
            Curves("CRPS (kW)", errors, 150.0, low=0.0),
            Curves(
                "Coverage (%)",
                covered,
                150.0,
                low=0.0,
                high=104.0,
                limits=[Limit(100.0 * share, "nominal share") for share in SHARES],
            ),
            _last(result, quantity, f"Forecast of\n{issued}\n(kW)"),
        ],
    )


def _last(result: Backtest, quantity: str, axis: str) -> Curves:
    """The last forecast, intervals behind each other, and what came."""
    forecast, history = result.last, result.history
    paths = totals_of(forecast)[quantity]
    row = history.row_of(forecast.start)
    came = came_in(history, row, len(result.leads_h))[quantity]
    low, q25, median, q75, high = quantiles(paths, [0.05, 0.25, 0.5, 0.75, 0.95])
    return Curves(
        axis,
        [Curve("median", median, Style(BLUE, "", 1.2)), Curve("came", came, Style(VERMILLION))],
        170.0,
        bands=[Band(low, high, BLUE), Band(q25, q75, BLUE)],
    )


def _ranks(key: str, across: str, axis: str, ranks: Floats, bins: int) -> Chart:
    """How ranks between 0 and 1 are spread, beside an even spread."""
    count, edges = np.histogram(ranks, bins=bins, range=(0.0, 1.0))
    share = 100.0 * count / max(count.sum(), 1)
    panel = Curves(
        axis,
        [Curve(axis, share, Style(BLUE), in_legend=False)],
        140.0,
        low=0.0,
        limits=[Limit(100.0 / bins, "level")],
        bands=[Band(np.zeros(bins), share, BLUE)],
    )
    return Chart(key, "Rank of what came", Scale(across, edges), [panel])


def _months(result: Backtest, quantity: str) -> Chart:
    """Coverage by month."""
    months = result.by_month()
    covered = 100.0 * months[quantity].to_numpy(float)
    panel = Curves(
        "80% interval\ncoverage (%)",
        [Curve("coverage", covered, Style(BLUE), in_legend=False)],
        140.0,
        low=0.0,
        high=104.0,
        limits=[Limit(80.0, "nominal share")],
    )
    scale = Scale("Month", np.arange(len(months) + 1.0), list(months.index))
    return Chart(f"months_{quantity}", "Coverage by month", scale, [panel])
