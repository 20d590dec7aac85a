"""The page and the tables of a back-test."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vppres.core.arrays import Floats
from vppres.forecasts.interface import quantiles
from vppres.io.atomic import RUN_MARK, atomic_folder, atomic_write_text
from vppres.report.key_figures import number
from vppres.report.pages import page
from vppres.report.plots.palette import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILLION
from vppres.studies.backtest import Backtest
from vppres.studies.drawing import draw_grid, embedded
from vppres.studies.estimate_scores import EstimateScores
from vppres.studies.issue_scores import ENERGY_H, SHARES
from vppres.studies.warning_scores import WarningScores

Scores = TypeVar("Scores")

PAGE_FILE = "backtest.html"
TEMPLATE = "backtest.html.j2"
SIZE_IN = (4.6, 3.2)
WORDS = {"load": "Load", "pv": "PV power", "net": "Load less PV power"}
SHARE_COLOURS = dict(zip(SHARES, (GREEN, BLUE, ORANGE), strict=True))
PIT_BINS = 10
LENGTH_BINS = 5
TWO_SIGMA = 1.96


def write_backtest(
    result: Backtest, folder: Path, title: str, warned: WarningScores | None = None
) -> dict[str, Any]:
    """Write page, tables and summary into a folder; returns the summary.

    Parameters
    ----------
    result : Backtest
        The scores.
    folder : Path
        A folder that does not exist yet, or an older back-test.
    title : str
        What was tested, for the heading.
    warned : WarningScores, optional
        Outage warnings, scored beside the forecasts.
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
            "leads": _held_by_lead(result),
            "energy": result.energy().to_dict("records"),
            "drift": result.drift().to_dict("records"),
            "band": _band(result),
            "shares": [f"{share:.0%}" for share in SHARES],
            "figures": [
                (
                    WORDS[quantity],
                    [
                        (caption, embedded(_figure(draw, result, quantity)))
                        for caption, draw in FIGURES
                    ],
                )
                for quantity in result.quantities
            ],
            "warned": warned,
            "warned_figures": [] if warned is None else _warned_figures(warned),
            "number": number,
        },
    )


def backtest_findings(result: Backtest, warned: WarningScores | None = None) -> list[str]:
    """What a reader is to know first, in sentences."""
    ranges = result.ranges()
    held = result.by_lead()
    energy = result.energy()
    sentences = []
    for quantity in result.quantities:
        changes = ranges[ranges["quantity"] == quantity].to_dict("records")
        against = ", ".join(
            f"{_less_or_more(row['to_climatology'])} up to {row['until_h']} h" for row in changes
        )
        by_lead = held.loc[held["quantity"] == quantity, "held_80%"]
        sentences.append(
            f"{WORDS[quantity]}: error (CRPS) against what is usual at the time of day: {against}. "
            f"The 80 % interval held {_percent(by_lead.mean())} ({_percent(by_lead.min())} to "
            f"{_percent(by_lead.max())} by lead)."
        )
    day = energy[(energy["quantity"] == result.quantities[-1]) & (energy["hours"] == 24)]
    if len(day):
        sentences.append(
            f"{WORDS[result.quantities[-1]]}, energy of 24 h: the 80 % interval held "
            f"{_percent(day['held_80%'].iloc[0])}."
        )
    sentences += _drift_findings(result)
    return sentences if warned is None else [*sentences, *_warned_findings(warned)]


def _drift_findings(result: Backtest) -> list[str]:
    """Quantities whose spread has left the band in the last days."""
    band = _band(result)
    return [
        f"{WORDS[row['quantity']]}: in the last 30 days the 80 % interval held "
        f"{_percent(row['held_80%_recent'])}, outside of {_percent(0.8 - band)} to "
        f"{_percent(min(0.8 + band, 1.0))}: the spread no longer fits."
        for row in result.drift().to_dict("records")
        if abs(row["held_80%_recent"] - 0.8) > band
    ]


def _warned_findings(warned: WarningScores) -> list[str]:
    """What warnings were worth."""
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


def _warned_figures(warned: WarningScores) -> list[tuple[str, str]]:
    """Captions and pictures of what there is enough of."""
    drawn = []
    if len(warned.reliability):
        caption = "How often an outage came of warnings that said as much; bars: a right forecast."
        drawn.append((caption, embedded(_small(_draw_reliability, warned))))
    if len(warned.duration_pit):
        caption = "Where lengths lay in what was said of them; level is right."
        drawn.append((caption, embedded(_small(_draw_lengths, warned))))
    return drawn


