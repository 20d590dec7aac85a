"""From what is stored to the measurement of a step: what is heard, late, or lost.

A reading holds for its own resolution, demand and PV power for a step at least. What is older is
late: of demand and PV power the guard estimates it. Of the state of charge the newest reading
counts, however old it is, and the guard adds what was stored since.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from vppres.contract.decision import UNDIMMED
from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean
from vppres.kinds.kind import EARLY_SHARE
from vppres.kinds.table import parts
from vppres.live.by_phase import GRID
from vppres.live.controller import Controller
from vppres.live.door import float_of, readable
from vppres.live.measurement import Measurement
from vppres.live.range import Range
from vppres.live.ranges import RANGES, ranges_of
from vppres.outlook.belief import HALF
from vppres.scenario.formers import forming_kinds
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.events.announced import (
    announced_at,
    announced_kw,
    is_over,
    limits_kw,
    outages,
    prices,
)
from vppres.service.of_kind import Stored, Wrong, beyond_rating, every
from vppres.service.payloads import OperatorSetpoint, Readings
from vppres.service.storage.followed import REFUSED
from vppres.service.storage.records import DECIDED, Event, Reading, moment, seconds, versions
from vppres.service.storage.store import Store
from vppres.service.telemetry.grid_readings import GRID_ON, LIMIT, contradiction, stands_alone
from vppres.service.telemetry.lost import ONLINE, lost_batteries, lost_customers, undimmed_customers
from vppres.service.telemetry.phased_readings import stored, with_sums, wrong_phase
from vppres.service.telemetry.refused import Refusal
from vppres.service.window import CAUTIOUS, Window

OF_KINDS = {kind: live.QUANTITIES for kind, live in parts("live").items()}
"""Quantities of the units of each kind."""

MEAN = (
    "battery_kw",
    "import_kw",
    *(name for live in parts("live").values() for name in live.MEANS),
)
INSTANT = (
    *("soc", "load_kw", "pv_kw", "online", "grid_on"),
    *(name for names in OF_KINDS.values() for name in names if name not in MEAN),
)
HELD = tuple(name for live in parts("live").values() for name in live.HELD)
"""States of units that set-points change."""

CLOSED = "closed"
"""Quantity of the state of a switch, 1 or 0. It holds until another one is read."""

MOVING = ("soc", "grid_on")
"""Readings that are late by their own period, however long a step is."""

LASTING = (ONLINE, GRID_ON)
"""States that last until another one is read."""

MOST_STEPS = 24
"""Steps over which means are taken where nothing was decided for long."""

LOST_AFTER = 3
"""Multiples of the time for which a reading holds."""

WHERE = "telemetry"

_Powers = tuple[pd.DataFrame | None, dict[str, list[str]], list[str]]


@dataclass(frozen=True, eq=False)
class Latest:
    """Last readings of all that was ever received, at a moment within a step of some length."""

    found: list[Reading]  #: one of each asset and quantity
    now_s: int
    step_s: int

    @classmethod
    def at(cls, time: pd.Timestamp, scenario: Scenario, store: Store) -> Latest:
        """Readings of a time, by clocks that may be a little off."""
        step_s = round(scenario.grid.step_minutes * 60)
        until = time + pd.Timedelta(seconds=EARLY_SHARE * step_s)
        # Silence brings neither a device nor the grid back.
        found = [one for one in store.latest(until, INSTANT) if one.quantity not in LASTING]
        found += store.latest(until, LASTING, known=True)
        found.sort(key=lambda one: (one.quantity == ONLINE, one.asset, one.quantity))
        for kind in every().values():
            found = kind.of_those_here(found)
        return cls(found, seconds(time), step_s)

    def age_s(self, one: Reading) -> int:
        """Age of a reading; a mean is as old as the end of its time."""
        held = one.time + (one.resolution_s if one.quantity in MEAN else 0)
        return max(self.now_s - held, 0)

    def state(self, one: Reading) -> str:
        """A reading is "ok", "stale" where it is estimated, "lost" after long silence."""
        long_s = max(one.resolution_s, self.step_s)
        if self.age_s(one) < (one.resolution_s if one.quantity in MOVING else long_s):
            return "ok"
        # An outage that was seen lasts on.
        return "stale" if self.age_s(one) <= LOST_AFTER * long_s else "lost"

    @property
    def heard(self) -> list[dict[str, Any]]:
        """Age and state of each reading, as answers have them; what is said once is never late."""
        once = {name for kind in every().values() for name in kind.told_once}
        return [
            {
                "asset": one.asset,
                "quantity": one.quantity,
                "source": one.source,
                "age_s": self.age_s(one),
                "state": state,
            }
            for one in self.found
            if (state := self.state(one)) == "ok" or one.quantity not in once
        ]

    @property
    def soc(self) -> dict[str, float]:
        """States of charge that were read last, by battery."""
        return {name: one.value for name, one in self.newest("soc").items()}

    @property
    def grid(self) -> Reading | None:
        """The last reading of whether there is grid, however old it is; None without one."""
        return next(iter(self._of("grid_on")), None)

    def now(self, quantity: str) -> dict[str, float]:
        """Readings of a quantity by asset; NaN where it is too old, or known to be missing."""
        found = self._of(quantity)
        return {one.asset: one.value if self.state(one) == "ok" else np.nan for one in found}

    def holding(self, quantity: str) -> dict[str, float]:
        """Readings of a quantity that hold, by asset."""
        return {one: value for one, value in self.now(quantity).items() if np.isfinite(value)}

    def newest(self, quantity: str) -> dict[str, Reading]:
        """The last readings of a quantity by asset, however old they are."""
        return {one.asset: one for one in self._of(quantity) if one.known}

    def lost(self, quantity: str) -> set[str]:
        """Assets that have been silent for too long."""
        return {one.asset for one in self._of(quantity) if self.state(one) == "lost"}

    def _of(self, quantity: str) -> list[Reading]:
        return [one for one in self.found if one.quantity == quantity]


@dataclass(frozen=True, eq=False)
class Grid:
    """Whether there is grid in a step, who says so, and limits of the window, 0 in outages."""

    available: bool
    known_by: str
    limits_kw: Floats


@dataclass(frozen=True, eq=False)
class StepInputs:
    """Inputs of a step, and readings to request ``again``."""

    measurement: Measurement
    latest: Latest
    grid: Grid
    estimated: list[str]
    lost: dict[str, str] = field(default_factory=dict)
    again: str = ""

    @property
    def limits_kw(self) -> pd.Series[float]:
        """Limits of import over the window, infinite where there are none."""
        return pd.Series(self.measurement.grid_limit_kw)


def assets_of(scenario: Scenario) -> dict[str, list[str]]:
    """Assets of each quantity."""
    batteries = [str(name) for name in scenario.batteries.id]
    customers = [str(name) for name in scenario.customers.id]
    forming = (units.id for units in forming_kinds(scenario).values())
    return {
        "soc": batteries,
        "battery_kw": batteries,
        "online": [*batteries, *customers],
        "load_kw": customers,
        "pv_kw": [str(name) for name in scenario.pv.id],
        "import_kw": [GRID],
        "grid_on": [GRID],
        CLOSED: [str(name) for name in scenario.switches.id],
        **{
            name: [str(unit) for unit in getattr(scenario, kind).id]
            for kind, names in OF_KINDS.items()
            for name in names
        },
        "source_kva": [GRID, *batteries, *(str(unit) for ids in forming for unit in ids)],
        "v_pu": list(scenario.phases.by_bus),
    }


def check_names(scenario: Scenario) -> None:
    """Whether a reading of an asset is always that of one device.

    Raises
    ------
    InputError
        If devices of two kinds that send the same quantity have one name.
    """
    shared = {
        name: quantity
        for quantity, names in assets_of(scenario).items()
        for name, count in Counter(names).items()
        if count > 1
    }
    if shared:
        raise InputError(
            Problem(
                "scenario",
                f"is the name of two devices, and a reading of {quantity} says not whose it is",
                "Give one of them another identifier.",
                field="id",
                value=name,
            )
            for name, quantity in shared.items()
        )


def readings_of(
    batch: Iterable[Readings], scenario: Scenario, until: pd.Timestamp
) -> tuple[list[Reading], list[Refusal]]:
    """Readings that can be kept, and what is wrong with the others.

    Those after ``until``, the end of the next step, are of another clock.
    """
    assets = assets_of(scenario)
    own = ranges_of(scenario)
    good: list[Reading] = []
    refused: list[Refusal] = []
    for one in batch:
        wrong = _wrong_series(one, assets, scenario, until)
        if wrong:
            refused.append(Refusal(one.source, one.asset, one.quantity, wrong))
            continue
        permitted = own.get((one.quantity, one.asset), RANGES[one.quantity])
        for step, sent in enumerate(one.values):
            number = float_of(sent)
            value = np.nan if number is None else number
            if not (sent is None or permitted.holds(value)):
                wrong = _wrong_value(f"{one.quantity} of {one.asset}", sent, value, permitted)
                refused.append(Refusal(one.source, one.asset, one.quantity, wrong))
                continue
            if one.quantity == "pv_kw":
                value = max(value, 0.0)
            time = seconds(one.start + step * one.resolution)
            long = int(one.resolution.total_seconds())
            quantity = stored(one.quantity, one.phase)
            good.append(Reading(one.asset, quantity, time, one.source, long, value))
    kept, incomplete = with_sums(good, scenario)
    return kept, [*refused, *incomplete]


def _wrong_series(
    one: Readings, assets: Mapping[str, list[str]], scenario: Scenario, until: pd.Timestamp
) -> Problem | None:
    """Errors of a series as a whole."""
    known = assets[one.quantity]
    if one.asset not in known:
        there = any(one.asset in names for names in assets.values())
        message = f"has no {one.quantity}" if there else "is not at the site"
        cure = did_you_mean(one.asset, known, f"Give an asset with {one.quantity}.")
        return Problem(WHERE, message, cure, None, "asset", one.asset)
    wrong = wrong_phase(one, scenario)
    last = one.start + (len(one.values) - 1) * one.resolution
    if not wrong and last >= until:
        cure = f"Set the clock of {one.source}; the present step ends at {written(until)}."
        time = written(last)
        return Problem(WHERE, "lies in the future", cure, None, f"time of {one.asset}", time)
    return wrong


def _wrong_value(what: str, sent: object, value: float, permitted: Range) -> Problem:
    """Error of a value: it is no number, or outside the quantity's range."""
    if math.isnan(value):
        cure = "Give a number, or null where it is missing."
        return Problem(WHERE, "is not a number", cure, None, what, readable(sent))
    return Problem(WHERE, permitted.text(value), permitted.cure, None, what, sent)


