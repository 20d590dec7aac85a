"""Readings, and ends of modes and events, between two steps."""

from __future__ import annotations

import threading
from collections.abc import Iterable

import numpy as np
import pandas as pd

from vppres.kinds.kind import EARLY_SHARE
from vppres.service.events.announced import certain_interval
from vppres.service.operation.site import MODE, OperatedSite
from vppres.service.storage.records import Reading, Written, seconds
from vppres.service.telemetry.grid_readings import (
    GRID_ON,
    IMPORT,
    contradiction,
    lost_now,
    stands_alone,
)
from vppres.service.telemetry.knowledge import INSTANT
from vppres.service.telemetry.news import AGAINST_PLANS, News, is_said_lost, newest, unknown_to
from vppres.service.telemetry.refused import RefusedReadings


class Hearing:
    """Keeps readings of a site, and notes what its present plan does not know."""

    def __init__(self, site: OperatedSite) -> None:
        self.site = site
        self.refused = RefusedReadings(site.length)
        self._news = News(site.store, site.scenario)
        self._fresh: dict[tuple[str, str], Reading] = {}
        self._turn = threading.Lock()

    def hear(self, readings: list[Reading], now: pd.Timestamp, actor: str) -> Written:
        """Keep readings, and note what the present plan does not know of them."""
        site = self.site
        until = now + EARLY_SHARE * site.length
        new = self._news.of(readings, until, site.last or {})
        kept = site.store.write_readings(readings, now, actor)
        told = newest(readings)
        with self._turn:
            self._fresh |= told
        if site.last:
            self._compare(told.values(), until)
            imports = any(one.quantity == IMPORT and abs(one.value) > 0.0 for one in readings)
            if imports and is_said_lost(site.last) and self._fed():
                new.append("import although the grid was said to be lost")
            for words in new:
                site.changes.note(words)
        return kept

    def begin_plan(self) -> None:
        """A plan is begun: what comes from now on it may not know."""
        with self._turn:
            self._fresh = {}

    def end_plan(self) -> None:
        """The plan is the last one: it is compared with what came while it was made."""
        with self._turn:
            told = [*self._fresh.values()]
        self._compare(told, self.site.until)

    def _compare(self, told: Iterable[Reading], until: pd.Timestamp) -> None:
        """Note what readings say against the plan, as far as they are the last ones."""
        said = [one for one in told if one.quantity in AGAINST_PLANS]
        kinds = {one.quantity for one in said}
        last = self.site.store.latest(until, kinds) if kinds else []
        for words in unknown_to(self.site.last, (one for one in last if one in said), self._fed):
            self.site.changes.note(words)

    def _fed(self) -> bool:
        """Whether something contradicts the last reading of the grid, that it is lost."""
        site, now = self.site, self.site.clock.now()
        zero = lost_now(now, site.length, site.store)
        demand_kw = float(site.profile_of(site.begun(now)).load_kw.sum())
        return contradiction(zero, now, site.length, site.store, demand_kw) != ""

    def asked_again(self, readings: Iterable[Reading]) -> list[str]:
        """Requests to send a reading again: a lost grid that no other reading confirms."""
        if not any(one.quantity == GRID_ON and one.value == 0.0 for one in readings):
            return []
        now, length, store = self.site.clock.now(), self.site.length, self.site.store
        words = stands_alone(lost_now(now, length, store), now, length, store)
        return [words] if words else []

    def look(self) -> None:
        """Note what has changed while the service did not run."""
        site = self.site
        if not site.last:
            return
        until = site.until
        latest = site.store.latest(until, INSTANT)
        self._compare(latest, until)
        since = seconds(pd.Timestamp(site.last["generated_at"]))
        if any(one.time > since for one in latest):
            site.changes.note("the service has started again")
        for name, event in site.store.events().items():
            if event.made_at > since:
                site.changes.note(f"event {name}")

    def note_turns(self) -> None:
        """Note what has begun or ended since the plan of the present step was made."""
        site = self.site
        if not site.last or site.rehearsal:
            return
        since, now = pd.Timestamp(site.last["generated_at"]), site.clock.now()
        for what, time in self._turns():
            if since < time <= now:
                site.changes.note(what)

    def to_next_turn_s(self) -> float:
        """How long until something begins or ends otherwise than in the present plan, in s."""
        now = self.site.clock.now()
        left = [(time - now).total_seconds() for _, time in self._turns() if time > now]
        return float(min(left, default=np.inf))

    def _turns(self) -> list[tuple[str, pd.Timestamp]]:
        """When the mode and events end, and outages begin in a step that is planned with grid."""
        asked, _ = self.site.store.setting(MODE)
        events = self.site.store.events()
        times = {f"event {name} ended": one.body.get("end") for name, one in events.items()}
        if asked:
            times[f"mode {asked['mode']} ended"] = asked["until"]
        if (self.site.last.get("grid") or {}).get("available"):
            certain = {name: certain_interval(one.said) for name, one in events.items()}
            times |= {f"event {name} began": one[0] for name, one in certain.items() if one}
        return [(what, pd.Timestamp(time)) for what, time in times.items() if time]
