"""Protocol of a kind of flexible power in the service, which the kind's ``service`` implements.

A unit sends readings, receives set-points, and is replayed as plans knew it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, ClassVar, Literal, Protocol

import pandas as pd

from vppres.core.arrays import Flags, Floats
from vppres.kinds.kind import MOVE_KW
from vppres.kinds.table import FOLDERS, parts
from vppres.live.range import POWER_KW, RATING_SHARE
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import Plan, Plans
from vppres.service.storage.records import DECIDED, Reading, versions
from vppres.service.storage.store import Store

Direction = Literal["", "charging_positive", "injection_positive"]
Wrong = tuple[str, float, str, str]  # field, value, what is wrong, and what to do


@dataclass(frozen=True)
class Reckoned:
    """A store as a plan reckons it from the beginning to the end of its time.

    A reading further from it than ``slack`` is no error of a meter. What is read outside the
    limits counts as at them.
    """

    start: float
    end: float
    low: float
    high: float
    slack: float

    def is_far(self, value: float, share: float) -> bool:
        """Whether a value is far from what is reckoned after a share of the time."""
        now = self.start + (self.end - self.start) * min(max(share, 0.0), 1.0)
        return abs(min(max(value, self.low), self.high) - now) > self.slack


class LastReadings(Protocol):
    """The last readings of all devices."""

    def holding(self, quantity: str) -> dict[str, float]:
        """Readings of a quantity that hold, by asset."""

    def newest(self, quantity: str) -> dict[str, Reading]:
        """The last readings of a quantity by asset, however old they are."""


@dataclass(frozen=True, eq=False)
class Stored:
    """Stored state of a site's devices when a step is decided."""

    scenario: Scenario  #: the site
    time: pd.Timestamp  #: the step
    readings: LastReadings  #: the last readings
    #: Means since the last decision, by quantity and asset.
    means: Mapping[str, Mapping[str, float]]
    decided_at: pd.Timestamp  #: when the controller decided last
    plans: Sequence[Plan]  #: plans since then
    at: pd.Timestamp  #: the moment of the decision
    store: Store  #: where it is stored

    def ordered(self, kind: str, field: str) -> tuple[pd.Timestamp, dict[str, pd.Series]] | None:
        """Set-points of a kind's units since the controller decided; None if they are all its own.

        When it decided last, and by unit the numbers of a field from times on; nothing is ordered
        once a set-point is over.
        """
        said = [one for plan in self.plans for one in versions(plan) if one["status"] != "missed"]
        own = [one for one in said if one["status"] in DECIDED]
        if len(own) == len(said) or not len(getattr(self.scenario, kind)):
            return None
        begun = _begin(own[-1] if own else said[0])
        rows: dict[pd.Timestamp, dict[str, float]] = {}
        for one in said:
            points = [point for point in one["setpoints"] if point["kind"] == kind]
            if not points:
                continue
            begin = _begin(one)
            rows = {time: row for time, row in rows.items() if time < begin}
            rows[begin] = {point["asset"]: point[field] for point in points}
            rows[pd.Timestamp(points[0]["valid_until"])] = {}
        told = pd.DataFrame.from_dict(rows, orient="index", dtype=float).sort_index()
        told = told[(told.index >= begun) & (told.index < self.at)]
        return begun, {str(name): told[name] for name in told}


def _begin(plan: Plan) -> pd.Timestamp:
    """From when on a plan holds."""
    return pd.Timestamp(plan.get("valid_from", plan.get("start")))


