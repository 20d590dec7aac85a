"""Conditions that need an operator now: a function for each kind."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.text import named
from vppres.kinds.customer.data import limits_h, steps_within
from vppres.live.by_phase import GRID
from vppres.scenario.scenario import Scenario
from vppres.service.as_told import expected_by
from vppres.service.events.announced import announced_at
from vppres.service.events.faults import behind_faults, behind_open
from vppres.service.of_kind import every
from vppres.service.plans.document import DARK, PROPOSED, points_at, refused_of
from vppres.service.plans.forming import FormerState, formers_now, why_dark
from vppres.service.storage.followed import REFUSED, why_refused
from vppres.service.storage.records import asks, seconds
from vppres.service.storage.store import Store
from vppres.service.telemetry.changes import GRID_LOST
from vppres.service.telemetry.knowledge import Latest, refusing, soc_now
from vppres.service.telemetry.lost import ONLINE, lost_batteries, lost_customers

HIGH, MEDIUM = "high", "medium"
PRIORITIES = (HIGH, MEDIUM)
"""The first needs an operator at once, the second within the hour."""

AHEAD = pd.Timedelta(hours=6)
"""How far ahead of a planned loss of supply an operator is notified: time to bring a generator."""

SOON = pd.Timedelta(hours=1)
"""Before which there is no time for that any more."""

LEAST_MARGIN = 0.1
"""Share of the usable energy below which an island is about to end."""

NAMES_SHOWN = 5

BY_HAND = ("hold", "manual")
"""Modes in which an operator decides."""

UNPLANNED = (*BY_HAND, "off")
"""Modes without a plan of the controller."""


@dataclass(frozen=True)
class Condition:
    """Something that is wrong.

    Its ``subject`` is an asset or source, empty if it is the site. An acknowledgement is about its
    ``items``, for example the customers that are off; it may be ``due`` later.
    """

    kind: str
    subject: str
    priority: str
    text: str
    items: tuple[str, ...] = ()
    due: pd.Timestamp | None = None

    @property
    def due_at(self) -> int | None:
        """When it is due, as it is stored."""
        return seconds(self.due) if self.due else None

    @property
    def key(self) -> tuple[str, str]:
        """Identity of the alarm: two conditions with the same key are one alarm."""
        return self.kind, self.subject


@dataclass(frozen=True, eq=False)
class Situation:
    """How a site is, with its last plan, how long that still holds, and what it misses.

    The plan is empty before the first. Whether there is grid was ``read_by`` a source last; an
    outage of now may be ``announced``.
    ``formers`` can form the grid of an island; None in paper mode, whose islands need none.
    ``switching_stopped`` says why an order of switching goes no further.
    """

    now: pd.Timestamp
    scenario: Scenario
    plan: Mapping[str, Any]
    ahead_s: float
    unaware_of: Sequence[str]
    heard: Sequence[Mapping[str, Any]]
    soc: Mapping[str, float]
    is_dark: bool
    failing: Mapping[str, str]
    grid_on: float = math.nan
    unreached: Sequence[str] = ()
    read_by: str = ""
    announced: bool = False
    formers: Sequence[FormerState] | None = None
    switching_stopped: str = ""
    rejected: Mapping[str, str] = field(default_factory=dict)  #: set-points of now, and why

    @property
    def known_soc(self) -> Floats:
        """State of charge of each battery, that of an empty one where it is not known, (B,)."""
        b = self.scenario.batteries
        known = zip(b.id, b.soc_min, strict=True)
        return np.array([self.soc.get(str(name), least) for name, least in known])

    @property
    def why_dark(self) -> str:
        """Why no customer is supplied in an island; empty if something forms its grid, or may."""
        if self.formers is None:
            return ""
        return why_dark(self.plan, self.formers, self.is_dark)

    @property
    def off(self) -> set[str]:
        """Customers without supply: all of a dark island, whatever was ordered."""
        if self.why_dark:
            return {str(name) for name in self.scenario.customers.id}
        points = points_at(self.plan, self.now)
        return {one["asset"] for one in points if one.get("served") is False}

    @cached_property
    def behind_faults(self) -> list[tuple[Mapping[str, Any], set[str]]]:
        """Faults of lines and buses of now, each with the customers behind it."""
        return behind_faults(self.plan, self.scenario, self.now)

    def blacked_out(self, customers: Sequence[str]) -> str:
        """Why the first of some customers that a fault blacks out has no supply; empty for none."""
        reasons = {one["asset"]: one["reason"] for one in points_at(self.plan, self.now)}
        dark = (why for name in customers if (why := reasons.get(name, "")).startswith(DARK))
        return next(dark, "").removeprefix(DARK)

    def clock(self, time: str | pd.Timestamp) -> str:
        """Hours and minutes at the site."""
        return f"{pd.Timestamp(time).tz_convert(self.scenario.grid.zone):%H:%M}"

    @property
    def critical(self) -> set[str]:
        """Customers of the first tier."""
        c = self.scenario.customers
        first = self.scenario.tiers[0]
        return {str(name) for name, tier in zip(c.id, c.tier, strict=True) if tier == first}


def situation(
    now: pd.Timestamp,
    scenario: Scenario,
    store: Store,
    plan: Mapping[str, Any],
    ahead_s: float,
    unaware_of: Sequence[str] = (),
    mode: str | None = None,
) -> Situation:
    """How a site is by what is stored; ``mode`` is that of its islands, if not the scenario's."""
    latest = Latest.at(now, scenario, store)
    failing = failing_now(scenario, latest, store, plan)
    grid = plan.get("grid")
    read = latest.newest("grid_on").get(GRID)
    grid_on = read.value if read else math.nan
    is_dark = not grid["available"] if grid else grid_on == 0.0
    soc = soc_now(latest, plan, scenario.grid.step, now)
    physical = (mode or scenario.controller.mode) == "physical"
    return Situation(
        now,
        scenario,
        plan,
        ahead_s,
        unaware_of,
        latest.heard,
        soc,
        is_dark,
        failing,
        grid_on,
        read_by=read.source if read else "",
        announced=announced_at([*store.events().values()], now),
        formers=formers_now(scenario, plan, soc, failing) if physical else None,
        rejected=rejected_now(plan, now, store),
    )


