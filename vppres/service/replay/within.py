"""Parts of a step that was decided anew: customers that were off, with times.

A plan keeps what was said before it. Between a change of the grid and the plan that knows of it
stands what devices made of the old set-points: the plant answers that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.units import h_to_minutes
from vppres.day.options import RunOptions
from vppres.scenario.configuration import Branches
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, closed_by
from vppres.service.clock import written
from vppres.service.plans.world import World
from vppres.service.storage.records import DECIDED, Reading, moment, versions
from vppres.service.storage.store import Store

GRID_ON = "grid_on"


@dataclass(frozen=True, eq=False)
class StepPart:
    """A part of a step in which the same set-points held, with grid or without."""

    #: From when to when.
    begin: pd.Timestamp
    end: pd.Timestamp
    said: Plan  #: the version of the plan that held
    island: bool  #: whether there was no grid
    #: Whether the set-points were planned for that: those that are kept or default are not.
    foreseen: bool

    @property
    def setpoints(self) -> list[dict[str, Any]]:
        """Set-points that held."""
        found: list[dict[str, Any]] = self.said["setpoints"]
        return found

    @property
    def hours(self) -> float:
        """How long it is."""
        return float((self.end - self.begin) / pd.Timedelta("1h"))

    def off(self) -> set[str]:
        """Customers that were to be off."""
        return {
            str(one["asset"])
            for one in self.setpoints
            if one["kind"] == "customers" and not one["served"]
        }


def parts_of(
    plan: Plan, length: pd.Timedelta, store: Store, until: pd.Timestamp | None = None
) -> list[StepPart]:
    """The parts of a step, the earliest first; up to a time within it, if it is not over."""
    begin = pd.Timestamp(plan["start"])
    end = min(begin + length, max(until, begin)) if until else begin + length
    said = versions(plan)
    times = [begin, *(min(pd.Timestamp(one["valid_from"]), end) for one in said[1:]), end]
    if len(said) == 1 and said[0].get("grid"):
        island = not said[0]["grid"]["available"]
        foreseen = not island or said[0]["status"] in DECIDED
        return [StepPart(begin, end, said[0], island, foreseen)]
    read = [*store.latest(begin, (GRID_ON,)), *store.between(begin, end, (GRID_ON,))]
    read = [one for one in read if one.known]
    found = []
    for k, one in enumerate(said):
        later: Mapping[str, Any] = next(
            (each["grid"] for each in said[k + 1 :] if each.get("grid")), {}
        )
        for since, till, island in _spans(one, later, times[k], times[k + 1], read):
            known = one.get("grid") or {"available": True}
            foreseen = not island or (not known["available"] and one["status"] in DECIDED)
            found.append(StepPart(since, till, one, island, foreseen))
    return [one for one in found if one.end > one.begin] or found[-1:]


def _spans(
    said: Mapping[str, Any],
    later: Mapping[str, Any],
    begin: pd.Timestamp,
    end: pd.Timestamp,
    read: list[Reading],
) -> Iterator[tuple[pd.Timestamp, pd.Timestamp, bool]]:
    """When there was an island while something was said, and when not.

    A plan says whether there is grid. That it was lost or came back meanwhile counts from its
    reading on if a ``later`` plan agrees, or if there is none.
    """
    changes = [one for one in read if begin < moment(one.time) < end]
    if known := said.get("grid"):
        island = not known["available"]
        if later and later["available"] == known["available"]:
            changes = []
    else:
        before = [one for one in read if moment(one.time) <= begin]
        island = bool(before) and before[-1].value == 0.0
    for one in changes:
        if (one.value == 0.0) != island:
            yield begin, moment(one.time), island
            begin, island = moment(one.time), not island
    yield begin, end, island


def off_in(
    part: StepPart,
    plan: Plan,
    alone: Callable[[], Scenario],
    options: RunOptions,
    store: Store,
) -> set[str]:
    """Customers that were off in a part of a step.

    One that could not be switched on was off. In an island that no plan had foreseen, or in which
    a battery rejected its set-point, it is the plant's answer, for the step ``alone``: such a
    battery neither gives power nor forms the grid.
    """
    rejected = store.rejected(one["id"] for one in part.setpoints)
    refuses = {(one["kind"], one["asset"]) for one in part.setpoints if one["id"] in rejected}
    off = part.off() | {name for kind, name in refuses if kind == "customers"}
    follow_all = all(kind != "batteries" for kind, _ in refuses)
    if (part.foreseen and (follow_all or not part.island)) or options.mode != "physical":
        return off
    now = alone()
    b = now.batteries
    follows = np.array([("batteries", str(name)) not in refuses for name in b.id], dtype=bool)
    grid = replace(now.grid, start=part.begin, step_minutes=h_to_minutes(part.hours), n_steps=1)
    rests = replace(b, p_max_kw=np.where(follows, b.p_max_kw, 0.0))
    island = replace(now, grid=grid, grid_limit_kw=np.zeros(1), batteries=rests)
    world = World(island, options)
    world.begin_as(plan, 0)
    world.day.island.formers = now.formers & follows  # no other was set to form it
    told = [
        {**one, "valid_from": written(part.begin)}
        for one in part.setpoints
        if (one["kind"], one["asset"]) not in refuses
    ]
    closed = closed_by(part.said, Branches.of(now))
    served = world.obey(0, told, closed).customers["served"]
    return off | {str(name) for name, on in zip(now.customers.id, served, strict=True) if not on}