def check_setpoints(asked: Iterable[OperatorSetpoint], scenario: Scenario) -> None:
    """Whether an operator asks of devices that there are what they can do.

    Raises
    ------
    InputError
        With everything that is not at the site or beyond a rating.
    """
    problems = []
    for one in asked:
        devices = getattr(scenario, one.kind)
        known = [str(name) for name in devices.id]
        if one.asset not in known:
            cure = did_you_mean(one.asset, known, f"Give one of the {one.kind}.")
            problems.append(Problem("mode", "is not at the site", cure, None, "asset", one.asset))
            continue
        for name, value, message, cure in _impossible(one, devices, known.index(one.asset)):
            where = f"{name} of {one.asset}"
            problems.append(Problem("mode", message, cure, None, where, value))
    if problems:
        raise InputError(problems)


def _impossible(one: OperatorSetpoint, devices: Any, i: int) -> Iterator[Wrong]:
    """Refusal of a value that a device cannot have: field, value, error and cure."""
    if one.kind in OF_KINDS:
        yield from every()[one.kind].impossible(one, devices, i)
    elif one.p_kw is not None:
        yield from beyond_rating("p_kw", one.p_kw, devices.p_max_kw[i], "kW")
        apparent_kva = math.hypot(one.p_kw, one.q_kvar)
        yield from beyond_rating("kVA", apparent_kva, devices.s_max_kva[i], "kVA")
    if one.share is not None and one.share < devices.least_share[i]:
        least = f"{devices.least_share[i]:g}"
        yield "share", one.share, f"is below the least share of {least}", "Give more, or 1."