def rejected_now(plan: Mapping[str, Any], now: pd.Timestamp, store: Store) -> dict[str, str]:
    """Devices that rejected the set-points that hold now and can be used all the same, and why."""
    points = {one["id"]: one["asset"] for one in points_at(plan, now) if not asks(one)}
    said = {points[name]: one for name, one in store.acks(points).items()}
    return {name: why_refused(one) for name, one in said.items() if one["status"] in REFUSED}


def failing_now(
    scenario: Scenario, latest: Latest, store: Store, plan: Mapping[str, Any]
) -> dict[str, str]:
    """Devices that do not follow their set-points, and why."""
    batteries = dict.fromkeys(refusing(latest.newest("soc"), store), "its device rejected it")
    batteries |= lost_batteries(scenario, latest.newest(ONLINE))
    out = [name for kind in every().values() for name in kind.out(plan)]
    units = dict.fromkeys(out, "it does not start")
    return {**batteries, **lost_customers(scenario, latest.newest(ONLINE), store), **units}


def conditions(now: Situation) -> Iterator[Condition]:
    """All that is wrong."""
    yield from _no_decision(now)
    yield from _grid_contradicted(now)
    yield from _grid_lost(now)
    yield from _off_with_grid(now)
    yield from _lines_out(now)
    yield from _switching_stopped(now)
    yield from _one_former_left(now)
    yield from _shed(now)
    yield from _critical_off(now)
    yield from _switch_proposed(now)
    yield from _longest_off(now)
    yield from _island_margin(now)
    yield from _fallback(now)
    yield from _source_lost(now)
    yield from _setpoint_rejected(now)
    yield from _notices_undelivered(now)