def _draw_reliability(ax: Axes, warned: WarningScores) -> None:
    table = warned.reliability
    said = 100.0 * table["said"]
    middle = 50.0 * (table["low"] + table["high"])
    half = 50.0 * (table["high"] - table["low"])
    ax.errorbar(said, middle, half, fmt="none", ecolor=GREY, elinewidth=6.0, alpha=0.6)
    ax.plot([0.0, 100.0], [0.0, 100.0], color=BLACK, linewidth=1.0, linestyle=(0, (4, 2)))
    ax.plot(said, 100.0 * table["came"], color=BLUE, marker="o", linestyle="none")
    for x, y, count in zip(said, 100.0 * table["came"], table["warnings"], strict=True):
        ax.annotate(f"{count}", (x, y), (6, 4), textcoords="offset points", fontsize=8)
    ax.set_xlim(-4.0, 104.0)
    ax.set_ylim(-4.0, 104.0)
    ax.set_xlabel("Said (%)")
    ax.set_ylabel("Came (%)")


def _draw_lengths(ax: Axes, warned: WarningScores) -> None:
    _pit_bars(ax, warned.duration_pit, LENGTH_BINS)
    ax.set_xlabel("Share of what was said below the length that came")
    ax.set_ylabel("Outages (%)")


def _band(result: Backtest) -> float:
    """How far a share of .8 strays by chance over the last days, of which each counts once."""
    days = len(set(result.issues[result.recent].date))
    return TWO_SIGMA * float(np.sqrt(0.8 * 0.2 / max(days, 1)))


def _held_by_lead(result: Backtest) -> list[dict[str, Any]]:
    """What intervals held, at some leads."""
    table = result.by_lead()
    chosen = [lead for lead in (1, 2, 3, 6, 12, 24, 36, 48) if lead <= result.plan.horizon_h]
    rows = table[table["lead_h"].isin(chosen) & table["held_80%"].notna()]
    return [{str(name): value for name, value in row.items()} for row in rows.to_dict("records")]


def _less_or_more(change: float) -> str:
    return f"{abs(change):.0%} {'less' if change < 0 else 'more'}".replace("%", " %")


def _percent(share: float) -> str:
    """A share in words.

    >>> _percent(0.794)
    '79 %'
    """
    return f"{share:.0%}".replace("%", " %")


def _figure(draw: Callable[[Axes, Backtest, str], None], result: Backtest, quantity: str) -> Figure:
    """One small figure of a quantity."""
    return _small(lambda ax, scores: draw(ax, scores, quantity), result)


def _small(draw: Callable[[Axes, Scores], None], scores: Scores) -> Figure:
    """One small figure of scores."""
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    ax = figure.subplots()
    draw_grid(ax)
    draw(ax, scores)
    return figure


def _draw_crps(ax: Axes, result: Backtest, quantity: str) -> None:
    lines = (
        ("crps", result.forecaster, BLUE, "-", 2.2),
        ("climatology", "hour of day", BLACK, (0, (5, 2)), 1.4),
        ("weekly", "a week before", GREY, (0, (1, 1)), 1.4),
    )
    for name, words, colour, style, width in lines:
        ax.plot(
            result.leads_h,
            result.mean(name, quantity),
            color=colour,
            linestyle=style,
            linewidth=width,
            label=words,
        )
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("CRPS (kW)")
    ax.set_xlabel("Lead (h)")
    ax.legend(frameon=False, fontsize=8)


def _draw_held(ax: Axes, result: Backtest, quantity: str) -> None:
    for share, colour in SHARE_COLOURS.items():
        held = 100.0 * result.mean(f"held {share}", quantity)
        ax.plot(result.leads_h, held, color=colour, label=f"{share:.0%}".replace("%", " %"))
        ax.axhline(100.0 * share, color=colour, linewidth=0.8, linestyle=(0, (4, 2)))
    ax.set_ylim(30.0, 100.0)
    ax.set_ylabel("Held (%)")
    ax.set_xlabel("Lead (h)")
    ax.legend(frameon=False, fontsize=8, ncols=3, loc="lower right")


