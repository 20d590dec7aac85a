"""What readings say that the present plan does not know.

A device that is back or gone is planned for at once, as the grid is; so is one that is heard for
the first time, or after a silence for which the plan did without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import pandas as pd

from vppres.contract.decision import OUT
from vppres.service.as_told import expected_by
from vppres.service.changes import GRID_LOST
from vppres.service.clock import written
from vppres.service.grid_readings import CONTRADICTED, GRID_ON
from vppres.service.knowledge import INSTANT, of_those_here
from vppres.service.records import Reading, moment
from vppres.service.store import Store

PLUGGED, START_FAULT = "plugged", "start_fault"

STATES = {"online": 1.0, START_FAULT: 0.0, PLUGGED: 0.0}
"""What devices say of whether they are there and can work, and what stands until they do."""

FALLING = ("ev_soc", "energy_needed_kwh")
"""What changes while a vehicle charges: the first reading of each vehicle is new."""

OF_VEHICLES = (*FALLING, "departure")

AGAINST_PLANS = (GRID_ON, "soc", "online")
"""What can contradict a plan."""

Key = tuple[str, str]
Plan = Mapping[str, Any]


def newest(readings: Iterable[Reading]) -> dict[Key, Reading]:
    """The last reading of each asset and quantity of which plans know the value at a time."""
    found: dict[Key, Reading] = {}
    for one in readings:
        key = one.asset, one.quantity
        if one.value is not None and one.quantity in INSTANT:
            before = found.get(key)
            if before is None or before.time <= one.time:
                found[key] = one
    return found


class News:
    """Compares what comes with what was there.

    Parameters
    ----------
    store : Store
        What was received before.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        self._missing = set[Key]()

    def of(self, readings: Iterable[Reading], until: pd.Timestamp, plan: Plan) -> list[str]:
        """What is new in readings that are not kept yet; those up to a time count."""
        readings = list(readings)
        told = newest(one for one in readings if moment(one.time) <= until)
        found = [*self._changed(told, until, plan), *self._first(told, plan)]
        self._missing -= set(told)
        last = {(one.asset, one.quantity): one.value for one in readings}
        self._missing |= {key for key, value in last.items() if value is None}
        return found

    def _changed(
        self, told: Mapping[Key, Reading], until: pd.Timestamp, plan: Plan
    ) -> Iterator[str]:
        """States that are others than before, and what is read of a vehicle for the first time."""
        kinds = {kind for _, kind in told if kind in STATES or kind in OF_VEHICLES}
        if not kinds:
            return
        latest = of_those_here(self.store.latest(until, (*STATES, *OF_VEHICLES)))
        before = {(one.asset, one.quantity): one for one in latest}
        here = expected_by(plan).get("vehicles", {})
        rejected = self.store.refusing("gensets")
        for (asset, kind), one in told.items():
            was = before.get((asset, kind))
            if kind not in kinds or (was is not None and was.time > one.time):
                continue
            value = None if was is None else was.value
            if kind == START_FAULT and asset in rejected:
                # A start that was rejected since the last reading is a fault.
                value = 1.0 if was is None or was.time <= rejected[asset] else value
            if value is not None and kind in FALLING:
                continue
            if value is None and kind in STATES:
                value = float(asset in here) if kind == PLUGGED else STATES[kind]
            if one.value != value:
                yield f"{asset} {kind} = {one.value:g} ({one.source})"

    def _first(self, told: Mapping[Key, Reading], plan: Plan) -> Iterator[str]:
        """What was never heard, or not for long, or was missing."""
        lost = {(one["asset"], one["quantity"]) for one in plan.get("late", ()) if is_lost(one)}
        for key in told:
            asset, kind = key
            if kind in (*STATES, *OF_VEHICLES, GRID_ON):
                continue
            unheard = not self.store.was_heard(asset, kind) or key in self._missing
            # A battery without any state of charge is out, and named so.
            if key in lost or (unheard and kind != "soc"):
                yield f"{kind} of {asset} is heard"


def is_lost(late: Mapping[str, Any]) -> bool:
    """Whether a late reading of a plan had been silent for too long to count."""
    return bool(late["state"] == "lost")


def is_said_lost(plan: Plan) -> bool:
    """Whether a plan has no grid because a reading says so."""
    grid = plan.get("grid") or {"available": True}
    return not grid["available"] and grid["known_by"] in ("reading", "last reading")


def unknown_to(plan: Plan, readings: Iterable[Reading], fed: Callable[[], bool]) -> Iterator[str]:
    """What readings say against a plan; nothing for which it was made anew.

    The grid is lost or back, or a battery or customer that the plan leaves out is heard. A loss
    that the plan knows to be contradicted is none as long as the site is ``fed``.
    """
    grid = plan.get("grid")
    for one in readings if grid is not None else ():
        words = ""
        heard = one.value is not None if one.quantity == "soc" else one.value == 1.0
        if one.quantity in ("soc", "online") and heard:
            out = OUT.format(one.asset) in plan.get("estimated", ())
            lost = any(one.asset == other["asset"] for other in plan.get("lost", ()))
            words = f"battery {one.asset} is heard" if out else ""
            words = f"customer {one.asset} is heard" if lost else words
        elif one.quantity == GRID_ON and one.value is not None:
            change = "grid back" if one.value else GRID_LOST
            differs = grid is not None and (one.value == 1.0) != grid["available"]
            doubt = CONTRADICTED.format(one.source)
            doubted = any(doubt in said for said in plan.get("estimated", ()))
            differs = differs and not (doubted and fed())
            at = written(moment(one.time))
            words = f"{change} at {at} ({one.source})" if differs else ""
        if words and words not in plan.get("anew", ""):
            yield words
