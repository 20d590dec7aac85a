"""Faults in a simulated day: solvers, measurements, batteries and forecasts.

Faults are put between plant and controller: a solver that is wrapped, an observation that is
changed before the controller sees it, a set-point that a battery does not follow. Neither the plant
nor the solving code knows of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.dispatch import Dispatch
from vppres.contract.forecast import ForecastErrors
from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InfeasibleError, InputError, LimitError, Problem
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import WindowSolution

SolverFault = Literal["killed", "timed_out", "infeasible", "nan", "out_of_range", "wrong_shape"]
Quantity = Literal["soc", "load", "pv"]
SOLVER_FAULTS: tuple[SolverFault, ...] = get_args(SolverFault)
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


class SolverKilledError(RuntimeError):
    """Error of a solver that dies: nothing that vppres would raise itself."""


@dataclass(frozen=True)
class SolverOutage:
    """A solver that fails in one step."""

    kind: SolverFault  #: one of ``SOLVER_FAULTS``
    every_call: bool = True  #: whether every solve of the step fails; otherwise only the first


@dataclass(frozen=True)
class MeasurementFault:
    """Measurements that are missing or frozen over the steps ``[start, end)``."""

    quantity: Quantity  #: what is measured
    frozen: bool  #: whether the last reading is repeated; otherwise there is none (NaN)
    #: First step, and first step after it.
    start: int
    end: int
    items: tuple[int, ...] | None = None  #: positions of the items in question; all if not given


@dataclass(frozen=True)
class BatteryTrip:
    """A battery that is out over the steps ``[start, end)``."""

    battery: int  #: position in the table of batteries
    #: First step, and first step after it.
    start: int
    end: int
    #: Whether telemetry still reports it as there; it shows only by what it does not do.
    silent: bool = False


@dataclass(frozen=True)
class FaultPlan:
    """Faults of a day."""

    solver: Mapping[int, SolverOutage] = field(default_factory=dict)  #: by step
    #: In any order; where two meet, the later one counts.
    measurements: tuple[MeasurementFault, ...] = ()
    trips: tuple[BatteryTrip, ...] = ()  #: batteries that are out
    pv_bias: float = 0.0  #: added to the bias of the PV forecast for the whole day

    def forecast_errors(self, errors: ForecastErrors) -> ForecastErrors:
        """Forecast errors with the day's own on top, and no bias below -1."""
        return replace(errors, pv_bias=max(errors.pv_bias + self.pv_bias, -1.0))

    def check(self, scenario: Scenario) -> None:
        """Refuse faults of items that the scenario does not have.

        Raises
        ------
        InputError
            With every fault that names an item outside its table.
        """
        sizes = {
            "soc": len(scenario.batteries),
            "load": len(scenario.customers),
            "pv": len(scenario.pv),
        }
        named = [(m.quantity, i) for m in self.measurements for i in m.items or ()]
        named += [("soc", trip.battery) for trip in self.trips]
        problems = [
            Problem(
                "faults",
                "is not in the scenario",
                f"Give a position from 0 to {sizes[name] - 1}.",
                field=name,
                value=i,
            )
            for name, i in named
            if not 0 <= i < sizes[name]
        ]
        if problems:
            raise InputError(problems)


class FaultInjector:
    """Carries out a plan of faults while a day runs."""

    def __init__(self, plan: FaultPlan, scenario: Scenario) -> None:
        plan.check(scenario)
        self.plan = plan
        self.scenario = scenario
        self.step = 0
        self._calls = 0
        self._frozen: dict[MeasurementFault, Floats] = {}

    def solver_fault(self) -> SolverFault | None:
        """Fault of the solve that is about to begin, None if there is none."""
        self._calls += 1
        outage = self.plan.solver.get(self.step)
        if outage and (self._calls == 1 or outage.every_call):
            return outage.kind
        return None

    def observe(self, true: Observation) -> Observation:
        """Observation with the faults of its step."""
        self.step = true.t0
        self._calls = 0
        seen = replace(true, online=self._online(true.t0, silent_too=False))
        for fault in self.plan.measurements:
            if fault.start <= true.t0 < fault.end:
                seen = _with_readings(seen, fault, self._reading(fault, true))
        return seen

    def actuate(self, t: int, decision: Decision) -> Decision:
        """The set-points that reach the batteries; those that are out follow none."""
        online = self.online(t)
        if online.all():
            return decision
        step = decision.step
        names = ("charge_kw", "discharge_kw", "batt_q_kvar")
        still: dict[str, Any] = {name: getattr(step, name) * online for name in names}
        return replace(decision, dispatch=replace(step, **still), row=0)

    def online(self, t: int) -> Flags:
        """Batteries that are really there at a step, (B,)."""
        return self._online(t, silent_too=True)

    def _online(self, t: int, silent_too: bool) -> Flags:
        """Batteries that are there, (B,); those that tripped silently are if not asked for."""
        online = np.ones(len(self.scenario.batteries), dtype=bool)
        for trip in self.plan.trips:
            if trip.start <= t < trip.end and (silent_too or not trip.silent):
                online[trip.battery] = False
        return online

    def _reading(self, fault: MeasurementFault, true: Observation) -> Floats:
        """Readings of the fault's quantity, (C,), (P,) or (B,)."""
        values = np.array(_quantity(true, fault.quantity))
        if fault.frozen:
            values = self._frozen.setdefault(fault, values)
            return values
        return np.full_like(values, np.nan)


