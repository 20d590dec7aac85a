"""The master of service and cost without the network.

``docs/method.md``, *Service step by step* and *Switching rules*.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from vppres.core.arrays import Flags
from vppres.model.data import WindowData
from vppres.solve.certificate import Candidate
from vppres.solve.deadline import Deadline, Stopwatch
from vppres.solve.dispatch import keep_dispatch
from vppres.solve.fleet.recursion import most_units
from vppres.solve.fleet.relaxation import (
    FleetProblem,
    fleet_problem,
    whole_price,
)
from vppres.solve.levels import Relaxation
from vppres.solve.programs import (
    GAP_SHARE,
    HALF_UNIT,
    NODES,
    SOLVED,
    WHOLE_GAP,
    search_options,
)
from vppres.solve.result import Outcome, Status
from vppres.solve.solvers import run
from vppres.solve.task import WindowTask

AS_IT_IS = MappingProxyType({"presolve": "off"})
MANY = 2000
"""Options beyond so many customers times steps: to compare all columns of few rows takes longer
than to solve the problem. A search for a cheaper schedule of 96 steps took ten times as long. With
every battery rows are many: of 3,891, what presolve leaves takes a fraction of the time."""

ALIKE = 1e-4
"""Spread of efficiencies up to which the fleet is lumped into one battery first: beyond it, one
battery of the best efficiencies says too little, and the search begins with every battery."""


class Master(Relaxation):
    """The relaxation without the network, with a binary for each customer and step.

    ``lumped`` has the fleet as one battery; ``stepwise`` asks for service of one battery first,
    step by step.
    """

    def __init__(self, task: WindowTask, lumped: bool, stepwise: bool) -> None:
        super().__init__(task, task.search)
        self.spec = task.spec
        self.lumped = lumped
        self.stepwise = stepwise
        self.best: Flags | None = None

    def service(self, gap: float) -> tuple[Outcome, Flags | None]:
        """Most service in units, f3 rounded in favour to a whole number, and a set that has it.

        The set of one battery has it where the fleet carries it without losing a unit of sun; its
        service is a bound in any case.
        """
        problem = fleet_problem(self.cache, self.data, self.lumped, integer=True, goal="service")
        problem.write(self.data, all_connected=True, eased=True)
        most = np.inf
        if self.stepwise:
            watch = Stopwatch()
            most, served = self._of_one_battery
            if served is not None and self._carries(problem, served, most):
                self.best = served
                return Outcome(Status.OPTIMAL, most, most, watch.spent_s, self.spec.name), served
            problem.write(self.data, all_connected=True, eased=True)
        open_units = GAP_SHARE * gap
        if not self.data.keeps_service:
            open_units = max(WHOLE_GAP, open_units)
        left_s = self.deadline.left_s
        outcome = run(problem, self.spec, open_units, left_s, more=self._of_sets)
        if not self.data.keeps_service:
            # The objective is whole, so the bound may be rounded down.
            outcome = replace(outcome, bound=min(float(np.floor(outcome.bound + SOLVED)), most))
        self.best = set_of(problem, outcome)
        return outcome, self.best

    @cached_property
    def _of_one_battery(self) -> tuple[float, Flags | None]:
        """Most units that one battery carries and a set of so many, if shares of customers say."""
        site = self.site
        problem = fleet_problem(self.cache, self.data, self.lumped, integer=False, goal="service")
        problem.write(self.data, all_connected=True, eased=True)
        outcome = run(problem, self.spec, 0.0, self.deadline.left_s, more=self._options)
        if outcome.status != Status.OPTIMAL:
            return np.inf, None
        units = np.round(site.customers.weight * site.dt_h / self.unit).astype(np.int64)
        able = problem.fleet.able(self.data) > 0.5
        return most_units(site, self.data, able, units, outcome.value)

    @property
    def _options(self) -> Mapping[str, Any]:
        """Options of HiGHS for linear problems, and for searches for a cheaper schedule."""
        return AS_IT_IS if self.lumped and self.data.load_kw.size > MANY else {}

    @property
    def _of_sets(self) -> Mapping[str, Any]:
        """Options of HiGHS for searches for sets."""
        return search_options(self.site, self.data)

    def _carries(self, problem: FleetProblem, served: Flags, units: float) -> bool:
        """Whether the fleet carries a set that is worth so many units."""
        problem.hold(served)
        outcome = run(problem, self.spec, WHOLE_GAP, self.deadline.left_s)
        return outcome.status == Status.OPTIMAL and outcome.value > units - HALF_UNIT

    def least_cost(self, units_min: float, everyone: bool) -> Outcome:
        """Least cost of shares of customers with so many units."""
        relaxed = self._with_units(units_min, everyone, integer=False)
        return run(relaxed, self.spec, 0.0, self.deadline.left_s, more=self._options)

    def cheaper(
        self, units_min: float, everyone: bool, best: Candidate, gap_gbp: float, deadline: Deadline
    ) -> tuple[Outcome, Flags | None]:
        """Least cost of all sets with so many units."""
        problem = self._with_units(units_min, everyone, integer=True)
        more = {**self._of_sets, **self._options, "mip_max_nodes": NODES}
        outcome = run(problem, self.spec, gap_gbp, deadline.left_s, more=more, first=self.best)
        return outcome, set_of(problem, outcome)

    def keep(self, served: Flags) -> None:
        """Keep the dispatch of a set without the network if it is the best so far."""
        keep_dispatch(self.task, served)

    def _with_units(self, units_min: float, everyone: bool, integer: bool) -> FleetProblem:
        """The relaxation of all sets with so many units."""
        problem = fleet_problem(self.cache, self.data, self.lumped, integer, "cost")
        problem.service_min = units_min * self.unit
        problem.write(self.data, all_connected=everyone, eased=True)
        return problem


def set_of(problem: FleetProblem, outcome: Outcome) -> Flags | None:
    """Customers that the last answer serves."""
    return problem.value_of("x_served") > 0.5 if outcome.status.has_answer else None


def master_of(task: WindowTask, lumped: bool) -> Master | None:
    """The master of a window, with one equivalent battery or every battery; None without a grid.

    One battery knows no rules and nothing beyond the paper, and is asked once.
    """
    data = task.data
    if lumped not in task.masters:
        plain = data.switching is None and data.parts.whole
        plain = plain and not task.own and not data.keeps_service
        task.masters[lumped] = Master(task, lumped, plain and lumped == fleets_of(data)[0])
    master = task.masters[lumped]
    # Weights and prices of switching have a grid.
    return master if master.unit > 0.0 and whole_price(data, master.unit) else None


def fleet_master(task: WindowTask) -> Master | None:
    """The master without the network, with the fleet that is tried first."""
    return master_of(task, fleets_of(task.data)[0])


def fleets_of(data: WindowData) -> tuple[bool, ...]:
    """Whether batteries are lumped, in the order of trial; a fleet of none is one fleet.

    Parts tell batteries apart: as one they could give their power to any. So do phases, but to let
    one battery serve them all only relaxes, and its bound takes a second where thousands are.
    """
    if len(data.soc) == 0:
        return (True,)
    if not data.parts.whole:
        return (False,)
    alike = np.ptp(data.eta_charge) + np.ptp(data.eta_discharge) < ALIKE
    return (True, False) if alike else (False,)
