"""Words on the export of a scenario's connection."""

from __future__ import annotations

from typing import Any

import numpy as np


def words(scenario: Any) -> str:
    """Description of the connection's export limit.

    >>> from vppres.io.find import load_scenario
    >>> words(load_scenario("uk-heatwave-2022"))
    'imports only'
    """
    if not scenario.exports:
        return "imports only"
    limits = scenario.export_max_kw[~scenario.outage]
    least = float(limits.min())
    most = float(limits.max())
    if np.isinf(least):
        return "exports without limit"
    if least == most:
        return f"exports up to {most:g} kW"
    return f"exports up to {least:g} to {most:g} kW"


def remark(scenario: Any) -> str:
    """In how many steps export earns more than import costs; empty where it never does."""
    dear = (scenario.export_max_kw > 0.0) & (scenario.export_price > scenario.price_gbp_per_kwh)
    if not dear.any():
        return ""
    return (
        f"In {int(dear.sum())} of {scenario.grid.n_steps} steps export earns more than import "
        "costs. "
        "No plan does both in the same step, but batteries will buy to sell: check "
        "export_price_gbp_per_kwh, also for its sign, if that is not meant."
    )
