"""The figure of ``docs/forecasts.md``: ``python docs/forecast_figure.py BACKTEST_FOLDER``."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.frame.pages import save_figure
from experiments.drawing import draw_grid
from vppres.report.plots.drawing import BLACK, BLUE, GREEN, ORANGE

STYLES = {"load": ("load", BLUE), "pv": ("PV power", ORANGE), "net": ("load less PV", GREEN)}
TARGET = Path(__file__).parent / "_static" / "forecasts"


def figure(table: pd.DataFrame) -> Figure:
    """Error against the hour of the day, and what the 80 % interval held, by lead."""
    drawn = Figure(figsize=(8.6, 3.3), layout="constrained")
    error, held = drawn.subplots(1, 2)
    for quantity, (words, colour) in STYLES.items():
        rows = table[table["quantity"] == quantity]
        ratio = 100.0 * (rows["crps_kw"] / rows["crps_climatology_kw"] - 1.0)
        error.plot(rows["lead_h"], ratio, color=colour, label=words)
        held.plot(rows["lead_h"], 100.0 * rows["held_80%"], color=colour, label=words)
    error.axhline(0.0, color=BLACK, linewidth=1.0)
    error.set_ylabel("CRPS against the hour of the day (%)")
    error.legend(frameon=False, fontsize=8)
    held.axhspan(77.0, 83.0, color="#EEEEEE")
    held.axhline(80.0, color=BLACK, linewidth=1.0, linestyle=(0, (4, 2)))
    held.set_ylim(65.0, 95.0)
    held.set_ylabel("80 % interval held (%)")
    for ax in (error, held):
        ax.set_xlabel("Lead (h)")
        draw_grid(ax)
    return drawn


if __name__ == "__main__":
    save_figure(figure(pd.read_csv(Path(sys.argv[1]) / "by_lead.csv")), TARGET)
    TARGET.with_suffix(".png").unlink()
