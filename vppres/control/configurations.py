"""A controller of a feeder whose switches stand as they are observed, one for each configuration.

A controller knows one tree: its site, compiled problems and linearisation are of that. Where the
configuration changes another one goes on from its memory, but for what it knows of lines.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decider, Decision, Switched
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.control.remembered import PART, memory_of, put_back
from vppres.control.step_state import StepState
from vppres.core.arrays import Flags
from vppres.core.plain import Given
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.scenario.configuration import Branches, Configured, in_configuration
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver

DAY_H = 24.0

MOST_KEPT = 64
"""Configurations whose controllers are kept; each may hold compiled problems."""


@dataclass(frozen=True, eq=False)
class ControllerIn:
    """The day in a configuration, and who decides and bounds there."""

    day: Configured  #: the scenario
    site: Site  #: what is planned for
    centre: Centre  #: linearisation centre of the voltages
    controller_of: Callable[[Scenario], Decider]  #: makes its controller
    #: Makes the solver of bounds of a site; None where none is known.
    solver_of: Callable[[Site], WindowSolver] | None

    @cached_property
    def decider(self) -> Decider:
        """Its controller, made when it is asked."""
        return self.controller_of(self.day.scenario)

    @cached_property
    def solver(self) -> WindowSolver | None:
        """The solver of bounds of its windows."""
        return None if self.solver_of is None else self.solver_of(self.site)

    def bound(self, seen: Observation, within_s: float) -> float:
        """Most that a plan of what is seen can be worth, infinite if it is not known."""
        if self.solver is None:
            return np.inf
        return self.solver.fleet_bound(WindowData.of(seen, self.site, self.centre), within_s)


class InConfiguration:
    """Decides as the controller of the configuration that is observed.

    ``day`` stands in the configuration in which it begins. ``site_of`` makes the site that a
    controller plans for, ``given`` what is known of it without a memory, ``solver_of`` the solver
    of bounds.

    Attributes
    ----------
    closed : array of bool, shape (E,)
        The configuration of the last step, in whose order its AC operating point stands.
    moved : tuple
        Steps of the last 24 hours and the branches that were moved in them, (E,) each.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "closed": Flags,
        "moved": tuple[tuple[int, Flags], ...],
        "decider": PART,
    }

    def __init__(
        self,
        day: Scenario,
        controller_of: Callable[[Scenario], Decider],
        site_of: Callable[[Scenario], Site],
        given: Callable[[Site], Given],
        centre: Centre,
        solver_of: Callable[[Site], WindowSolver] | None = None,
    ) -> None:
        self.day = day
        self.branches = Branches.of(day)
        self.closed = self.branches.closed
        self.moved: tuple[tuple[int, Flags], ...] = ()
        self._controller_of = controller_of
        self._site_of = site_of
        self._given = given
        self._centre = centre
        self._solver_of = solver_of
        self._known: dict[bytes, ControllerIn] = {}

    @property
    def decider(self) -> Decider:
        """Controller of the present configuration."""
        return self.controller_in(self.closed).decider

    def horizon_steps(self, t0: int) -> range:
        """Steps of its controllers' windows."""
        return self.decider.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision in the configuration that is observed."""
        observation = self.observed(observation)
        here = self.controller_in(self.closed)
        decision = here.decider.decide(self.seen_in(here, observation))
        return replace(decision, switched=Switched(self.closed))

    def observed(self, observation: Observation) -> Observation:
        """The observation, after switches were moved by others.

        The AC operating point of other lines is left out.
        """
        now = observation.closed
        if now is None or np.array_equal(now, self.closed):
            return observation
        self.go_on_in(now, self.memory_in(self.controller_in(self.closed)), observation.t0)
        return replace(observation, operating_point=None)

    def go_on_in(self, closed: Flags, memory: dict[str, Any], t0: int) -> None:
        """Let a configuration be the present one from a step on."""
        self.moved = (*self._recent(t0), (t0, closed != self.closed))
        self.closed = closed
        self.remember_in(self.controller_in(closed), memory)

    def _recent(self, t0: int) -> tuple[tuple[int, Flags], ...]:
        """Operations of the 24 hours before a step."""
        since = t0 - DAY_H / self.day.grid.dt_h
        return tuple(one for one in self.moved if one[0] > since)

    def movable(self, observation: Observation) -> Flags:
        """Branches that may move in a window: they have operations of 24 hours left."""
        done = sum((moved.astype(int) for _, moved in self._recent(observation.t0)), start=0)
        left = np.asarray(done + 1 <= self.branches.of_moves("max_operations_per_day"))
        return left & self.branches.movable(~self.closed, observation.forecast.out)

    def controller_in(self, closed: Flags) -> ControllerIn:
        """The controller of a configuration, made once."""
        key = closed.tobytes()
        if key not in self._known:
            if len(self._known) >= MOST_KEPT:
                kept = self.closed.tobytes()
                self._known = {kept: self._known[kept]}
            day = in_configuration(self.day, self.branches, closed)
            site = self._site_of(day.scenario)
            self._known[key] = ControllerIn(
                day, site, self._centre, self._controller_of, self._solver_of
            )
        return self._known[key]

    def seen_in(self, part: ControllerIn, observation: Observation) -> Observation:
        """Observation with the lines and voltages of a configuration."""
        forecast = observation.forecast
        forecast = replace(forecast, out=part.day.out_of(forecast.out))
        here = np.array_equal(part.day.closed, self.closed)
        point = observation.operating_point if here else None
        return replace(observation, forecast=forecast, operating_point=point)

    def state_in(self, part: ControllerIn, observation: Observation) -> StepState:
        """The observed step in a configuration."""
        return StepState.of(part.site, self.seen_in(part, observation), self._centre)

    def memory_in(self, part: ControllerIn) -> dict[str, Any]:
        """Memory of the controller of a configuration."""
        return memory_of(part.decider, self._given(part.site))

    def remember_in(self, part: ControllerIn, memory: dict[str, Any]) -> None:
        """Let a controller go on from another configuration, but for what is of its lines."""
        put_back(part.decider, without_lines(memory), self._given(part.site), "controller")


def without_lines(memory: Any, of_planner: bool = False) -> Any:
    """A controller's memory without what its planner knows of lines and voltages.

    >>> without_lines({"_last": 1, "planner": {"kept": {"_last": 2}}})
    {'_last': 1, 'planner': {'kept': {'_last': None}}}
    """
    if isinstance(memory, list):
        return [without_lines(each, of_planner) for each in memory]
    if not isinstance(memory, dict):
        return memory
    return {
        name: None
        if of_planner and name == "_last"
        else without_lines(value, of_planner or name == "planner")
        for name, value in memory.items()
    }
