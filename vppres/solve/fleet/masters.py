"""The masters of service and cost: by counts where a step's service is free, else by binaries."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.model.data import WindowData
from vppres.solve.dispatch import ModelCache
from vppres.solve.fleet.counts import Counts
from vppres.solve.result import Outcome
from vppres.solve.solvers import SolverSpec, run

COST_GAP_REL = 1e-3
"""Gap of the cost level's search over served sets, relative to the cost."""


class Master(Protocol):
    """Finds served sets and bounds of a window in a lumped relaxation.

    ``unit`` is the weights' grid, ``prefix`` begins the names of its stages.
    """

    prefix: str
    unit: float

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units to a gap, and a set that has it."""

    def cost(self, units_min: float, everyone: bool, known_gbp: float,
             gap_gbp: float) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units; a bound is enough within a known cost's gap.

        With ``everyone`` nobody is left out where the import has no limit.
        """


# Master of a window and its seconds, None where it does not apply.
MastersOf = Callable[[ModelCache, WindowData, SolverSpec, float], Master | None]


class Binaries:
    """The lumped relaxation with a binary for each customer and step."""

    prefix = "binary_"

    def __init__(self, cache: ModelCache, data: WindowData, spec: SolverSpec, time_s: float,
                 lumped: bool) -> None:
        self.cache = cache
        self.data = data
        self.spec = spec
        self.lumped = lumped
        self.model = cache.aggregate(data, lumped=lumped)
        self.unit = self.model.grid
        self.end = time.perf_counter() + time_s

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, f3 rounded in favour to a whole number, and a set that has it."""
        self.model.fill(self.data, all_connected=True)
        outcome = run(self.model.grid_problem, self.spec, 0.99, self.end - time.perf_counter())
        # The objective is whole, so the bound may be rounded down.
        outcome = replace(outcome, bound=float(np.floor(outcome.bound + 1e-6)))
        return outcome, self._set(outcome)

    def cost(self, units_min: float, everyone: bool, known_gbp: float,
             gap_gbp: float) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units; linear where any gap will do."""
        integer = np.isfinite(gap_gbp)
        model = self.model if integer else self.cache.aggregate(self.data, False, self.lumped)
        model.fill(self.data, all_connected=everyone)
        model.service_min.value = units_min * self.unit
        outcome = run(model.cost_problem, self.spec, gap_gbp if integer else 0.0,
                      self.end - time.perf_counter())
        return outcome, self._set(outcome) if integer else None

    def _set(self, outcome: Outcome) -> Flags | None:
        """Who is served by the last answer."""
        return np.asarray(self.model.x.value) > 0.5 if outcome.status.has_answer else None


def counts(cache: ModelCache, data: WindowData, spec: SolverSpec, time_s: float,
           lumped: bool) -> Master | None:
    """The master by counts, where weights have a grid and no rule joins a step to another."""
    model = cache.demand(data, lumped)
    joined = data.switching is not None
    return None if joined or not model.relaxation.grid else Counts(model, data, time_s)


def binaries(cache: ModelCache, data: WindowData, spec: SolverSpec, time_s: float,
             lumped: bool) -> Master | None:
    """The master by binaries, where weights and prices of switching have a grid."""
    master = Binaries(cache, data, spec, time_s, lumped)
    return master if master.unit and master.model.whole_price(data) else None


def cost_gap_gbp(cost_gbp: float) -> float:
    """Gap at which the search for a cheaper set may stop."""
    return COST_GAP_REL * cost_gbp + 1e-3


def fleets_of(data: WindowData) -> tuple[bool, ...]:
    """Whether batteries are lumped, in the order of trial.

    A lumped battery says too little where efficiencies differ.
    """
    alike = _spread(data.eta_charge) + _spread(data.eta_discharge) < 1e-4
    return (True, False) if alike else (False,)


def _spread(values: Floats) -> float:
    """Difference of the largest and the smallest value, 0 for none."""
    return float(np.ptp(values)) if len(values) else 0.0