def known_at(
    time: pd.Timestamp,
    controller: Controller,
    store: Store,
    own_days: bool = False,
    now: pd.Timestamp | None = None,
) -> StepInputs:
    """Inputs at the beginning of a step.

    The controller knows the outages that are announced. Where the scenario's ``own_days`` come,
    limits ahead are not known; ``now`` is the moment of a step that is decided anew within it.
    """
    scenario = controller.scenario
    at = now or time
    readings, window, events, load, (grid, doubt) = _announced_and_read(time, controller, store, at)
    load_kw, foretold_load, load_words = load
    pv_kw, foretold_pv, pv_words = _powers("pv_kw", scenario.pv.id, window, readings, store)
    said = _Said.since(controller.decided, time - window.length, at, store)
    means = _means(store, max(said.decided_at, at - MOST_STEPS * window.length), at)
    stored = Stored(scenario, time, readings, means, said.decided_at, said.plans, at, store)
    lost = lost_customers(scenario, readings.newest("online"), store)
    undimmed = undimmed_customers(scenario, readings.newest("online"), store)
    announced = announced_kw(events, window, own_days)
    of_kinds = {n: read for kind in every().values() for n, read in kind.readings(stored).items()}
    measurement = Measurement(
        time,
        soc=readings.soc,
        load_kw=load_kw,
        pv_kw=pv_kw,
        price_gbp_per_kwh=pd.Series(prices(events, window), window.times),
        grid_limit_kw=pd.Series(grid.limits_kw, window.times),
        **_of_batteries(scenario, readings, means.get("battery_kw", {}), store),
        import_kw=means.get("import_kw", {}).get(GRID) if said.by_controller else None,
        connected=dict.fromkeys(lost, False),
        dimmable=dict.fromkeys(undimmed, False),
        closed=states_of(scenario, store, at),
        announced_limit_kw=None
        if announced is None
        else pd.Series(announced, window.times).dropna(),
        foretold=foretold_load | foretold_pv,
        now=now,
        ordered_kw=said.ordered_kw,
        **of_kinds,
        read_at={
            name: {one: moment(readings.newest(name)[one].time) for one in values}
            for name, values in of_kinds.items()
            if name in HELD and values
        },
    )
    whole = [f"{UNDIMMED.format(name)} ({why})" for name, why in undimmed.items()]
    estimated = [*load_words, *pv_words, *whole, *([doubt] if doubt else [])]
    again = ""
    if grid.known_by == "reading" and not grid.available:
        again = stands_alone(readings.grid, at, window.length, store)
    return StepInputs(measurement, readings, grid, estimated, lost, again)