def _no_decision(now: Situation) -> Iterator[Condition]:
    """There is no plan for now, or none that knows what has changed."""
    plan = now.plan
    text = ""
    grid = plan.get("grid") or {"available": True}
    left = "devices use default set-points"
    if not grid["available"]:
        left = "devices keep their last state, and how long the island lasts is not known"
    if not plan or now.ahead_s <= 0.0:
        ends = max((one["valid_until"] for one in plan.get("setpoints", ())), default=None)
        if ends and now.now < pd.Timestamp(ends):
            left = f"set-points hold until {now.clock(ends)}, then {left}"
        text = f"There is no plan for the present step: {left}."
    elif plan["status"] == "failed":
        text = f"The present step could not be planned: {plan['reason']}."
    elif plan["status"] == "missed":
        text = f"The present step was missed: {plan['reason']}; {left}."
    elif now.unaware_of:
        text = f"The plan does not know yet: {'; '.join(now.unaware_of)}."
    if text:
        yield Condition("no_decision", "", HIGH, text)


def _grid_contradicted(now: Situation) -> Iterator[Condition]:
    """The plan ignores a reading that the grid is lost, and that is still the last one."""
    for words in now.plan.get("estimated", ()):
        if words.startswith("grid_on ") and now.grid_on == 0.0:
            yield Condition("grid_contradicted", "", HIGH, f"The plan ignores a reading: {words}.")


def _is_lost(now: Situation) -> bool:
    """Whether the grid is lost by a reading that counts."""
    if now.grid_on != 0.0 or any(_grid_contradicted(now)):
        return False
    grid = now.plan.get("grid")
    if not grid or not grid["available"]:
        return True
    return any(words.startswith(GRID_LOST) for words in now.unaware_of)


def _grid_lost(now: Situation) -> Iterator[Condition]:
    """There is no grid, by a reading."""
    if not _is_lost(now):
        return
    if now.announced:
        words = "as announced"
        yield Condition("grid_lost", "", MEDIUM, f"The grid is lost, by {now.read_by}, {words}.")
    else:
        words = "No outage is announced for now"
        yield Condition("grid_lost", "", HIGH, f"The grid is lost, by {now.read_by}. {words}.")


def _off_with_grid(now: Situation) -> Iterator[Condition]:
    """Customers are off although there is grid, and they or a switch could be switched on."""
    plan = now.plan
    if not plan or now.ahead_s <= 0.0 or now.is_dark or _is_lost(now):
        return
    if not plan.get("grid") and now.grid_on != 1.0:
        return  # as by hand: not known
    cut_off = {name for _, behind in now.behind_faults for name in behind}
    behind = behind_open(plan, now.scenario) - cut_off
    off = sorted(now.off - set(now.failing) - cut_off)
    ordered_on = sorted(behind - now.off) if plan["status"] in UNPLANNED else []
    if not off and not ordered_on:
        return
    apart = sorted(behind.intersection(off))
    fed = sorted({*off} - {*apart})
    words = []
    if fed:
        words.append(f"{named(fed, NAMES_SHOWN)} off supply, and there is grid")
        limit_kw = expected_by(plan).get("grid_limit_kw")
        if limit_kw is not None:
            words[-1] += f" of at most {limit_kw:g} kW"
        if plan["status"] in BY_HAND:
            words[-1] += f", by the operator's mode {plan['status']}"
    if apart:
        why = now.blacked_out(apart) or "too little power or energy behind open switches"
        words.append(f"{named(apart, NAMES_SHOWN)} off supply: {why}")
    if ordered_on:
        words.append(_not_planned(ordered_on, "open switches", plan))
    told = (*off, *ordered_on)
    priority = HIGH if now.critical.intersection(told) else MEDIUM
    yield Condition("off_with_grid", "", priority, f"{'; '.join(words)}.", told)


def _not_planned(customers: Sequence[str], what: str, plan: Mapping[str, Any]) -> str:
    """Customers behind something that an operator's mode orders on, with a grid or without."""
    names = named(customers, NAMES_SHOWN)
    return f"{names} behind {what}, whose supply is not planned in the mode {plan['status']}"


