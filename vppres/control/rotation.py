"""A controller that shares supply within tiers: it weighs customers by their time off supply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation, Turns
from vppres.control.remembered import PARTS, memory_of, put_back
from vppres.core.arrays import Flags, Floats
from vppres.core.plain import Given
from vppres.model.site import Site
from vppres.scenario.fairness import Fairness, rotated, turns
from vppres.scenario.scenario import Scenario

HOURS_EXACT = 1e-9
"""Share of an hour below which sums of steps are the same."""


class Rotating:
    """Wraps a controller whose customers weigh more the longer they were off supply in outages.

    Weights change while there is grid, and in an outage after each turn. For each set of them the
    controller is made anew, with its compiled problems; the one before is dropped.

    Parameters
    ----------
    decider_of : callable
        Makes the wrapped controller of a site.
    weighed : callable
        The site with other weights, (C,).
    scenario : Scenario
        Its customers and tiers.
    rules : Fairness
        How supply is shared.
    off_h : array, shape (C,)
        Hours off supply before the first step.
    given : mapping
        What a memory does not hold, by type.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "off_h": Floats,
        "on_h": Floats,
        "out_h": float,
        "turn_h": float,
        "_t": int,
        "_out": bool,
        "_parts": PARTS,
    }

    def __init__(
        self,
        decider_of: Callable[[Site], Decider],
        weighed: Callable[[Floats], Site],
        scenario: Scenario,
        rules: Fairness,
        off_h: Floats,
        given: Given,
    ) -> None:
        self.scenario = scenario
        self.rules = rules
        self.off_h = off_h
        self.on_h = np.zeros(len(off_h))  # since a customer's last turn
        self.out_h = 0.0
        self.turn_h = 0.0
        self._decider_of = decider_of
        self._weighed = weighed
        self._given = given
        self._total = float(weighed(scenario.customers.weight).customers.weight.sum())
        self._rank = np.array([scenario.tiers.index(tier) for tier in scenario.customers.tier])
        self._t = -1
        self._out = False
        self._parts: dict[bytes, Decider] = {}
        self.part_for(self._rotated().tobytes())

    @property
    def inner(self) -> Decider:
        """The wrapped controller with the present weights."""
        return next(iter(self._parts.values()))

    @property
    def weight(self) -> Floats:
        """The present weights, (C,)."""
        return np.frombuffer(next(iter(self._parts)), dtype=float)

    def horizon_steps(self, t0: int) -> range:
        """Those of the wrapped controller."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision with the weights of the step, and with those on whose turn it is."""
        if observation.t0 != self._t:  # not anew within the step
            self._count(observation)
            self._t = observation.t0
        observation = observation.counted(self._scale)
        due = self._due()
        if due.any():
            observation = replace(observation, turns=Turns(due, self._rank))
        return replace(self.inner.decide(observation), weight=self.weight)

    def _count(self, observation: Observation) -> None:
        """Add the step before to the time off supply, and change weights if it is time."""
        dt_h = self.scenario.grid.dt_h
        if self._out:
            if observation.served is not None:
                self.off_h = self.off_h + dt_h * ~observation.served
                self.on_h = self.on_h + dt_h * observation.served
            in_turn = self._turns()
            self.out_h += dt_h
            self.turn_h += dt_h
            self.on_h = np.where(in_turn & ~self._turns(), 0.0, self.on_h)
        self._out = bool(observation.forecast.grid_limit_kw[0] <= 0.0)
        if not self._out or self.turn_h >= self.rules.turn_h - HOURS_EXACT:
            self.turn_h = 0.0
            self._change()

    def _change(self) -> None:
        """Go on with the weights that follow from the time off supply."""
        key = self._rotated().tobytes()
        if key not in self._parts:
            memory = memory_of(self.inner, self._given)
            put_back(self.part_for(key), memory, self._given, "controller")

    def part_for(self, key: bytes) -> Decider:
        """The wrapped controller of weights, as bytes; others are dropped."""
        if key not in self._parts:
            site = self._weighed(np.frombuffer(key, dtype=float))
            # Strict order has its own scale of weights, and it changes with them.
            self._scale = float(site.customers.weight.sum()) / self._total
            self._parts = {key: self._decider_of(site)}
        return self._parts[key]

    def _rotated(self) -> Floats:
        growth = self.rules.rotation
        return rotated(self.scenario.customers, self.scenario.tiers, self.off_h, growth)

    def _turns(self) -> Flags:
        return turns(len(self.off_h), self.out_h, self.rules.minimum_on_h)

    def _due(self) -> Flags:
        """Customers who are on now, because they were on for less than the minimum."""
        short = self.on_h < self.rules.minimum_on_h - HOURS_EXACT
        return np.asarray(self._out & self._turns() & short)
