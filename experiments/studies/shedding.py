"""Whether customers of the first tier had to be let go, by what a controller knew.

A step in which one is off is solved again from what the controller took for true then (readings and
estimates, what was expected and announced), over the steps that its plan looked at, with the first
tier before everything else. What the plan leaves off beyond that was not forced by energy, power or
network: it was given to others. A sum of the step's own energy would not say so: it knows of no
later step in which the same energy keeps another one on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.frame.seeds import PATIENT
from vppres.contract.observation import Observation
from vppres.control.guard.partial_fleet import reduced_observation, site_with
from vppres.core.arrays import Flags
from vppres.day.priority import site_of
from vppres.live.controller import Controller
from vppres.model.data import WindowData
from vppres.model.site import Site
from vppres.service.operation.runner import Runner
from vppres.solve.ladder import WindowSolver

OTHERS = 1e-4
"""Weight of all but the first tier: all of them in a window count less than one of it."""


@dataclass(frozen=True)
class Shed:
    """Customers of the first tier that a plan leaves off."""

    #: In the step, and customers times steps in those that it looks at behind it.
    now: int
    ahead: int
    least: int  #: how many it would have to be in all of these steps together

    @property
    def avoidable(self) -> int:
        """Those of the step that need not have been off."""
        return min(self.now, max(self.now + self.ahead - self.least, 0))


@dataclass
class Judge:
    """Looks at the plans of a service in this process."""

    runner: Runner  #: the service
    #: Steps in which somebody of the first tier is off.
    found: list[Shed] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._solvers: dict[bytes, WindowSolver] = {}

    def look(self, plan: Mapping[str, Any]) -> None:
        """Judge a plan that was just decided."""
        scenario = self.runner.scenario
        first = np.asarray(scenario.customers.tier == scenario.tiers[0], dtype=bool)
        # Who cannot be supplied takes nothing, in the plan and here.
        first &= ~np.isin(scenario.customers.id, [one["asset"] for one in plan["lost"]])
        names = [str(name) for name in scenario.customers.id[first]]
        on = {one["asset"]: one["served"] for one in plan["setpoints"] if "served" in one}
        now = sum(not on[name] for name in names)
        if not now or plan["ahead"] is None:
            return
        served = plan["ahead"]["served"]
        ahead = sum(not each for name in names for each in served[name])
        steps = 1 + len(plan["ahead"]["times"])
        self.found.append(Shed(now, ahead, self._least(first, steps)))

    def _least(self, first: Flags, steps: int) -> int:
        """Fewest customers of the first tier times steps that must be off."""
        controller = self.runner.deciding.controller
        known = seen_by(controller)
        key = known.online.tobytes() + first.tobytes()
        if key not in self._solvers:
            whole = site_of(controller.scenario, controller.options.as_record())
            site = _first_alone(site_with(whole, known.online), first)
            self._solvers[key] = WindowSolver(site, limits=PATIENT)
        solver = self._solvers[key]
        seen = reduced_observation(known, controller.scenario.batteries)
        window = WindowData.of(
            replace(seen, stored_value=None), solver.site, controller.options.centre
        )
        served = solver.solve(window.first(steps)).dispatch.served
        return int((~np.asarray(served, dtype=bool)[:, first]).sum())


def seen_by(controller: Controller) -> Observation:
    """What the last decision of a controller took for true."""
    assert controller.last is not None
    assert controller.last.seen is not None
    return controller.last.seen


def _first_alone(site: Site, first: Flags) -> Site:
    """The site where customers of the first tier count one each, and the others next to nothing."""
    weight = np.where(first, 1.0, OTHERS)
    return replace(site, customers=replace(site.customers, weight=weight))
