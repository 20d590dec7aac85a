"""Whether lines could bear the currents of their loads: a check of impedances and voltage.

The ratio of resistance to reactance tells the conductor, whatever its length: reactances of lines
hardly differ. Cables have the least, so that no line of this ratio has less resistance a metre.
Impedances that are per unit and read as ohm, or a nominal voltage that is too low, give ordinary
losses and voltages, but currents that melt these conductors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vppres.core.units import kva_to_a
from vppres.scenario.network import LOW_VOLTAGE_KV

if TYPE_CHECKING:
    from vppres.scenario.scenario import Scenario

LOW_VOLTAGE_X, MEDIUM_VOLTAGE_X = 0.08, 0.1
"""Least reactance of a line in ohm/km: that of cables."""

MOST_W_PER_M = 20.0
"""Losses of a phase that a line of this resistance gets rid of. Cables at their rating have 15 to
20 W/m; published feeders that are sound stay below 16 W/m, most below 5."""


def heat_w_per_m(scenario: Scenario) -> float:
    """Losses of a phase and metre at the largest demand: at least, and weighted by the losses.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> round(heat_w_per_m(load_scenario("uk-heatwave-2022")), 1)
    2.8
    """
    net = scenario.network
    step = int(scenario.load_kw.sum(axis=1).argmax())
    drawn = net.downstream @ net.place(scenario.customers.bus)
    s_kva = np.hypot(drawn @ scenario.load_kw[step], drawn @ scenario.load_kvar[step])
    a = kva_to_a(s_kva, net.base_kv)
    inductive = net.x_ohm > 0.0
    ratio = np.divide(net.r_ohm, net.x_ohm, out=np.zeros(net.n_lines), where=inductive)
    x_per_km = LOW_VOLTAGE_X if net.base_kv <= LOW_VOLTAGE_KV else MEDIUM_VOLTAGE_X
    lost = np.where(inductive, net.r_ohm * a**2, 0.0)
    total = float(lost.sum())
    return float(lost @ (a**2 * x_per_km * ratio)) / (1e3 * total) if total else 0.0


def hot_lines(scenario: Scenario) -> str:
    """Sentence on impedances or a voltage that fit no conductor; empty if they do."""
    if scenario.phases:
        return ""  # the lines of its phases are others
    found = heat_w_per_m(scenario)
    if found <= MOST_W_PER_M:
        return ""
    net = scenario.network
    return (
        f"lines.csv: at the largest demand a phase loses {found:,.3g} W a metre or more where "
        f"losses are, by the ratio of r_ohm to x_ohm; cables bear up to {MOST_W_PER_M:g}. Are the "
        f"impedances per unit, or mis-scaled, or is base_kv = {net.base_kv:g} too low? The numbers "
        "of lines.csv are ohm."
    )
