"""Versions of what is announced, and forecasts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pandas as pd
import sqlalchemy as sa

from vppres.service.payloads import Forecasts
from vppres.service.storage.records import ChangedError, Event, seconds
from vppres.service.storage.tables import EVENTS, FORECASTS, WRITTEN, note, put
from vppres.service.storage.transactions import Transactions


class StoredEvents(Transactions):
    """Events and forecasts of a site."""

    _events_known: tuple[int, dict[str, list[Event]]] = (-1, {})
    _event_changes = 0

    def put_events(
        self,
        bodies: Mapping[str, dict[str, Any]],
        now: pd.Timestamp,
        actor: str,
        replacing: int | None = None,
    ) -> dict[str, Event]:
        """Keep versions of events, all or none of them; these versions. A body of None withdraws.

        If it is given, ``replacing`` is the version that each still must have.

        Raises
        ------
        ChangedError
            If an event has another version, or there is none to be withdrawn.
        """
        with self._changes() as db:
            found = {
                name: _put_event(db, name, body, now, replacing) for name, body in bodies.items()
            }
            for name, body in bodies.items():
                action = "event" if body else "event withdrawn"
                text = json.dumps(body, sort_keys=True) if body else ""
                note(db, now, actor, action, f"{name} {text}")
        self._event_changes += 1
        return found

    def events(self) -> dict[str, Event]:
        """The latest version of each event that holds, in the order in which they were written."""
        return {name: each[-1] for name, each in self.events_ever().items() if each[-1].body}

    def events_ever(self) -> dict[str, list[Event]]:
        """All versions of every event that are kept, in their order; without body if withdrawn.

        The event that was written last comes last.
        """
        # Nothing else writes here, so that what was read holds until an event changes.
        seen = self._event_changes
        if self._events_known[0] != seen or self._reading:
            found: dict[str, list[Event]] = {}
            e, w = EVENTS.c, WRITTEN.c
            both = sa.and_(e.id == w.id, e.version == w.version)
            chosen = sa.select(EVENTS).outerjoin(WRITTEN, both)
            number = sa.func.coalesce(w.number, 0)  # of a database that did not count them
            for row in self._rows(chosen.order_by(number, e.made_at, e.id, e.version)):
                earlier = found[row.id] = found.pop(row.id, [])
                goes_on = earlier and earlier[-1].body
                since = earlier[-1].since if goes_on else row.made_at
                earlier.append(Event(row.version, row.body or {}, row.made_at, since))
            self._events_known = seen, found
        return self._events_known[1]

    def put_forecast(
        self, quantity: str, body: dict[str, Any], now: pd.Timestamp, actor: str
    ) -> None:
        """Keep a forecast beside older ones; parts that were issued together are one."""
        key = {"quantity": quantity, "issued_at": seconds(pd.Timestamp(body["issued_at"]))}
        for before in self._values(sa.select(FORECASTS.c.body).filter_by(**key)):
            if all(before[name] == body[name] for name in ("start", "resolution")):
                body = {**body, "assets": before["assets"] | body["assets"]}
        with self._changes() as db:
            put(db, FORECASTS, **key, body=body)
            note(db, now, actor, "forecast", f"{quantity} {body['issued_at']}")

    def forecast(self, quantity: str, now: pd.Timestamp) -> Forecasts | None:
        """The forecast that was issued last, up to now."""
        f = FORECASTS.c
        issued = sa.select(f.body).where(f.quantity == quantity, f.issued_at <= seconds(now))
        found = self._values(issued.order_by(f.issued_at.desc()).limit(1))
        return Forecasts.model_validate(found[0]) if found else None


def _put_event(
    db: sa.Connection,
    identifier: str,
    body: Mapping[str, Any],
    now: pd.Timestamp,
    replacing: int | None,
) -> Event:
    """Add a version of an event, none to withdraw it.

    Raises
    ------
    ChangedError
        If it is to replace another version, or withdraws what does not hold.
    """
    newest = sa.select(EVENTS).where(EVENTS.c.id == identifier).order_by(EVENTS.c.version.desc())
    before = db.execute(newest.limit(1)).first()
    holds = before and before.body
    if replacing is not None and not (holds and before.version == replacing):
        raise ChangedError(f"The event has another version than {replacing}.")
    if not (body or holds):
        raise ChangedError("The event was withdrawn before.")
    version = before.version + 1 if before else 1
    at = seconds(now)
    db.execute(
        EVENTS.insert().values(id=identifier, version=version, made_at=at, body=body or None)
    )
    db.execute(WRITTEN.insert().values(id=identifier, version=version))
    return Event(version, dict(body), at, at, new=not holds)
