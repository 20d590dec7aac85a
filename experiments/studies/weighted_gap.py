"""What the relative gap of a weighted objective leaves open, in the unit of each of its terms.

A solver that stops at a gap of 1e-4 does not know which term the rest belongs to. Where service is
worth 80 and a GBP weighs 1e-6, the rest is worth GBP 8,000: more than a window costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vppres.core.arrays import Floats
from vppres.scenario.scenario import Scenario

GAP_REL = 1e-4
"""Relative gap at which most mixed-integer solvers stop unless they are told otherwise."""


@dataclass(frozen=True)
class TermBesideGap:
    """A term of the objective in its own unit."""

    #: What it counts.
    name: str
    unit: str
    #: How much of it weighs as much as the gap; infinite for a term without weight.
    left_open: float
    #: Most of it that a plan decides: what batteries can move of the cost by filling up in the
    #: cheapest step and emptying in the dearest, and all of the others if everyone is served.
    whole: float

    @property
    def lost(self) -> bool:
        """Whether all of the term weighs less than the gap, although it has a weight."""
        return 0.0 < self.whole <= self.left_open < np.inf

    def __str__(self) -> str:
        return f"{self.name} ({self.whole:.3g} {self.unit})"


def service_of(scenario: Scenario, n_steps: int) -> float:
    """Weighted customer hours of everyone in so many steps."""
    return float(scenario.customers.weight.sum() * scenario.grid.dt_h * n_steps)


def terms_beside_gap(
    scenario: Scenario, n_steps: int, gap_rel: float = GAP_REL
) -> list[TermBesideGap]:
    """The terms of the objective beside what a gap leaves open of each.

    Parameters
    ----------
    scenario : Scenario
        Whose weights, series and network.
    n_steps : int
        Steps of a window; of all windows that long the one with the most of a term counts.
    gap_rel : float, optional
        Relative gap.

    Examples
    --------
    >>> from vppres.io.find import load_scenario
    >>> [term.name for term in terms_beside_gap(load_scenario("uk-heatwave-2022"), 6) if term.lost]
    ['the cost that batteries move', 'line losses', 'reactive power']
    """
    w = scenario.objective
    dt_h = scenario.grid.dt_h
    open_ = gap_rel * service_of(scenario, n_steps)
    kwh_per_f4 = dt_h / (1000.0 * scenario.network.base_kv**2)
    devices = float(len(scenario.batteries) + len(scenario.pv))
    return [
        TermBesideGap(
            "the cost that batteries move",
            "GBP",
            _worth(open_, w.lambda_grid),
            _moved_gbp(scenario, n_steps),
        ),
        TermBesideGap(
            "curtailed energy",
            "kWh",
            _worth(open_, w.lambda_curt),
            _most(scenario.pv_kw.sum(axis=1) * dt_h, n_steps),
        ),
        TermBesideGap(
            "line losses",
            "kWh",
            kwh_per_f4 * _worth(open_, w.lambda_l),
            kwh_per_f4 * _most(_f4_of_demand(scenario), n_steps),
        ),
        TermBesideGap(
            "reactive power",
            "inverters at full use",
            _worth(open_, w.lambda_q),
            devices * min(n_steps, scenario.grid.n_steps),
        ),
    ]


def _f4_of_demand(scenario: Scenario) -> Floats:
    """The flows' term of each step if everyone is served by the grid alone, (T,), in ohm kVA²."""
    net = scenario.network
    customers = scenario.customers
    behind = net.downstream @ net.place(customers.bus)
    p_kw = scenario.load_kw @ behind.T
    q_kvar = (scenario.load_kw * customers.q_per_p) @ behind.T
    return np.asarray((p_kw**2 + q_kvar**2) @ net.r_ohm)


def _moved_gbp(scenario: Scenario, n_steps: int) -> float:
    """Cheapest to dearest price of a window, for all that batteries hold between their limits."""
    b = scenario.batteries
    usable_kwh = float(b.energy_kwh @ (b.soc_max - b.soc_min))
    width = min(n_steps, scenario.grid.n_steps)
    prices = np.lib.stride_tricks.sliding_window_view(scenario.price_gbp_per_kwh, width)
    return usable_kwh * float(np.ptp(prices, axis=1).max())


def _most(per_step: Floats, n_steps: int) -> float:
    """Largest sum over so many consecutive steps."""
    return float(np.convolve(per_step, np.ones(min(n_steps, len(per_step))), "valid").max())


def _worth(open_: float, weight: float) -> float:
    """How much of a term weighs as much as what is open."""
    return open_ / weight if weight > 0.0 else np.inf
