"""Data of the page, in two answers: the site, and its present state."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterable, Mapping
from typing import Any, get_args

import numpy as np
import pandas as pd

from vppres.core.plain import json_safe
from vppres.kinds.customer.data import limits_h
from vppres.kinds.table import KINDS, parts
from vppres.live.by_phase import GRID
from vppres.scenario.phases import PHASES
from vppres.scenario.remarks import former_words
from vppres.service.clock import written
from vppres.service.events.announced import believes
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import MODE, Service
from vppres.service.operation.switching import SWITCHING
from vppres.service.payloads import ModeRequest
from vppres.service.plans.document import DARK, points_at, refused_of
from vppres.service.replay.export import off_minutes
from vppres.service.storage.records import Reading, moment
from vppres.service.telemetry.knowledge import MEAN, Latest, last_heard
from vppres.service.telemetry.phased_readings import stored

PAST_H = 12.0
"""How much of the past is shown."""

MOST_PAST = 96
"""Steps of it at most."""

MOST_HISTORY = 1_000
"""Steps of an answer, the last ones: ten days of quarter hours, read in a second or so."""

ROUNDING = 1e-6
"""Minutes that are none."""

NOT_TOLD = ("setpoints", "ahead", "before")

LIVE = parts("live")
SHOWN = ("soc", "online", "grid_on", *(name for live in LIVE.values() for name in live.SHOWN))
"""Last readings that the page shows."""

FIGURES = {
    "pv": ("p_max_kw",),
    "batteries": ("energy_kwh", "p_max_kw", "soc_min", "soc_max"),
    **{kind: live.FIGURES for kind, live in LIVE.items()},
}
"""What is shown of the devices of each kind."""

ORDERED = ("batteries", *KINDS)
"""Kinds of which the page shows what each device is to do."""

REFRESH_S = 1
"""For how long the same is shown, if nothing was changed."""


def site_of(runner: Runner) -> dict[str, Any]:
    """Constant data of the site: names, limits, ratings and modes."""
    day = runner.scenario
    return {
        "name": day.name,
        "title": day.title,
        "time_zone": day.grid.zone,
        "step_s": round(day.grid.step_minutes * 60),
        "played": runner.played,
        "believes": believes(runner.options),
        "modes": list(get_args(ModeRequest.model_fields["mode"].annotation)),
        "tiers": list(day.tiers),
        "former": former_words(day, runner.options.mode, always=True),
        "v_min_pu": day.network.v_min_ac_pu,
        "v_max_pu": day.network.v_max_ac_pu,
        "phases": _phases_of(runner),
        "lines": {
            str(bus): f"{day.network.from_bus[line]}-{bus}"
            for line, bus in enumerate(day.network.to_bus)
        },
        "customers": {
            str(name): str(tier)
            for name, tier in zip(day.customers.id, day.customers.tier, strict=True)
        },
        "dimmable": {
            str(name): float(day.customers.least_share[i])
            for i, name in enumerate(day.customers.id)
            if day.customers.dimmable[i]
        },
        **{kind: _figures(getattr(day, kind), names) for kind, names in FIGURES.items()},
    }


def _figures(devices: Any, names: Iterable[str]) -> dict[str, dict[str, float]]:
    columns = {name: getattr(devices, name).tolist() for name in names}
    return {
        str(device): {name: values[i] for name, values in columns.items()}
        for i, device in enumerate(devices.id)
    }


def _phases_of(runner: Runner) -> dict[str, str] | None:
    """On which phases devices are; None for a feeder without phases."""
    phases = runner.scenario.phases
    kinds = (getattr(runner.scenario, kind) for kind in ("customers", "pv", "batteries"))
    names = (str(name) for kind in kinds for name in kind.id)
    return {name: phases.connection(name).coils for name in names} if phases else None


def _orders(points: Iterable[Mapping[str, Any]], kind: str) -> dict[str, Any]:
    """Set-points of devices of a kind, with their reasons."""
    return {
        one["asset"]: {name: one[name] for name in (*one["default"], "reason")}
        for one in points
        if one["kind"] == kind
    }


def _in_the_dark(point: Mapping[str, Any], why: str) -> dict[str, Any]:
    """A set-point as it is where nothing forms the grid: nothing flows."""
    if point["kind"] == "customers":
        return {**point, "served": False, "reason": f"{DARK}{why}"}
    powers = {name: 0.0 for name in ("p_kw", "q_kvar") if name in point}
    return {**point, **powers}


class Overview:
    """How a service is, made once for all who ask."""

    def __init__(self, runner: Runner) -> None:
        self.runner = runner
        self.site = site_of(runner)
        self._tiers = self.site["customers"]
        self._longest_off_h = limits_h(runner.scenario)
        self._turn = threading.Lock()
        self._past: dict[str, dict[str, Any]] = {}
        self._made: tuple[Any, Any, bytes] = (None, None, b"")

    def fresh(self) -> bytes | None:
        """Stored answer, if nothing has changed since; a newer second may just be made.

        An operator who has changed something never sees the state before.
        """
        what, second, content = self._made
        same = what == self._what() and (second == self._second() or self._turn.locked())
        return content if content and same else None

    def text(self) -> bytes:
        """The overview as JSON; the same for a second, if there are only readings that are new."""
        with self._turn:
            what, second = self._what(), self._second()
            if self._made[:2] != (what, second):
                content = json.dumps(self._now(), allow_nan=False, separators=(",", ":"))
                self._made = (what, second, content.encode())
            return self._made[2]

    def history(self, since: pd.Timestamp, until: pd.Timestamp) -> list[dict[str, Any]]:
        """Steps that are kept, in a few numbers each, from a time on and before another one."""
        begin = max(since, until - MOST_HISTORY * self.runner.length)
        return [self._summary(plan) for plan in self.runner.store.plans(begin, until)]

    def _what(self) -> Any:
        """Counts of what was stored and noted so far."""
        runner = self.runner
        return runner.store.changes, runner.hearing.refused.changes, runner.changes.reasons

    def _second(self) -> pd.Timestamp:
        return self.runner.clock.now().floor(f"{REFRESH_S}s")

    def _now(self) -> dict[str, Any]:
        runner = self.runner
        now = runner.clock.now()
        plan = runner.last
        latest = Latest.at(now, runner.scenario, runner.store)
        found = runner.watch.situation(now)
        return {
            "now": written(now.floor("s")),
            "mode": {**runner.mode, "etag": f'"{runner.store.setting(MODE)[1]}"'},
            "ahead_s": runner.ahead_s if plan else None,
            "steps": runner.outcomes,
            "alarms": runner.watch.alarms.listed(now),
            "switching": self._switching() if runner.watch.is_switching else None,
            "events": {name: event.body for name, event in runner.store.events().items()},
            "sources": self._sources(latest.heard, now),
            "measured": self._measured(latest.found, now),
            "soc": found.soc,
            "formers": [vars(one) for one in found.formers or ()],
            "plan": self._told(plan, now, found.why_dark) if plan else None,
            "past": self._recent(now),
        }

    def _switching(self) -> dict[str, Any]:
        """The order of switching, with the ETag of the state that is shown."""
        asked, tag = self.runner.store.setting(SWITCHING)
        return {**self.runner.watch.switchgear(asked).told(), "etag": f'"{tag}"'}

    def _told(self, plan: Mapping[str, Any], now: pd.Timestamp, dark: str) -> dict[str, Any]:
        """Valid part of the last plan, without the customers that are on.

        Where an island is ``dark``, whatever was ordered, no customer is.
        """
        points = points_at(plan, now)
        if dark:
            points = [_in_the_dark(one, dark) for one in points]
        ahead = plan.get("ahead") or {}
        return {
            **{key: value for key, value in plan.items() if key not in NOT_TOLD},
            "unaware_of": list(self.runner.changes.reasons),
            "valid_until": max((one["valid_until"] for one in points), default=None),
            "dark": dark or None,
            "active": any(one["active"] for one in points),
            **{kind: _orders(points, kind) for kind in ORDERED},
            "off": self._off(points, ahead, plan.get("off_h", {})),
            "dimmed": {
                one["asset"]: one["share"]
                for one in points
                if one.get("served") and one.get("share", 1.0) < 1.0
            },
            "ahead": {**ahead, "served": self._shares(ahead)} if ahead else None,
        }

    def _off(
        self,
        points: Iterable[Mapping[str, Any]],
        ahead: Mapping[str, Any],
        off_h: Mapping[str, float],
    ) -> list[dict[str, Any]]:
        """Customers that are off: reason, share of the longest time off, next planned supply."""
        found = []
        for one in points:
            if one["kind"] != "customers" or one["served"]:
                continue
            served = ahead["served"].get(one["asset"], ()) if ahead else ()
            back = (time for time, on in zip(ahead.get("times", ()), served, strict=False) if on)
            found.append(
                {
                    "asset": one["asset"],
                    "tier": self._tiers.get(one["asset"]),
                    "reason": one["reason"],
                    "until": next(back, None),
                    "off_h": off_h.get(one["asset"]),
                    "longest_off_h": self._longest_off_h.get(one["asset"]),
                }
            )
        return found

    def _shares(self, ahead: Mapping[str, Any]) -> dict[str, list[float]]:
        """Share of each tier's customers that is meant to be on, by step."""
        return {
            tier: np.mean([ahead["served"][name] for name in names], axis=0).tolist()
            for tier, names in self._by_tier().items()
        }

    def _by_tier(self) -> dict[str, list[str]]:
        tiers: dict[str, list[str]] = {}
        for name, tier in self._tiers.items():
            tiers.setdefault(tier, []).append(name)
        return tiers

    def _sources(
        self, heard: Iterable[Mapping[str, Any]], now: pd.Timestamp
    ) -> list[dict[str, Any]]:
        """Each source: when it was last heard from, and what of it is late or was refused."""
        refused = [*self.runner.hearing.refused.standing(now)]
        contacts = {one.source: written(at) for one, at in refused} | last_heard(self.runner.store)
        found: dict[str, dict[str, Any]] = {
            source: {
                "source": source,
                "last_contact": contact,
                "stale": [],
                "lost": [],
                "refused": [],
                "ok": 0,
            }
            for source, contact in contacts.items()
        }
        for one, _ in refused:
            found[one.source]["refused"].append(one.words)
        for reading in heard:
            source = found[reading["source"]]
            if reading["state"] == "ok":
                source["ok"] += 1
            else:
                source[reading["state"]].append(f"{reading['quantity']} of {reading['asset']}")
        return list(found.values())

    def _measured(self, readings: Iterable[Reading], now: pd.Timestamp) -> dict[str, Any]:
        """The last readings of devices and of the import."""
        begun = self.runner.begun(now) - self.runner.length
        found = [one for one in readings if one.quantity in SHOWN]
        means = self.runner.store.between(begun, now, MEAN)
        found += [one for one in means if one.asset == GRID]
        found += self.runner.store.between(begun, now, [stored("source_kva", p) for p in PHASES])
        return {
            f"{one.quantity} {one.asset}": {
                "value": json_safe(one.value),
                "at": written(moment(one.time)),
                "source": one.source,
            }
            for one in found
        }

    def _recent(self, now: pd.Timestamp) -> list[dict[str, Any]]:
        """The last hours, step by step; each plan is read once."""
        length = self.runner.length
        n_steps = min(MOST_PAST, math.ceil(pd.Timedelta(hours=PAST_H) / length))
        last = self.runner.last
        if not last:
            return []
        begin = pd.Timestamp(last["start"]) - (n_steps - 1) * length
        times = [written(begin + t * length) for t in range(n_steps)]
        known = self._past
        # The last one may have been decided anew.
        missing = [time for time in times if time not in known or time == times[-1]]
        new = self.runner.store.plans(pd.Timestamp(missing[0])) if missing else []
        fresh = {plan["start"]: self._summary(plan) for plan in new}
        self._past = {
            time: found for time in times if (found := fresh.get(time) or known.get(time))
        }
        return list(self._past.values())

    def _summary(self, plan: Mapping[str, Any]) -> dict[str, Any]:
        """A step in a few numbers; supply counts by the parts of one that was decided anew."""
        solve = plan["solve"] or {}
        runner = self.runner
        service = Service(runner.scenario, runner.options)
        off_min, minutes = off_minutes(service, runner.store, plan, runner.clock.now())
        return {
            "start": plan["start"],
            "status": plan["status"],
            "reason": plan.get("reason") or solve.get("fallback_reason"),
            "anew": plan.get("anew"),
            "fallback": solve.get("fallback"),
            "refused": refused_of(plan),
            "served": {
                tier: 1.0 - sum(off_min.get(name, 0.0) for name in names) / minutes / len(names)
                for tier, names in self._by_tier().items()
            },
            # Who was off all the time is in the shares.
            "off_min": {name: each for name, each in off_min.items() if each < minutes - ROUNDING},
            "expected": plan["expected"],
        }
