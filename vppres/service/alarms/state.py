"""Alarms: what an operator has to act on, from its rise to its end.

An alarm is raised when its condition has lasted for its delay. An operator acknowledges it, and it
is cleared when the condition has been gone for a time. A shelved alarm sends no notification up to
its end. What the conditions are: ``service/alarms/conditions.py``.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from vppres.service.alarms.conditions import KINDS, PRIORITIES
from vppres.service.clock import written
from vppres.service.storage.records import AlarmRow, Condition, moment, seconds
from vppres.service.storage.store import Store

REMINDER = pd.Timedelta(hours=2)
"""After which an alarm without an acknowledgement is notified again."""

SHOWN = pd.Timedelta(hours=24)
"""For how long an alarm that was cleared waits for its acknowledgement in the list."""

RAISED, REMINDER_OF, CLEARED = "raised", "reminder", "cleared"

STATES = ("raised", "acknowledged", "shelved", "cleared", "closed")
"""Those to be seen first come first."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Notice:
    """Something to tell people: alarms "raised" or "cleared", or a "reminder" of them."""

    what: str
    alarms: list[dict[str, Any]]


class Alarms:
    """The alarms of a site.

    Attributes
    ----------
    on_notice : callable
        Gets what is to be notified.
    """

    def __init__(self, store: Store) -> None:
        self.store = store
        self.on_notice: Callable[[Notice], None] = lambda _: None
        self._turn = threading.Lock()
        self._standing = {row.key: row for row in store.standing_alarms()}
        self._since: dict[tuple[str, str], pd.Timestamp] = {}
        self._gone: dict[tuple[str, str], pd.Timestamp] = {}
        self._told: dict[int, pd.Timestamp] = {}

    def look(self, conditions: Iterable[Condition], now: pd.Timestamp) -> None:
        """Raise, change and clear alarms."""
        present = {one.key: one for one in conditions}
        with self._turn:
            self._since = {key: self._since.get(key, now) for key in present}
            gone = [key for key in self._standing if key not in present]
            self._gone = {key: self._gone.get(key, now) for key in gone}
            before = self._standing
            new = [self._row(one, now) for key, one in present.items() if self._is_due(key, now)]
            still = [_updated(row, present[key]) for key, row in before.items() if key in present]
            changed = [row for row in still if row != before[row.key]]
            over = [
                replace(before[key], cleared_at=seconds(now))
                for key, since in self._gone.items()
                if now - since >= pd.Timedelta(minutes=KINDS[key[0]].gone_min)
            ]
            if new or changed or over:
                kept = self.store.write_alarms([*new, *changed, *over])
                rows = {**before, **{row.key: row for row in kept}}
                self._standing = {k: row for k, row in rows.items() if row.stands}
                loud = [row for row in kept if row.stands]
                worse = [row for row in loud if _is_worse(before.get(row.key), row)]
                self._notify(RAISED, worse, now)
                self._notify(CLEARED, over, now)
            self._notify(REMINDER_OF, self._forgotten(now), now)

    def acknowledge(
        self, number: int, actor: str, reason: str, now: pd.Timestamp
    ) -> dict[str, Any]:
        """Note that an operator has seen an alarm, cleared or not."""
        seen = {"acknowledged_at": seconds(now), "acknowledged_by": actor}
        return self._change(number, seen, now, actor, "alarm acknowledged", reason)

    def shelve(
        self, number: int, until: pd.Timestamp | None, actor: str, reason: str, now: pd.Timestamp
    ) -> dict[str, Any]:
        """Let an alarm send no notification up to a time; without a time it notifies again."""
        if not until:
            values: dict[str, Any] = {"shelved_until": None, "shelved_by": ""}
            return self._change(number, values, now, actor, "alarm unshelved", reason)
        values = {"shelved_until": seconds(until), "shelved_by": actor}
        words = f"until {written(until)} {reason}"
        return self._change(number, values, now, actor, "alarm shelved", words)

    def listed(self, now: pd.Timestamp, since: pd.Timestamp | None = None) -> list[dict[str, Any]]:
        """Alarms that stand or wait for an acknowledgement, those to be seen first first.

        With ``since`` also all that were cleared from then on.
        """
        found = [self._told_of(row, now) for row in self.store.alarms(since or now - SHOWN)]
        shown = [one for one in found if since or one["state"] != "closed"]
        return sorted(shown, key=_order)

    def _told_of(self, row: AlarmRow, now: pd.Timestamp) -> dict[str, Any]:
        """An alarm as answers have it, and since when its condition is gone if it still stands."""
        gone = self._gone.get(row.key)
        return {**told(row, now), "gone_since": written(gone) if gone else None}

    def _change(
        self,
        number: int,
        values: Mapping[str, Any],
        now: pd.Timestamp,
        actor: str,
        action: str,
        reason: str,
    ) -> dict[str, Any]:
        with self._turn:
            row = self.store.change_alarm(number, values, now, actor, action, reason)
            if row.key in self._standing and row.stands:
                self._standing[row.key] = row
            return self._told_of(row, now)

    def _is_due(self, key: tuple[str, str], now: pd.Timestamp) -> bool:
        """Whether a condition that is no alarm yet has lasted for its delay."""
        delay = pd.Timedelta(minutes=KINDS[key[0]].delay_min)
        return key not in self._standing and now - self._since[key] >= delay

    def _row(self, condition: Condition, now: pd.Timestamp) -> AlarmRow:
        """A new alarm; one that was shelved when it came last stays so."""
        new = AlarmRow(**vars(condition), raised_at=seconds(now))
        last = self.store.last_alarm(*condition.key)
        if last and (last.shelved_until or 0) > seconds(now):
            return replace(new, shelved_until=last.shelved_until, shelved_by=last.shelved_by)
        return new

    def _forgotten(self, now: pd.Timestamp) -> list[AlarmRow]:
        """Alarms without an acknowledgement for long since their last notification."""
        return [
            row
            for row in self._standing.values()
            if not row.acknowledged_at
            and now - self._told.setdefault(row.number, moment(row.raised_at)) >= REMINDER
        ]

    def _notify(self, what: str, rows: Sequence[AlarmRow], now: pd.Timestamp) -> None:
        """Tell people of alarms, unless they are shelved."""
        loud = [row for row in rows if (row.shelved_until or 0) <= seconds(now)]
        if not loud:
            return
        for row in loud:
            self._told[row.number] = now
            log.warning("%s: alarm %s: %s", written(now), what, row.text)
        self.on_notice(Notice(what, [self._told_of(row, now) for row in loud]))


