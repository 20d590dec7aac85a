"""The masters of service and cost: by binaries, or by counts in long windows.

``docs/method.md``, *Service by counts* and *Switching rules*.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from vppres.core.arrays import Flags, Floats
from vppres.model.data import WindowData
from vppres.solve.cache import ModelCache
from vppres.solve.deadline import Deadline
from vppres.solve.fleet.counts import Counts
from vppres.solve.fleet.demand import DemandModel
from vppres.solve.fleet.relaxation import (
    FleetProblem,
    fleet_of,
    fleet_problem,
    weight_grid,
    whole_price,
)
from vppres.solve.programs import GAP_SHARE, SOLVED, WHOLE_GAP, search_options
from vppres.solve.result import Outcome, Status
from vppres.solve.solvers import SolverSpec, run
from vppres.solve.task import WindowTask

MOST_BINARIES = 600
"""Customers times steps up to which a window is searched with a binary for each. Beyond, that takes
a second and more; whole numbers for each weight are fewer, and cuts stand for the fleet."""

ALIKE = 1e-4
"""Spread of efficiencies up to which the fleet is lumped into one battery first: beyond it, one
battery of the best efficiencies says too little, and the search begins with every battery."""


class Master(Protocol):
    """Finds supply schedules and bounds of a window in a relaxation without the network.

    ``unit`` is the granularity of the weights. Searches end at the deadline, which the caller may
    set anew.
    """

    unit: float
    deadline: Deadline

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, within the window's gap in units, and a set that has it."""

    def cost(
        self, units_min: float, everyone: bool, known_gbp: float, gap_gbp: float
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units; a bound is enough within a known cost's gap.

        With ``everyone`` no customer is left out where the import has no limit.
        """


class Binaries:
    """The relaxation with a binary for each customer and step.

    Parameters
    ----------
    cache : ModelCache
        Compiled problems of the site.
    data : WindowData
        The window.
    spec : SolverSpec
        Solves it.
    deadline : Deadline
        When service and cost must be done.
    lumped : bool
        Whether the fleet is one battery.
    """

    def __init__(
        self,
        cache: ModelCache,
        data: WindowData,
        spec: SolverSpec,
        deadline: Deadline,
        lumped: bool,
    ) -> None:
        self.cache = cache
        self.data = data
        self.spec = spec
        self.deadline = deadline
        self.lumped = lumped
        self.unit = weight_grid(cache.site.customers.weight * cache.site.dt_h)
        self.best: Flags | None = None

    @property
    def applies(self) -> bool:
        """Whether weights and prices of switching have a grid."""
        return self.unit > 0.0 and whole_price(self.data, self.unit)

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, f3 rounded in favour to a whole number, and a set that has it."""
        problem = fleet_problem(self.cache, self.data, self.lumped, integer=True, goal="service")
        problem.write(self.data, all_connected=True, eased=True)
        open_units = GAP_SHARE * gap
        if not self.data.keeps_service:
            open_units = max(WHOLE_GAP, open_units)
        left_s = self.deadline.left_s
        outcome = search_for_set(problem, self.data, self.spec, open_units, left_s)
        if not self.data.keeps_service:
            # The objective is whole, so the bound may be rounded down.
            outcome = replace(outcome, bound=float(np.floor(outcome.bound + SOLVED)))
        self.best = set_of(problem, outcome)
        return outcome, self.best

    def cost(
        self, units_min: float, everyone: bool, known_gbp: float, gap_gbp: float
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units; the LP relaxation first, which may do."""
        relaxed = self._with_units(units_min, everyone, integer=False)
        bound = run(relaxed, self.spec, 0.0, self.deadline.left_s)
        near = not np.isfinite(gap_gbp) or bound.bound >= known_gbp - gap_gbp
        if near or bound.status != Status.OPTIMAL:
            return bound, None
        problem = self._with_units(units_min, everyone, integer=True)
        left_s = self.deadline.left_s
        outcome = search_for_set(problem, self.data, self.spec, gap_gbp, left_s, first=self.best)
        if not outcome.status.has_answer:
            return replace(bound, status=Status.TIME_LIMIT), None
        return outcome, set_of(problem, outcome)

    def _with_units(self, units_min: float, everyone: bool, integer: bool) -> FleetProblem:
        """The relaxation of all sets with so many units."""
        problem = fleet_problem(self.cache, self.data, self.lumped, integer, "cost")
        problem.service_min = units_min * self.unit
        problem.write(self.data, all_connected=everyone, eased=True)
        return problem


def set_of(problem: FleetProblem, outcome: Outcome) -> Flags | None:
    """Who is served by the last answer."""
    return problem.value_of("x_served") > 0.5 if outcome.status.has_answer else None


def search_for_set(
    problem: FleetProblem,
    data: WindowData,
    spec: SolverSpec,
    gap_abs: float,
    time_s: float,
    scale: float = 1.0,
    first: Flags | None = None,
) -> Outcome:
    """How a search for a set ended that begins with a known one, where there is any.

    ``scale`` is a factor in the problem's objective as in ``run``.
    """
    more = search_options(problem.fleet.site, data)
    return run(problem, spec, gap_abs, time_s, scale, more, first)


def master_of(task: WindowTask, lumped: bool, deadline: Deadline) -> Master | None:
    """The master of a window, with one equivalent battery or every battery; None without a grid.

    Counts need steps in which every customer is free: switching rules join them. They ask the fleet
    by a linear problem, which what is switched beyond the paper is not.
    """
    data = task.data
    if data.switching is None and not task.own and data.load_kw.size > MOST_BINARIES:
        model = demand_of(task.cache, data, lumped)
        return Counts(model, data, deadline) if model.grid else None
    master = Binaries(task.cache, data, task.spec, deadline, lumped)
    return master if master.applies else None


def demand_of(cache: ModelCache, data: WindowData, lumped: bool) -> DemandModel:
    """What the fleet can carry in a window of that length and mode."""
    return cache.problem(DemandModel, fleet=fleet_of(cache, data, lumped))


def fleets_of(data: WindowData) -> tuple[bool, ...]:
    """Whether batteries are lumped, in the order of trial; a fleet of none is one fleet.

    Phases tell batteries apart: as one they could give their power to any.
    """
    if len(data.soc) == 0:
        return (True,)
    if data.phased is not None:
        return (False,)
    alike = _spread(data.eta_charge) + _spread(data.eta_discharge) < ALIKE
    return (True, False) if alike else (False,)


def _spread(values: Floats) -> float:
    """Difference of the largest and the smallest value, 0 for none."""
    return float(np.ptp(values)) if len(values) else 0.0
