"""A controller that also decides which switches to move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation
from vppres.contract.operating_point import Centre
from vppres.control.configurations import InConfiguration
from vppres.control.guard.check import PAPER, Tolerances
from vppres.control.operations import Operations
from vppres.control.search import Search
from vppres.core.plain import Given
from vppres.model.site import Site
from vppres.scenario.faults import OutOfService
from vppres.scenario.scenario import Scenario
from vppres.solve.deadline import HALF, Deadline
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits


class Switching(InConfiguration):
    """Decides on switches, then as the controller of the configuration.

    Parameters are those of :class:`InConfiguration`, but that ``solver_of`` is None where plans
    have other weights than the site.
    """

    last: Search  #: the search of the last step

    def __init__(
        self,
        day: Scenario,
        controller_of: Callable[[Scenario], Decider],
        site_of: Callable[[Scenario], Site],
        given: Callable[[Site], Given],
        centre: Centre,
        solver_of: Callable[[Site], WindowSolver] | None,
        limits: SolveLimits,
        within: Tolerances = PAPER,
    ) -> None:
        super().__init__(day, controller_of, site_of, given, centre, solver_of)
        self.limits = limits
        self.within = within
        self._out: OutOfService | None = None

    def decide(self, observation: Observation) -> Decision:
        """The decision in the configuration that is best, and the operations that it takes."""
        observation = self.observed(observation)
        here = self.controller_in(self.closed)
        before = self.memory_in(here)
        deadline = Deadline(self.limits.time_s)
        half = replace(observation, within_s=HALF * self.limits.time_s)
        stay = here.decider.decide(self.seen_in(here, half))
        observation = _known(observation, stay)
        self.last = Search(self.operations(observation), stay, before, self.limits, deadline)
        self.last.run()
        self._out = observation.forecast.out.part(slice(1))
        return self.taken(self.last, observation.t0)

    def taken(self, search: Search, t0: int) -> Decision:
        """The best decision of a step, with its operations carried out."""
        found, decision = search.best, search.certified()
        if found is search.stay:
            return replace(decision, switched=search.record)
        switched = search.reasoned()
        if found.waits:
            self.remember_in(self.controller_in(self.closed), found.memory)
            return replace(decision, switched=switched)
        self.go_on_in(found.candidate.closed, found.memory, t0)
        words = switched.ahead
        switched = replace(switched, closed=self.closed, moved=words, ahead="", order=found.order)
        return replace(decision, switched=switched)

    def operations(self, observation: Observation) -> Operations:
        """Operations of a step, which begin as the last one has left the feeder.

        A fault that begins now comes after them.
        """
        t0, point, now = observation.t0, observation.operating_point, observation.forecast.out
        before = self._out or self._out_at_start()
        out = OutOfService(before.lines & now.lines[:1], before.buses & now.buses[:1])
        live = np.full(self.day.network.n_buses, point is not None or not t0)
        if point is not None:
            live = np.isfinite(self.controller_in(self.closed).day.at_buses(point.v_pu))
        return Operations(self, observation, before, out, live, self.within)

    def _out_at_start(self) -> OutOfService:
        """Lines and buses that are out just before the day, in its order."""
        day = self.day
        earlier = replace(day.grid, start=day.grid.start - day.grid.step, n_steps=1)
        return OutOfService.of(day.faults, day.network, earlier, range(1))


def _known(observation: Observation, decision: Decision) -> Observation:
    """The observation as its decision took it for true, in the order of the day."""
    seen = decision.seen or observation
    forecast = replace(seen.forecast, out=observation.forecast.out)
    point, within_s = observation.operating_point, observation.within_s
    return replace(seen, forecast=forecast, operating_point=point, within_s=within_s)