def _draw_pit(ax: Axes, result: Backtest, quantity: str) -> None:
    values = result.scores["pit", quantity]
    _pit_bars(ax, values[~np.isnan(values)], PIT_BINS)
    ax.set_xlabel("Share of the forecast below what came")
    ax.set_ylabel("Steps (%)")


def _pit_bars(ax: Axes, values: Floats, bins: int) -> None:
    """How values between 0 and 1 are spread, beside what an even spread is."""
    count, edges = np.histogram(values, bins=bins, range=(0.0, 1.0))
    share = 100.0 * count / max(count.sum(), 1)
    ax.bar(edges[:-1], share, width=1.0 / bins, align="edge", color=BLUE, edgecolor="white")
    ax.axhline(100.0 / bins, color=BLACK, linewidth=1.0, linestyle=(0, (4, 2)))


def _draw_energy(ax: Axes, result: Backtest, quantity: str) -> None:
    table = result.energy()
    table = table[table["quantity"] == quantity]
    place = np.arange(len(table), dtype=float)
    for i, (share, colour) in enumerate(SHARE_COLOURS.items()):
        held = 100.0 * table[f"held_{share:.0%}"].to_numpy(float)
        words = f"{share:.0%}".replace("%", " %")
        ax.bar(place + 0.27 * (i - 1), held, width=0.25, color=colour, label=words)
        ax.axhline(100.0 * share, color=colour, linewidth=0.8, linestyle=(0, (4, 2)))
    ax.set_xticks(place, labels=[f"{hours} h" for hours in table["hours"]])
    ax.set_ylim(0.0, 119.0)
    ax.set_yticks(range(0, 101, 20))
    ax.legend(frameon=False, fontsize=8, ncols=3, loc="upper center")
    ax.set_xlabel("Energy of the first")
    ax.set_ylabel("Held (%)")


def _draw_months(ax: Axes, result: Backtest, quantity: str) -> None:
    months = result.by_month()
    ax.plot(range(len(months)), 100.0 * months[quantity], color=BLUE, marker="o")
    ax.axhline(80.0, color=BLACK, linewidth=1.0, linestyle=(0, (4, 2)))
    every = -(-len(months) // 6)
    ax.set_xticks(range(0, len(months), every), labels=list(months.index)[::every], fontsize=8)
    ax.set_ylim(50.0, 100.0)
    ax.set_ylabel("80 % interval held (%)")


def _draw_last(ax: Axes, result: Backtest, quantity: str) -> None:
    forecast = result.last
    row = result.history.row_of(forecast.start)
    load, pv = (
        values[row : row + len(result.leads_h)].sum(axis=1)
        for values in (result.history.load_kw, result.history.pv_kw)
    )
    paths, came = {
        "load": (forecast.load_kw.sum(axis=2), load),
        "pv": (forecast.pv_kw.sum(axis=2), pv),
        "net": (forecast.net_kw, load - pv),
    }[quantity]
    _fan(ax, result.leads_h, paths, came)
    ax.set_xlabel(f"Hours after {forecast.start:%Y-%m-%d %H:%M} UTC")
    ax.set_ylabel("kW")


def _fan(ax: Axes, x: Floats, paths: Floats, came: Floats) -> None:
    """Intervals behind each other, and what came."""
    for share, tone in ((0.9, 0.18), (0.5, 0.35)):
        low, high = quantiles(paths, [0.5 - share / 2, 0.5 + share / 2])
        ax.fill_between(
            x, low, high, color=BLUE, alpha=tone, linewidth=0, label=f"{100 * share:.0f} %"
        )
    ax.plot(x, quantiles(paths, 0.5), color=BLUE, linewidth=1.0, label="median")
    ax.plot(x, came, color=VERMILLION, linewidth=1.6, label="came")
    ax.legend(frameon=False, fontsize=8, ncols=2)


FIGURES: tuple[tuple[str, Callable[[Axes, Backtest, str], None]], ...] = (
    ("Error by lead, beside the references; lower is better.", _draw_crps),
    ("What intervals held, by lead; dashed is what they should.", _draw_held),
    (
        "Where what came lay in the forecast; level is right, a hump too wide, a bowl too narrow.",
        _draw_pit,
    ),
    (f"What intervals of the energy of {', '.join(map(str, ENERGY_H))} h held.", _draw_energy),
    ("What the 80 % interval held, month by month.", _draw_months),
    ("The last forecast and what came.", _draw_last),
)