def told(row: AlarmRow, now: pd.Timestamp) -> dict[str, Any]:
    """An alarm as answers have it."""
    return {
        "id": row.number,
        "kind": row.kind,
        "subject": row.subject or None,
        "priority": row.priority,
        "state": state_of(row, now),
        "text": row.text,
        "advice": KINDS[row.kind].advice,
        "due": _time(row.due_at),
        "raised_at": _time(row.raised_at),
        "acknowledged_at": _time(row.acknowledged_at),
        "acknowledged_by": row.acknowledged_by or None,
        "cleared_at": _time(row.cleared_at),
        "shelved_until": _time(row.shelved_until),
        "shelved_by": row.shelved_by or None,
    }


def state_of(row: AlarmRow, now: pd.Timestamp) -> str:
    """How an alarm stands; what was cleared and not acknowledged is not closed yet."""
    if not row.stands:
        return "closed" if row.acknowledged_at else "cleared"
    if (row.shelved_until or 0) > seconds(now):
        return "shelved"
    return "acknowledged" if row.acknowledged_at else "raised"


def _updated(row: AlarmRow, condition: Condition) -> AlarmRow:
    """A standing alarm as it is now; an acknowledgement lapses if it has become worse."""
    items = (*row.items, *sorted(set(condition.items) - set(row.items)))
    now = replace(row, **{**vars(condition), "items": items})
    return replace(now, acknowledged_at=None, acknowledged_by="") if _is_worse(row, now) else now


def _is_worse(before: AlarmRow | None, row: AlarmRow) -> bool:
    """Whether an alarm is new, more urgent, or about more than before."""
    if not before:
        return True
    more_urgent = PRIORITIES.index(row.priority) < PRIORITIES.index(before.priority)
    return more_urgent or len(row.items) > len(before.items)


def _order(alarm: Mapping[str, Any]) -> tuple[int, int, int]:
    return STATES.index(alarm["state"]), PRIORITIES.index(alarm["priority"]), -alarm["id"]


def _time(stored: int | None) -> str | None:
    return written(moment(stored)) if stored else None