def _lines_out(now: Situation) -> Iterator[Condition]:
    """Lines and buses that are out of service, and the customers behind that are off."""
    for one, behind in now.behind_faults:
        unplanned = now.plan["status"] in UNPLANNED
        cut = sorted(behind if unplanned else now.off & behind)
        name, end = one["name"], one["end"]
        begins = pd.Timestamp(one["start"])
        when = "is out of service"
        if begins > now.now:  # the whole step is planned without it
            when = f"will be out of service from {now.clock(begins)}"
        words = f"{name[0].upper()}{name[1:]} {when}"
        words += f" until {now.clock(end)}" if end else ", and its end is not known"
        if unplanned and cut:
            words += f"; {_not_planned(cut, 'it', now.plan)}"
        elif cut:
            why = now.blacked_out(cut) or "too little power or energy behind it"
            words += f"; {named(cut, NAMES_SHOWN)} off supply: {why}"
        priority = HIGH if now.critical.intersection(cut) else MEDIUM
        yield Condition("line_out", name, priority, f"{words}.", tuple(cut))


def _switch_proposed(now: Situation) -> Iterator[Condition]:
    """Switches that the plan proposes to move."""
    proposed = now.plan.get(PROPOSED, {})
    if proposed.get("closed") and now.ahead_s > 0.0:
        why = proposed["why"]
        words = f"{why[0].upper()}{why[1:]}; it waits for an operator."
        yield Condition("switch_proposed", "", HIGH if now.critical & now.off else MEDIUM, words)


def _switching_stopped(now: Situation) -> Iterator[Condition]:
    """An order of switching goes no further."""
    if now.switching_stopped:
        words = f"The order of switching is stopped: {now.switching_stopped}"
        yield Condition("switching_stopped", "", MEDIUM, words)


def _shed(now: Situation) -> Iterator[Condition]:
    """Customers that the plan served and its island cannot hold."""
    shed = [one["asset"] for one in now.plan.get("shed", ())]
    if not shed or now.ahead_s <= 0.0:
        return
    (why, *_) = [one["reason"] for one in now.plan["shed"]]
    priority = HIGH if now.critical.intersection(shed) else MEDIUM
    them = "it" if len(shed) == 1 else "them"
    words = f"{named(shed, NAMES_SHOWN)} shed, although the plan supplied {them}: {why}."
    yield Condition("shed", "", priority, words, tuple(sorted(shed)))


def _one_former_left(now: Situation) -> Iterator[Condition]:
    """Of the devices that can form the grid of an island one is left, or none."""
    able = [one.asset for one in now.formers or () if not one.why_not]
    missing = [one for one in now.formers or () if one.why_not]
    if not now.plan or not missing or len(able) > 1:
        return
    others = named([f"{one.asset} ({one.why_not})" for one in missing], NAMES_SHOWN)
    priority = HIGH if now.is_dark else MEDIUM
    if able:
        words = f"Only {able[0]} can form the grid of an island; not {others}."
    else:
        words = f"Nothing can form the grid of an island: not {others}."
    yield Condition("one_former_left", "", priority, words, tuple(one.asset for one in missing))


def _critical_off(now: Situation) -> Iterator[Condition]:
    """Customers of the first tier are off, or will be; and whether that rests on old readings."""
    if not now.plan:
        return
    able = now.critical - set(now.failing)
    off = sorted(now.off & able)
    late = _late_batteries(now)
    if off:
        words = f"{named(off, NAMES_SHOWN)} of the first tier off supply"
        if now.why_dark:
            words += f": {now.why_dark}"
        elif dark := now.blacked_out(off):
            words += f": {dark}"
        elif late:
            words += f", and the state of charge of {named(late, NAMES_SHOWN)} is late"
        yield Condition("critical_off", "", HIGH, f"{words}.", tuple(off))
        return
    ahead = now.plan.get("ahead") or {"times": [], "served": {}}
    for t, text in enumerate(ahead["times"]):
        time = pd.Timestamp(text)
        later = [name for name in able if not ahead["served"].get(name, [True] * (t + 1))[t]]
        if now.now < time <= now.now + AHEAD and later:
            priority = HIGH if time <= now.now + SOON else MEDIUM
            names = named(sorted(later), NAMES_SHOWN)
            words = f"Planned: {names} of the first tier off supply at {now.clock(time)}."
            yield Condition("critical_off", "", priority, words, tuple(sorted(later)), time)
            return


