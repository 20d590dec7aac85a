"""Operations of switches: one at a time, each confirmed by an operator, then by telemetry.

Nothing is remembered but the states that are asked for, and the operation that was confirmed last.
The order is made anew from the readings at every look, so that a restart changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError, Problem
from vppres.feeders.reconfiguration.folder import injection_at
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import (
    Operation,
    SwitchedFeeder,
    SwitchingOrder,
    safe_order,
)
from vppres.feeders.reconfiguration.sources import KEEPS_PHASES, of_the_day
from vppres.io.messages import did_you_mean
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written

SWITCHING = "switching"
"""Setting with the states that an operator asked for."""

GRACE = pd.Timedelta(minutes=5)
"""Time that telemetry has beyond the minutes that an operation takes."""

NO_GRID = "The grid is lost, and an order of operations is made for a feeder with the grid alone."


@dataclass(frozen=True, eq=False)
class Switchgear:
    """Switches of a site, as they are and as they are asked for."""

    step: Scenario  #: one step of the site, with its measured loads
    read: Mapping[str, bool]  #: states by switch, by its last reading
    of_plan: Flags  #: lines and ties that are closed in the present plan, (E,)
    proposed: Mapping[str, Any]  #: operations that it proposes; empty if it proposes none
    soc: Floats  #: states of charge, (B,)
    #: The setting: ``closed`` by switch, and the operation that is ``issued``; may be empty.
    asked: Mapping[str, Any]
    carried_out: bool  #: whether the operation that is issued was seen in a reading since
    has_grid: bool
    now: pd.Timestamp

    @cached_property
    def _feeder(self) -> SwitchedFeeder:
        net = self.step.network
        limits = ConfigurationLimits(net.v_min_ac_pu, net.v_max_ac_pu)
        given = of_the_day(self.step, 0, self.soc)
        injection = injection_at(self.step, 0)
        return SwitchedFeeder(net, self.step.switches, *injection, limits, **given)

    @cached_property
    def _wanted(self) -> dict[str, bool]:
        """States that are asked for and not reached, by switch."""
        closed = self.asked.get("closed", {})
        return {name: state for name, state in closed.items() if self.read.get(name) != state}

    def _with(self, states: Mapping[str, bool]) -> Flags:
        """Closed branches, where switches that are not named are as in the folder."""
        branches = self._feeder.branches
        closed = branches.closed.copy()
        for branch in np.flatnonzero(branches.switch >= 0):
            closed[branch] = states.get(branches.names[branch], bool(closed[branch]))
        return closed

    @cached_property
    def order(self) -> SwitchingOrder:
        """Order of the operations that are left, from the states that were read."""
        return safe_order(
            self._feeder, self._with(self.read), self._with({**self.read, **self._wanted})
        )

    def check(self) -> None:
        """Whether the states that are asked for can be reached.

        Raises
        ------
        InputError
            If a switch is unknown or has no reading, or there is no order of operations.
        """
        if self.step.phases:
            raise InputError.of("switching", KEEPS_PHASES, "Operate its switches by hand.")
        known = [str(name) for name in self.step.switches.id]
        problems = []
        for name in self.asked["closed"]:
            if name not in known:
                cure = did_you_mean(name, known, "Give a switch of switches.csv.")
                message = "is no switch of the site"
                problems.append(Problem("switching", message, cure, field="closed", value=name))
            elif name not in self.read:
                message = "has no reading of its state"
                cure = "Send closed, 1 or 0, of it as telemetry."
                problems.append(Problem("switching", message, cure, field="closed", value=name))
        if problems:
            raise InputError(problems)
        if reason := self._no_order:
            raise InputError.of("switching", "has no order of operations", reason, field="closed")

    @property
    def _no_order(self) -> str:
        """Why no operation may be carried out; empty if one may."""
        if not self._wanted:
            return ""
        return self.order.reason if self.has_grid else NO_GRID

    @property
    def next(self) -> Operation | None:
        """Operation that waits for an operator; None if there is none."""
        operations = self.order.operations if self.state["status"] == "confirm" else None
        return operations[0] if operations else None

    @property
    def issued(self) -> dict[str, Any] | None:
        """Operation that was confirmed, and that telemetry does not show yet."""
        found: dict[str, Any] | None = self.asked.get("issued")
        if found is None or self.carried_out or self.read.get(found["switch"]) == found["closed"]:
            return None
        return found

    @cached_property
    def state(self) -> dict[str, str]:
        """Status, and what is waited for in words."""
        issued = self.issued
        if issued and self.now < pd.Timestamp(issued["until"]):
            words = f"{issued['switch']} has not yet read {_state(issued)}."
            return {"status": "waiting", "reason": words}
        if not self.asked.get("closed"):
            return {"status": "none", "reason": ""}
        if issued:
            words = f"{issued['switch']} did not read {_state(issued)} by {issued['until']}."
            return {"status": "stopped", "reason": f"{words} Ask anew for what is to be reached."}
        if reason := self._no_order:
            return {"status": "stopped", "reason": reason}
        return {"status": "confirm" if self._wanted else "done", "reason": ""}

    def confirmed(self, switch: str) -> dict[str, Any]:
        """The setting after an operator has confirmed the next operation.

        Raises
        ------
        InputError
            If that of the switch is not the next one.
        """
        following = self.next
        if following is None or following.switch != switch:
            words = following.sentence if following else self.state["reason"] or "There is none."
            message = "is not the switch of the next operation"
            raise InputError.of("switching", message, words, field="switch", value=switch)
        row = int(np.flatnonzero(self.step.switches.id == switch)[0])
        minutes = float(self.step.switches.minutes_to_operate[row])
        until = self.now + pd.Timedelta(minutes=minutes) + GRACE
        issued = {
            "switch": switch,
            "closed": following.closes,
            "confirmed_at": written(self.now),
            "until": written(until),
        }
        return {**self.asked, "issued": issued}

    @property
    def stopped(self) -> str:
        """Why the order is stopped; empty if it is not."""
        return self.state["reason"] if self.state["status"] == "stopped" else ""

    def told(self) -> dict[str, Any]:
        """States, the operation that devices carry out, and those that are left.

        ``unlike_plans`` are switches that read otherwise than in the present plan.
        """
        status = self.state
        left = self.order.operations if status["status"] == "confirm" else None
        of_plan = self._feeder.branches.states(self.of_plan)
        return {
            **status,
            "read": dict(self.read),
            "asked": self.asked.get("closed", {}),
            "issued": self.issued if status["status"] == "waiting" else None,
            "operations": [one.sentence for one in left or ()],
            "next": left[0].switch if left else None,
            "proposed": self.proposed or None,
            "unlike_plans": [name for name, state in self.read.items() if state != of_plan[name]],
        }


def _state(issued: Mapping[str, Any]) -> str:
    return "closed" if issued["closed"] else "open"
