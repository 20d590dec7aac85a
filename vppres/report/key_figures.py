"""Key figures in words: what each is called, its unit, and how it is written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from vppres.core.text import in_pounds

NOT_DEFINED = "\N{EN DASH}"

# Key of the summary, words, unit, format.
KEY_FIGURES = (
    ("resilience", "Resilience: weighted share supplied in the outage", "", ".4f"),
    ("resilience_planned", "Planned resilience", "", ".4f"),
    ("cost_gbp", "Cost of imported energy", "GBP", ",.2f"),
    ("import_kwh", "Imported energy", "kWh", ",.1f"),
    ("export_kwh", "Exported energy", "kWh", ",.1f"),
    ("export_revenue_gbp", "Export revenue", "GBP", ",.2f"),
    ("net_cost_gbp", "Cost of imported energy less export revenue", "GBP", ",.2f"),
    ("pv_curtailed_kwh", "Curtailed PV energy", "kWh", ",.1f"),
    ("energy_not_supplied_kwh", "Energy not supplied", "kWh", ",.1f"),
    ("energy_not_supplied_gbp", "Energy not supplied, at the value of lost load", "GBP", ",.0f"),
    ("interruptions_per_customer", "Interruptions per customer (SAIFI)", "", ".3f"),
    ("minutes_lost_per_customer", "Minutes lost per customer (SAIDI, CML)", "min", ",.1f"),
    ("v_min_ac_pu", "Lowest AC voltage", "pu", ".4f"),
    ("v_max_ac_pu", "Highest AC voltage", "pu", ".4f"),
    ("v_mean_of_min_ac_pu", "Mean over the steps of the lowest AC voltage", "pu", ".4f"),
    ("v_error_max_pu", "Largest voltage difference, optimisation to AC", "pu", ".4f"),
    ("line_current_max_a", "Largest line current", "A", ",.1f"),
    ("line_loading_max", "Largest line loading, as a share of the rating", "", ".1%"),
    ("import_above_limit_max_kw", "Largest import above the limit of the grid", "kW", ",.2f"),
    ("island_import_max_kw", "Largest power drawn from the slack bus in the outage", "kW", ",.2f"),
    ("island_export_max_kw", "Largest surplus at the slack bus in the outage", "kW", ",.2f"),
    (
        "island_reactive_max_kvar",
        "Largest reactive power of the slack bus in the outage",
        "kvar",
        ",.1f",
    ),
    ("corrections", "Steps in which the plan was corrected", "", "d"),
    ("fallbacks", "Steps decided by a fallback", "", "d"),
    ("estimated_steps", "Steps with measurements that were estimated", "", "d"),
    (
        "ac_failures",
        "Steps in which load was shed because the AC power flow had no solution",
        "",
        "d",
    ),
    ("ac_not_found", "Steps whose AC power flow did not converge; no load was shed", "", "d"),
    ("gap_max", "Largest relative optimality gap", "", ".1e"),
)

OF_TIERS = (
    ("served_share", "Share served in the outage", "", ".4f"),
    ("minutes_off_max", "Longest time off supply of a customer", "min", ",.0f"),
    ("minutes_off_gini", "Gini coefficient of the minutes off supply", "", ".3f"),
)
"""The same of figures that each tier has its own of."""

OF_EXPORT = ("export_kwh", "export_revenue_gbp", "net_cost_gbp")
"""Keys of figures that say nothing where nothing was exported."""


def key_figures(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Words, value and unit of each key figure that is defined; of export if there was any."""
    return [
        (words, number(summary[key], form), unit)
        for key, words, unit, form in KEY_FIGURES
        if summary.get(key) is not None and (key not in OF_EXPORT or summary.get("export_kwh"))
    ]


def number(value: float | None, form: str) -> str:
    """A number in the given format, a dash where it is not defined; what rounds to 0 has no sign.

    >>> number(0.91873, ".3f"), number(None, ".3f"), number(-0.001, "+.2f")
    ('0.919', '\u2013', '0.00')
    """
    if value is None or pd.isna(value):
        return NOT_DEFINED
    text = format(value, form)
    return text if any(digit in text for digit in "123456789") else text.lstrip("+-")


def amount(gbp: float) -> str:
    """An amount of money, to a penny.

    >>> amount(20321.4), amount(-3.0)
    ('£20,321.40', '-£3.00')
    """
    return in_pounds(gbp, ",.2f")
