"""Figures of one run, or of several runs of the same day side by side.

Quantities that hold over a step are drawn as steps, states at an instant as points joined by
lines. Runs differ in colour, line style and marker, so that the figures survive a grey print and
colour-blind eyes.
"""

from __future__ import annotations

from vppres.day.series import (
    battery_power_kw,
    demand_kw,
    edges_of,
    energy_limits_kwh,
    line_values,
    lowest_model_v_pu,
    outage_spans,
    pv_available_kw,
    served_kw,
    stored_energy_kwh,
)
from vppres.report.plots.base import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    OUTAGE_COLOUR,
    PURPLE,
    RULE_COLOUR,
    RUN_STYLES,
    SERVED,
    SKY,
    SVG_HASH_SALT,
    TIER_STYLES,
    UNSERVED,
    VERMILLION,
    Runs,
    draw_grid,
    plain,
    save_figure,
)
from vppres.report.plots.energy import energy_and_price, import_load_pv, voltages
from vppres.report.plots.feeder import feeder_maps, line_loadings, solve_times
from vppres.report.plots.files import (
    FIGURE_TEXTS,
    FIGURES,
    RUN_FIGURES,
    draw_figure,
    figure_names,
    save_figures,
)
from vppres.report.plots.service import MAX_NAMED_CUSTOMERS, service_by_tier
from vppres.report.plots.strips import timeline

__all__ = [
    "BLACK",
    "BLUE",
    "FIGURES",
    "FIGURE_TEXTS",
    "GREEN",
    "GREY",
    "MAX_NAMED_CUSTOMERS",
    "ORANGE",
    "OUTAGE_COLOUR",
    "PURPLE",
    "RULE_COLOUR",
    "RUN_FIGURES",
    "RUN_STYLES",
    "SERVED",
    "SKY",
    "SVG_HASH_SALT",
    "TIER_STYLES",
    "UNSERVED",
    "VERMILLION",
    "Runs",
    "battery_power_kw",
    "demand_kw",
    "draw_figure",
    "draw_grid",
    "edges_of",
    "energy_and_price",
    "energy_limits_kwh",
    "feeder_maps",
    "figure_names",
    "import_load_pv",
    "line_loadings",
    "line_values",
    "lowest_model_v_pu",
    "outage_spans",
    "plain",
    "pv_available_kw",
    "save_figure",
    "save_figures",
    "served_kw",
    "service_by_tier",
    "solve_times",
    "stored_energy_kwh",
    "timeline",
    "voltages",
]
