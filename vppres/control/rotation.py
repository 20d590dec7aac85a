"""A controller that shares supply within tiers: it weighs customers by their time off supply."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.decision import Decision
from vppres.contract.observation import Observation, SupplyTurns
from vppres.control.by_weight import ByWeight
from vppres.control.remembered import PART
from vppres.core.arrays import Flags, Floats
from vppres.scenario.fairness import Fairness, rotated, turns
from vppres.scenario.scenario import Scenario

HOURS_EXACT = 1e-9
"""Share of an hour below which sums of steps are the same."""


class Rotating:
    """Changes the weights of customers, which weigh more the longer they were off in outages.

    Weights change while there is grid, and in an outage after each turn.

    ``off_h`` are the hours off supply before the first step, (C,).
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "off_h": Floats,
        "on_h": Floats,
        "out_h": float,
        "turn_h": float,
        "_t": int,
        "_out": bool,
        "_controllers": PART,
    }

    def __init__(
        self, controllers: ByWeight, scenario: Scenario, rules: Fairness, off_h: Floats
    ) -> None:
        self.scenario = scenario
        self.rules = rules
        self.off_h = off_h
        self.on_h = np.zeros(len(off_h))  # since a customer's last turn
        self.out_h = 0.0
        self.turn_h = 0.0
        self._rank = np.array([scenario.tiers.index(tier) for tier in scenario.customers.tier])
        self._t = -1
        self._out = False
        self._controllers = controllers
        self._update_weights()

    def horizon_steps(self, t0: int) -> range:
        """Steps of its controllers' windows."""
        return self._controllers.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The decision with the weights of the step, and with those on whose turn it is."""
        if observation.t0 != self._t:  # not anew within the step
            self._count_time_off(observation)
            self._t = observation.t0
        due = self._due(observation)
        if due.any():
            observation = replace(observation, turns=SupplyTurns(due, self._rank))
        return self._controllers.decide(observation)

    def _count_time_off(self, observation: Observation) -> None:
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
            self._update_weights()

    def _update_weights(self) -> None:
        """Go on with the weights that follow from the time off supply."""
        c = self.scenario.customers
        self._controllers.change_to(
            rotated(c, self.scenario.tiers, self.off_h, self.rules.rotation)
        )

    def _turns(self, steps_ahead: int = 0) -> Flags:
        """Customers whose turn it is, or will be if the outage lasts, (C,)."""
        out_h = self.out_h + steps_ahead * self.scenario.grid.dt_h
        return turns(len(self.off_h), out_h, self.rules.minimum_on_h)

    def _due(self, observation: Observation) -> Flags:
        """Customers that are on in their turn, (W, C): they were on for less than the minimum.

        Turns that come later in the outage are planned for.
        """
        out = np.logical_and.accumulate(observation.window.grid_limit_kw <= 0.0)
        in_turn = np.array([self._turns(k) for k in range(len(out))])
        short = self.on_h < self.rules.minimum_on_h - HOURS_EXACT
        return np.asarray(in_turn & out[:, None] & short)