class FaultySolver(WindowSolver):
    """A solver that fails when the day's faults say so."""

    def __init__(self, solver: WindowSolver, injector: FaultInjector) -> None:
        self.method = solver.method
        self.limits = solver.limits
        self.spec = solver.spec
        self.sides = solver.sides
        self.cache = solver.cache
        self._solver = solver
        self._injector = injector

    @property
    def compilations(self) -> int:
        """Compilations of the solver that works."""
        return self._solver.compilations

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """Solve a window, or fail at it."""
        fault = self._injector.solver_fault()
        _raise_fault(fault)
        solution = self._solver.solve(data, within_s)
        return _garbled_solution(solution, fault, self.site) if fault else solution

    def solve_served(
        self,
        data: WindowData,
        served: Flags,
        before: Dispatch | None = None,
        keeps_turns: bool = False,
        within_s: float = math.inf,
    ) -> WindowSolution | None:
        """Dispatch of a supply schedule, or a failure."""
        fault = self._injector.solver_fault()
        _raise_fault(fault)
        solution = self._solver.solve_served(data, served, before, keeps_turns, within_s)
        return _garbled_solution(solution, fault, self.site) if fault and solution else solution

    def least_slack(self, data: WindowData) -> float:
        """Least slack of the voltage limits; no fault befalls it."""
        return self._solver.least_slack(data)


def _raise_fault(fault: SolverFault | None) -> None:
    """Raise what a solver without an answer raises."""
    if fault == "killed":
        raise SolverKilledError("the solver's process was killed")
    if fault == "timed_out":
        raise LimitError("The window was not solved before the time limit.")
    if fault == "infeasible":
        raise InfeasibleError("The window has no feasible dispatch.")


def _garbled_solution(solution: WindowSolution, fault: SolverFault, site: Site) -> WindowSolution:
    """A solution whose values no one may carry out."""
    plan = solution.dispatch
    changed: dict[str, Any] = {}
    if fault == "nan":
        changed = {"served": np.full(plan.served.shape, np.nan)}
    elif fault == "out_of_range":
        changed = {
            "served": np.ones(plan.served.shape, dtype=bool),
            "charge_kw": plan.charge_kw + 10.0 * site.batteries.p_max_kw,
            "pv_q_kvar": plan.pv_q_kvar - 10.0 * site.pv.s_max_kva,
            "v_pu": 2.0 * plan.v_pu,
        }
    else:
        changed = {"served": plan.served[:, 1:]}
    return replace(solution, dispatch=replace(plan, **changed))


def _quantity(seen: Observation, quantity: Quantity) -> Floats:
    if quantity == "soc":
        return seen.soc
    rows = seen.forecast.load_kw if quantity == "load" else seen.forecast.pv_kw
    return np.asarray(rows[0])


def _with_readings(seen: Observation, fault: MeasurementFault, reading: Floats) -> Observation:
    """The observation with the fault's items at other readings."""
    values = np.array(_quantity(seen, fault.quantity))
    items = slice(None) if fault.items is None else np.array(fault.items, dtype=int)
    values[items] = reading[items]
    if fault.quantity == "soc":
        return replace(seen, soc=values)
    name = f"{fault.quantity}_kw"
    rows = np.array(getattr(seen.forecast, name))
    rows[0] = values
    changed: dict[str, Any] = {name: rows}
    return replace(seen, forecast=replace(seen.forecast, **changed))