def _of_batteries(
    scenario: Scenario, readings: Latest, read_kw: Mapping[str, float], store: Store
) -> dict[str, Any]:
    """Power, age of the state of charge, and whether each battery can work."""
    ids = [str(name) for name in scenario.batteries.id]
    soc = readings.newest("soc")
    out = refusing(soc, store) | lost_batteries(scenario, readings.newest(ONLINE)).keys()
    return {
        "battery_kw": {name: read_kw[name] for name in ids if name in read_kw} or None,
        "online": {name: name not in out for name in ids},
        "soc_at": {name: moment(reading.time) for name, reading in soc.items()},
    }


def grid_at(time: pd.Timestamp, controller: Controller, store: Store, now: pd.Timestamp) -> Grid:
    """Whether there is grid in a step without a decision; a moment in it counts."""
    return _announced_and_read(time, controller, store, now)[-1][0]


def _announced_and_read(
    time: pd.Timestamp, controller: Controller, store: Store, at: pd.Timestamp
) -> tuple[Latest, Window, list[Event], _Powers, tuple[Grid, str]]:
    """Readings, the window, events that count, the demand, and the grid with doubts about it."""
    readings = Latest.at(at, controller.scenario, store)
    window = Window.of(controller, time)
    replaced = controller.replaced(time)
    events = [event for name, event in store.events().items() if name not in replaced]
    load = _powers("load_kw", controller.scenario.customers.id, window, readings, store)
    grid = _grid(controller, window, readings, events, at, load[0], store)
    return readings, window, events, load, grid


