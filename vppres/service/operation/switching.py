"""Operations of switches: one at a time, each confirmed by an operator, then by telemetry.

Nothing is remembered but the states that are asked for, and the operation that was confirmed last.
The order is made anew from the readings at every look, so that a restart changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.feeders.reconfiguration.folder import injection_at
from vppres.feeders.reconfiguration.search import ConfigurationLimits
from vppres.feeders.reconfiguration.sequence import SwitchingOrder, safe_order
from vppres.feeders.reconfiguration.sources import of_the_day
from vppres.feeders.reconfiguration.states import Formers, SwitchedFeeder
from vppres.feeders.reconfiguration.told import Operation
from vppres.io.messages import did_you_mean
from vppres.kinds.table import KINDS, units_of
from vppres.physics.phased_sources import buses_of
from vppres.scenario.configuration import Branches
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written

SWITCHING = "switching"
"""Setting with the states that an operator asked for."""

GRACE = pd.Timedelta(minutes=5)
"""Time that telemetry has beyond the minutes that an operation takes."""

COLD = "The higher demand of those who come back is not known by phase."
LACKING = "{} is closed or would be, and has not all three phases at both ends."


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
    set_points: Sequence[Mapping[str, Any]]  #: of all devices now
    #: Whether there is grid: without it devices give and take what their set-points say.
    has_grid: bool
    #: Whether the grid's bus has a source: the grid, or in paper mode's islands one of its own.
    source: bool
    is_lit: bool  #: whether devices that can form the grid of an island do
    now: pd.Timestamp

    @cached_property
    def _feeder(self) -> SwitchedFeeder:
        net = self.step.network
        limits = ConfigurationLimits(net.v_min_ac_pu, net.v_max_ac_pu)
        drawn = None if self.has_grid else drawn_told(self.step, self.set_points)
        given = of_the_day(self.step, 0, self.soc, drawn)
        injection = injection_at(self.step, 0)
        if drawn is not None:
            at_bus = net.place(buses_of(self.step))
            injection = -at_bus @ drawn[0], -at_bus @ drawn[1]
            formers = given["formers"] if self.is_lit else Formers.none()
            given["formers"] = _as_told(formers, self.set_points)
        return SwitchedFeeder(
            net, self.step.switches, *injection, limits, grid=self.source, **given
        )

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
        return self._not_by_phase or self.order.reason

    @property
    def _not_by_phase(self) -> str:
        """Why no state of a feeder with phases is known; empty where it is."""
        if self.step.phases and self.step.switching.cold:
            return COLD
        branches = Branches.of(self.step)
        closed = {name for states in (self.read, self._wanted) for name in states if states[name]}
        lacks = branches.states(~branches.can_close)
        lacking = [name for name in lacks if lacks[name] and name in closed]
        return LACKING.format(named(lacking)) if lacking else ""

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


def drawn_told(step: Scenario, set_points: Sequence[Mapping[str, Any]]) -> tuple[Floats, Floats]:
    """Power that each device draws by set-points in kW and kvar, (D,) each.

    Customers that are on draw what is measured, as those that are not told; PV systems give no
    more than there is; all others rest where they are not told.
    """
    c, pv, batteries = step.customers, step.pv, step.batteries
    told = {(one["kind"], one["asset"]): one for one in set_points}

    def values(kind: str, ids: Names, field: str, otherwise: float) -> Floats:
        found = (told.get((kind, str(name)), {}).get(field) for name in ids)
        return np.array([otherwise if one is None else one for one in found], dtype=float)

    on = values("customers", c.id, "served", 1.0) * values("customers", c.id, "share", 1.0)
    sun_kw = np.minimum(values("pv", pv.id, "p_kw", np.inf), step.pv_kw[0])
    p_kw = [on * step.load_kw[0], -sun_kw, values("batteries", batteries.id, "p_kw", 0.0)]
    q_kvar = [
        on * step.load_kvar[0],
        -values("pv", pv.id, "q_kvar", 0.0),
        values("batteries", batteries.id, "q_kvar", 0.0),
    ]
    for kind, units in units_of(step).items():
        sign = -1.0 if KINDS[kind].gives else 1.0
        p_kw.append(sign * values(kind, units.id, "p_kw", 0.0))
        q_kvar.append(sign * values(kind, units.id, "q_kvar", 0.0))
    return np.concatenate(p_kw), np.concatenate(q_kvar)


def _as_told(formers: Formers, set_points: Sequence[Mapping[str, Any]]) -> Formers:
    """Devices that can hold an island, with what their set-points say that they give."""
    sign = {"batteries": -1.0} | {kind: 1.0 for kind, one in KINDS.items() if one.gives}
    told = {one["asset"]: one for one in set_points if one["kind"] in sign}
    p_kw, q_kvar = np.zeros(len(formers)), np.zeros(len(formers))
    for row, name in enumerate(formers.id):
        if one := told.get(str(name)):
            p_kw[row] = sign[one["kind"]] * one["p_kw"]
            q_kvar[row] = one.get("q_kvar") or 0.0
    return replace(formers, p_kw=p_kw, q_kvar=q_kvar)


def _state(issued: Mapping[str, Any]) -> str:
    return "closed" if issued["closed"] else "open"
