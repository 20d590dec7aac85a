"""News: readings that the present plan does not contain.

A device that is back or gone is planned for at once, as the grid is; so is one that is heard for
the first time, or after a silence for which the plan did without it; and so is a store that holds
far more or less than the plan reckons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import pandas as pd

from vppres.contract.decision import OUT
from vppres.control.guard.reckoning import JUMPED, SOC_JUMP
from vppres.day.trajectory import SWITCHES_OPEN
from vppres.scenario.configuration import LEFT_OPEN
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import expected_by
from vppres.service.clock import written
from vppres.service.of_kind import Reckoned, every
from vppres.service.storage.records import Reading, moment
from vppres.service.storage.store import Store
from vppres.service.telemetry.changes import GRID_LOST
from vppres.service.telemetry.grid_readings import CONTRADICTED, GRID_ON, LIMIT
from vppres.service.telemetry.knowledge import CLOSED, INSTANT

KIND_OF = {name: kind for kind in every().values() for name in (*kind.states, *kind.of_visits)}
"""The kind of which a quantity tells whether a unit is there, can work, or has come."""

STATES = ("online", *(name for kind in every().values() for name in kind.states))
"""What devices say of whether they are there and can work."""

OF_VISITS = tuple(name for kind in every().values() for name in kind.of_visits)
"""Readings of every unit that comes, anew."""

AGAINST_PLANS = (GRID_ON, "soc", "online", CLOSED)
"""What can contradict a plan."""

Key = tuple[str, str]
Plan = Mapping[str, Any]


def newest(readings: Iterable[Reading]) -> dict[Key, Reading]:
    """The last reading of each asset and quantity of which plans know the value at a time."""
    found: dict[Key, Reading] = {}
    for one in readings:
        key = one.asset, one.quantity
        latest = one.time >= found.get(key, one).time
        if latest and one.known and one.quantity in (*INSTANT, CLOSED):
            found[key] = one
    return found


class News:
    """Compares what comes with what was there."""

    def __init__(self, store: Store, scenario: Scenario) -> None:
        self.store = store
        self.scenario = scenario
        b = scenario.batteries
        self._batteries = [*zip(map(str, b.id), b.soc_min, b.soc_max, strict=True)]
        self._missing = set[Key]()

    def of(self, readings: Iterable[Reading], until: pd.Timestamp, plan: Plan) -> list[str]:
        """News in readings that are not stored yet; those up to a time count."""
        readings = list(readings)
        told = newest(one for one in readings if moment(one.time) <= until)
        found = [
            *self._changed(told, until, plan),
            *self._first(told, plan),
            *self._far(told, until, plan),
        ]
        self._missing -= set(told)
        last = {(one.asset, one.quantity): one for one in readings}
        self._missing |= {key for key, one in last.items() if not one.known}
        return found

    def _changed(
        self, told: Mapping[Key, Reading], until: pd.Timestamp, plan: Plan
    ) -> Iterator[str]:
        """States that are others than before, and what is read of a unit for the first time."""
        quantities = (*STATES, *OF_VISITS)
        if all(quantity not in quantities for _, quantity in told):
            return
        latest = self.store.latest(until, quantities)
        for of in every().values():
            latest = of.of_those_here(latest)
        before = {(one.asset, one.quantity): one for one in latest}
        of_kinds = {KIND_OF[name].kind for _, name in told if name in KIND_OF}
        rejected = {kind: self.store.refusing(kind) for kind in of_kinds}
        for (asset, quantity), one in told.items():
            was = before.get((asset, quantity))
            if quantity not in quantities or (was and was.time > one.time):
                continue
            if quantity == "online":
                value = was.value if was and was.known else 1.0
            else:
                of = KIND_OF[quantity]
                value = of.stood(plan, one, was, rejected[of.kind])
            if one.value != value:
                yield f"{asset} {quantity} = {one.value:g} ({one.source})"

    def _first(self, told: Mapping[Key, Reading], plan: Plan) -> Iterator[str]:
        """Devices without a reading so far, for long, or in the plan."""
        lost = {(one["asset"], one["quantity"]) for one in plan.get("late", ()) if is_lost(one)}
        for key in told:
            asset, kind = key
            if kind in (*STATES, *OF_VISITS, GRID_ON, CLOSED):
                continue
            unheard = not self.store.was_heard(asset, kind) or key in self._missing
            # A battery without any state of charge is out, and named so.
            if key in lost or (unheard and kind != "soc"):
                yield f"{kind} of {asset} is heard"

    def _far(self, told: Mapping[Key, Reading], until: pd.Timestamp, plan: Plan) -> Iterator[str]:
        """Stores far from what the plan reckons.

        A gauge that stands still is no news, unless the plan waits for it to bear out a jump.
        """
        stores = dict(self._reckoned(told, plan))
        if not stores:
            return
        begin = pd.Timestamp(plan.get("valid_from", plan["start"]))
        end = pd.Timestamp(plan["start"]) + self.scenario.grid.step
        latest = self.store.latest(until, {quantity for _, quantity in stores})
        before = {(one.asset, one.quantity): one for one in latest}
        for key, store in stores.items():
            one, was = told[key], before.get(key)
            if moment(one.time) < begin or (was and was.time > one.time):
                continue
            asset, quantity = key
            of_it = (
                words for words in plan["estimated"] if words.startswith(f"{quantity} {asset} ")
            )
            waits = any(words.endswith(JUMPED) for words in of_it)
            moved = waits or not was or was.value != one.value
            if moved and store.is_far(one.value, (moment(one.time) - begin) / (end - begin)):
                yield f"{quantity} of {asset} is {one.value:g} ({one.source})"

    def _reckoned(self, told: Mapping[Key, Reading], plan: Plan) -> Iterator[tuple[Key, Reckoned]]:
        """Stores that are read, as a plan reckons them; without batteries that are out."""
        expected, odd = expected_by(plan), plan.get("estimated", ())
        for asset, low, high in self._batteries:
            if (asset, "soc") in told and OUT.format(asset) not in odd:
                start = expected.get("soc_start", {}).get(asset)
                end = expected["soc"].get(asset) if start is not None else None
                if end is not None:
                    yield (asset, "soc"), Reckoned(start, end, low, high, SOC_JUMP)
        for kind in every().values():
            for asset, quantity, store in kind.reckoned(self.scenario, plan):
                if (asset, quantity) in told:
                    yield (asset, quantity), store


def is_lost(late: Mapping[str, Any]) -> bool:
    """Whether a late reading of a plan had been silent for too long to count."""
    return bool(late["state"] == "lost")


def is_said_lost(plan: Plan) -> bool:
    """Whether a plan has no grid because a reading says so."""
    grid = plan.get("grid") or {"available": True}
    return not grid["available"] and grid["known_by"] in ("reading", "last reading")


def unknown_to(plan: Plan, readings: Iterable[Reading], fed: Callable[[], bool]) -> Iterator[str]:
    """News in readings against a plan; without those for which it was already made anew.

    The grid is lost or back, or a battery or customer that the plan leaves out is heard. A loss
    that the plan knows to be contradicted is none as long as the site is ``fed``.
    """
    grid = plan.get("grid")
    for one in readings if grid else ():
        words = ""
        heard = one.known if one.quantity == "soc" else one.value == 1.0
        if one.quantity in ("soc", "online") and heard:
            out = OUT.format(one.asset) in plan.get("estimated", ())
            lost = any(one.asset == other["asset"] for other in plan.get("lost", ()))
            words = f"battery {one.asset} is heard" if out else ""
            words = f"customer {one.asset} is heard" if lost else words
        elif one.quantity == CLOSED and one.known and SWITCHES_OPEN in plan:
            left = any(why.format(one.asset) in plan.get("estimated", ()) for why in LEFT_OPEN)
            unlike = (one.value == 1.0) == (one.asset in plan[SWITCHES_OPEN])
            state = "closed" if one.value else "open"
            words = f"{one.asset} is {state} ({one.source})" if unlike and not left else ""
        elif grid and one.quantity == GRID_ON and one.known:
            change = "grid back" if one.value else GRID_LOST
            differs = (one.value == 1.0) != grid["available"]
            differs = differs and not (one.value == 1.0 and grid["known_by"] == LIMIT)
            doubt = CONTRADICTED.format(one.source)
            doubted = any(doubt in said for said in plan.get("estimated", ()))
            differs = differs and not (doubted and fed())
            at = written(moment(one.time))
            words = f"{change} at {at} ({one.source})" if differs else ""
        if words and words not in plan.get("anew", ""):
            yield words