def states_of(scenario: Scenario, store: Store, time: pd.Timestamp) -> dict[str, bool]:
    """Whether switches are closed, by the last reading of each that is not missing.

    A switch does not move because nothing is heard of it.
    """
    names = {str(name) for name in scenario.switches.id}
    until = time + EARLY_SHARE * scenario.grid.step
    latest = store.latest(until, [CLOSED], known=True) if names else []
    return {one.asset: one.value == 1.0 for one in latest if one.asset in names}


def soc_now(
    latest: Latest, plan: Mapping[str, Any], step: pd.Timedelta, now: pd.Timestamp
) -> dict[str, float]:
    """States of charge at a moment: readings that hold, else the newest and the set-points since.

    The newest alone where the plan expects nothing, as by hand.
    """
    newest = latest.newest("soc")
    found = latest.soc
    if expected := plan.get("expected"):
        begin = pd.Timestamp(plan.get("valid_from", plan["start"]))
        end = pd.Timestamp(plan["start"]) + step
        for name, start in expected.get("soc_start", {}).items():
            after = expected["soc"][name]
            if start is None or after is None:
                continue
            at, value = begin, start
            if name in newest and moment(newest[name].time) > begin:
                at, value = min(moment(newest[name].time), end), found[name]
            found[name] = value + (after - start) * ((min(now, end) - at) / (end - begin))
    return found | latest.holding("soc")


def _powers(quantity: str, ids: Names, window: Window, readings: Latest, store: Store) -> _Powers:
    """Loads or PV power of a window: what is read now, and what is expected of later steps.

    Assets that a forecast was sent for, by quantity, and in words for which of them, silent for
    too long, an estimate stands in. No table where there are no assets.
    """
    if not len(ids):
        return None, {}, []
    forecast = store.forecast(quantity, window.times[0] + window.length)
    table, cautious = window.expected(quantity, ids, forecast, readings.lost(quantity))
    foretold = {quantity: list(forecast.assets) if forecast else []}
    words = [f"{quantity} {name} is {CAUTIOUS[quantity]} of its forecast" for name in cautious]
    read = {k: v for k, v in readings.now(quantity).items() if k not in cautious}
    names = [str(name) for name in ids]
    table[0] = [read.get(name, old) for name, old in zip(names, table[0], strict=True)]
    return pd.DataFrame(table, window.times, names), foretold, words


@dataclass(frozen=True, eq=False)
class _Said:
    """Set-points of devices since the controller decided last."""

    decided_at: pd.Timestamp  #: when that was
    #: Set-points of batteries from times on; None where there are none.
    ordered_kw: pd.DataFrame | None
    by_controller: bool  #: whether all of it was the controller's own
    plans: list[dict[str, Any]] = field(default_factory=list)  #: what was said

    @classmethod
    def since(
        cls, decided: pd.Timestamp | None, before: pd.Timestamp, now: pd.Timestamp, store: Store
    ) -> _Said:
        """Plans from a step on up to now; from ``before`` on if none was decided."""
        plans = store.plans(decided or before, now)
        if not plans:
            return cls(before, None, True)
        ordered: list[tuple[pd.Timestamp, dict[str, float]]] = []
        for plan in plans:
            for one in versions(plan):
                rows = _orders(one, store)
                # A new plan replaces what was said of later.
                ordered = [row for row in ordered if not rows or row[0] < rows[0][0]] + rows
        held = [row for row in ordered if row[0] < now]
        table = pd.DataFrame([power for _, power in held], [time for time, _ in held])
        own = [plan for plan in plans if plan["status"] in DECIDED]
        return cls(
            pd.Timestamp((own or plans)[-1].get("valid_from", before)),
            table if len(table) else None,
            plans[-1]["status"] in DECIDED,
            plans,
        )