def _longest_off(now: Situation) -> Iterator[Condition]:
    """Customers are off for longer than they may be, or will be if the next step leaves them off.

    One that the plan restores in the next step needs no operator.
    """
    plan = now.plan
    if not plan:
        return
    limit_h = limits_h(now.scenario)
    dt_h = now.scenario.grid.dt_h
    back = {
        name for name, on in ((plan.get("ahead") or {}).get("served", {})).items() if any(on[:1])
    }
    until = now.clock(pd.Timestamp(plan["start"]) + now.scenario.grid.step)
    for name, off_h in plan.get("off_h", {}).items():
        if name not in now.off:
            continue
        words = f"{name} is off, for {off_h:g} h by {until}"
        left = steps_within(limit_h[name] - off_h, dt_h)
        if left < 0:
            words = f"{words}, longer than its {limit_h[name]:g} h."
            yield Condition("longest_off", name, HIGH, words)
        elif left == 0 and name not in back:
            words = f"{words}, of {limit_h[name]:g} h, and not planned to be on in the next one."
            yield Condition("longest_off", name, MEDIUM, words)


def _late_batteries(now: Situation) -> list[str]:
    """Batteries whose state of charge was late when the plan was made, and still is."""
    heard = {one["asset"]: one["state"] for one in now.heard if one["quantity"] == "soc"}
    plan = now.plan or {}
    then = {one["asset"] for one in plan.get("late", ()) if one["quantity"] == "soc"}
    names = [str(name) for name in now.scenario.batteries.id]
    return [one for one in names if one not in heard or (heard[one] != "ok" and one in then)]


def _island_margin(now: Situation) -> Iterator[Condition]:
    """Alarm that the energy stored for an island is nearly used up."""
    if not now.is_dark:
        return
    b = now.scenario.batteries
    usable_kwh = left_kwh = 0.0
    for i, name in enumerate(b.id):
        soc = now.soc.get(str(name))
        if soc is not None:
            usable_kwh += float(b.energy_kwh[i] * (b.soc_max[i] - b.soc_min[i]))
            left_kwh += float(b.energy_kwh[i] * max(soc - b.soc_min[i], 0.0))
    for kind in every().values():
        full_kwh, held_kwh = kind.held_kwh(now.scenario, now.plan)
        usable_kwh += full_kwh
        left_kwh += held_kwh
    if left_kwh < LEAST_MARGIN * usable_kwh:
        words = f"Less than {LEAST_MARGIN:.0%} of the usable energy is left, and there is no grid."
        yield Condition("island_margin", "", MEDIUM, words)


def _fallback(now: Situation) -> Iterator[Condition]:
    """Fallbacks decide."""
    if now.plan.get("status") == "fallback" and now.ahead_s > 0.0:
        solve = now.plan["solve"]
        kind = str(solve["fallback"]).replace("_", " ")
        words = f"Steps are decided by a fallback ({kind}): {solve['fallback_reason']}."
        yield Condition("fallback", "", MEDIUM, words)


def _source_lost(now: Situation) -> Iterator[Condition]:
    """Sources are silent."""
    if not now.heard:
        yield Condition("source_lost", "", MEDIUM, "No source has sent a reading.")
    by_source: dict[str, list[str]] = {}
    for one in now.heard:
        if one["state"] == "lost":
            words = f"{one['quantity']} of {one['asset']}"
            by_source.setdefault(one["source"], []).append(words)
    for source, names in by_source.items():
        yield Condition(
            "source_lost", source, MEDIUM, f"No data from {source}: {named(names, NAMES_SHOWN)}."
        )


def _setpoint_rejected(now: Situation) -> Iterator[Condition]:
    """A device does not follow its set-point, or the last check lets nothing through to it."""
    failing = {**now.rejected, **now.failing}
    found = {name: f"{name} did not follow its set-point: {why}." for name, why in failing.items()}
    if now.ahead_s > 0.0:
        for one in refused_of(now.plan):
            words = f"The last check rejected the set-point of {one['asset']}: {one['reason']}."
            found.setdefault(one["asset"], f"{words} The default was sent.")
    for name, text in found.items():
        yield Condition("setpoint_rejected", name, HIGH if name in now.critical else MEDIUM, text)


def _notices_undelivered(now: Situation) -> Iterator[Condition]:
    """People get no notice of alarms."""
    for name in now.unreached:
        text = f"The last notice of an alarm did not reach {name}."
        yield Condition("notices_undelivered", name, MEDIUM, text)