class OfKind:
    """How the service speaks with the units of a kind; what most kinds have in common."""

    kind: str  #: its field in a scenario
    source: str  #: who tells its readings in a simulation
    direction: Direction = ""  #: which way a set-point's ``p_kw`` counts; empty if it has none
    #: Quantities by which a unit is there or can work, and what stands until they are read.
    states: ClassVar[Mapping[str, float]] = {}
    of_visits: tuple[str, ...] = ()  #: quantities that are read anew of every unit that comes
    told_once: tuple[str, ...] = ()  #: quantities that are said when they change: never late

    @property
    def live(self) -> Any:
        """The live part of the kind."""
        return parts("live")[self.kind]

    def readings(self, stored: Stored) -> dict[str, Any]:
        """Fields of a measurement, None where nothing is read."""
        means = self.live.MEANS
        return {
            name: dict(
                stored.means.get(name, {}) if name in means else stored.readings.holding(name)
            )
            or None
            for name in self.live.QUANTITIES
        }

    def of_those_here(self, readings: list[Reading]) -> list[Reading]:
        """Readings without those of units that have left since: they will tell nothing more."""
        return readings

    def stood(
        self, plan: Plan, one: Reading, before: Reading | None, rejected: Mapping[str, int]
    ) -> float:
        """The value that stood until a reading, which is news if it has another; NaN if none.

        ``rejected`` says when units rejected a set-point last.
        """
        return before.value if before and before.known else self.states.get(one.quantity, math.nan)

    def asked(self, said: Mapping[str, Any]) -> dict[str, Any]:
        """Fields of a set-point by what an operator says of a unit."""
        return {}

    def impossible(self, said: Any, units: Any, i: int) -> Iterator[Wrong]:
        """Refusals of an operator's values that a unit cannot follow."""
        return iter(())

    def action(self, setpoint: Mapping[str, Any]) -> str:
        """Action of a set-point in the words of explanations; empty if there is none."""
        return ""

    def told_by_plans(self, scenario: Scenario, stored: Plans) -> Scenario:
        """A scenario with units as stored plans knew them: that begin as the first plan says."""
        units = getattr(scenario, self.kind)
        if not len(units):
            return scenario
        first = parts("physics")[self.kind].PLANT(scenario).state
        begun = self.begun(units, self.state(scenario, 0, stored[0], first))
        return replace(scenario, **{self.kind: begun})

    def begun(self, units: Any, state: Any) -> Any:
        """Units that begin a day with a state."""
        return units

    def state(self, scenario: Scenario, t: int, plan: Plan, reckoned: Any) -> Any:
        """State that a step was decided on; as reckoned where its plan says nothing."""
        return reckoned

    def out(self, plan: Plan) -> list[str]:
        """Units that a plan does without, since they do not start."""
        return []

    def reckoned(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str, Reckoned]]:
        """Unit, quantity and state of stores that feed customers, as a plan reckons them."""
        return iter(())

    def formers(self, scenario: Scenario, plan: Plan) -> Iterator[tuple[str, str]]:
        """Units that can form the grid of an island, and why one cannot now."""
        return iter(())

    def able_kw(self, scenario: Scenario, recorded: Mapping[str, Any]) -> float:
        """Power that units could give in a recorded step."""
        return 0.0

    def held_kwh(self, scenario: Scenario, plan: Plan) -> tuple[float, float]:
        """Electric energy of full stores, and of what is in them, of units that can give it."""
        return 0.0, 0.0

    def measured(self, scenario: Scenario, units: Any, t: int) -> Iterator[tuple[str, str, float]]:
        """Quantity, unit and value of what units measure at the beginning of a step."""
        return iter(())

    def powers(self, t: int, units: Any, asked: Mapping[str, Floats], served: Flags) -> Floats:
        """Power of each unit of the plant by its set-points, (n,)."""
        raise NotImplementedError


@cache
def every() -> dict[str, OfKind]:
    """How the service speaks with the units of each kind."""
    return {kind: parts("service")[kind].SERVICE for kind in FOLDERS}


def told_by_plans(scenario: Scenario, stored: Plans) -> Scenario:
    """A scenario with the units of each kind as stored plans knew them."""
    for kind in every().values():
        scenario = kind.told_by_plans(scenario, stored)
    return scenario


def beyond_rating(name: str, value: float, rating: float, unit: str) -> Iterator[Wrong]:
    """Refusal of a value beyond a rating; None within it."""
    if abs(value) > rating + POWER_KW + RATING_SHARE * rating:
        yield name, value, f"is beyond its rating of {rating:g} {unit}", "Give at most the rating."


def moved(setpoint: Mapping[str, Any]) -> str:
    """Whether a set-point charges or discharges, in the words of explanations."""
    if abs(setpoint["p_kw"]) <= MOVE_KW:
        return ""
    return "charge" if setpoint["p_kw"] > 0 else "discharge"