def _orders(plan: Mapping[str, Any], store: Store) -> list[tuple[pd.Timestamp, dict[str, float]]]:
    """Set-points of batteries in a plan, and that they rest when it is over.

    Those that refused did nothing.
    """
    points = [one for one in plan["setpoints"] if one["kind"] == "batteries"]
    if not points:
        return []
    said = store.acks(one["id"] for one in points)
    refused = {name for name, one in said.items() if one["status"] in REFUSED}
    told = {one["asset"]: 0.0 if one["id"] in refused else one["p_kw"] for one in points}
    rest = {one["asset"]: one["default"]["p_kw"] for one in points}
    return [
        (pd.Timestamp(points[0]["valid_from"]), told),
        (pd.Timestamp(points[0]["valid_until"]), rest),
    ]


def refusing(soc: Mapping[str, Reading], store: Store) -> set[str]:
    """Batteries that did not follow their set-points, until they say how they are."""
    return {
        name
        for name, at in store.refusing("batteries").items()
        if name not in soc or soc[name].time < at
    }


def _grid(
    controller: Controller,
    window: Window,
    readings: Latest,
    events: list[Event],
    now: pd.Timestamp,
    load_kw: pd.DataFrame | None,
    store: Store,
) -> tuple[Grid, str]:
    """Whether there is grid: by its own reading, else by what is announced or believed.

    A reading that it is lost, and that another one contradicts, counts for nothing; in words what
    contradicts it.
    """
    demand_kw = 0.0 if load_kw is None else float(load_kw.iloc[0].sum())
    doubt = contradiction(readings.grid, now, window.length, store, demand_kw)
    # What ended within the step is over for the rest of it.
    lasting = [one for one in events if one.said and not is_over(one.said, now)]
    limits = limits_kw(lasting, window)
    out = outages(lasting, window) | (limits <= 0.0)
    read = readings.now("grid_on").get(GRID, np.nan)
    last = readings.grid
    known_by = "profile"
    has_begun = announced_at(events, now)
    if read == 1.0 and last and has_begun and not announced_at(events, moment(last.time)):
        read = np.nan  # it says nothing of an outage that was announced and has begun since
    if doubt:
        read, last = np.nan, None
    if np.isfinite(read):
        known_by = "reading"
        if read == 0.0 and not out[0]:
            # As an outage that was announced without an end: until an event says otherwise.
            out[:] = True
        out[0] = read == 0.0
    elif out[0]:
        known_by = "event"
    elif last and last.value == 0.0 and not announced_at(events, moment(last.time)):
        # Its end was neither announced nor seen.
        known_by = "last reading"
        out[:] = True
    elif controller.out_probability(window.times[0]).iloc[0] >= HALF:
        known_by = "belief"
        out[0] = True
    if read == 1.0 and limits[0] <= 0.0:
        known_by = LIMIT
    limits = np.where(out, 0.0, limits)
    return Grid(bool(limits[0] > 0.0), known_by, limits), doubt


def _means(store: Store, begun: pd.Timestamp, now: pd.Timestamp) -> dict[str, dict[str, float]]:
    """Means over a time by quantity and asset, of the readings whose middle lies in it."""
    length = now - begun
    values: dict[str, dict[str, list[float]]] = {}
    for reading in store.between(begun - length, now, MEAN):
        middle_s = reading.time + reading.resolution_s / 2
        if reading.known and seconds(begun) <= middle_s < seconds(now):
            of_quantity = values.setdefault(reading.quantity, {})
            of_quantity.setdefault(reading.asset, []).append(reading.value)
    return {
        quantity: {asset: sum(each) / len(each) for asset, each in by_asset.items()}
        for quantity, by_asset in values.items()
    }


def last_heard(store: Store) -> dict[str, str]:
    """When each source was last heard from, as answers have it."""
    return {source: written(moment(at)) for source, at in store.contacts().items()}
