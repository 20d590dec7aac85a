"""Statements of several lines, and how rows are written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from vppres.core.plain import json_safe
from vppres.scenario.history import History
from vppres.service.storage.records import AlarmRow, ChangedError, Event, seconds
from vppres.service.storage.tables import (
    ALARMS,
    AUDIT,
    EVENTS,
    HEARD_OF,
    MEASURED,
    OUTCOMES,
    TELEMETRY,
)

REJECTED = "rejected"
REFUSED = (REJECTED, "aborted")
"""What devices say that did not follow their set-points."""


def last_readings(until: int, quantities: Iterable[str], known: bool = False) -> Any:
    """The last readings of each asset and quantity up to a time; of those ``known``, if asked."""
    named = HEARD_OF
    t = TELEMETRY.c
    earlier = TELEMETRY.alias("earlier")
    last = (
        sa.select(sa.func.max(earlier.c.time))
        .where(
            earlier.c.asset == named.c.asset,
            earlier.c.quantity == named.c.quantity,
            earlier.c.time <= until,
            *((earlier.c.value.is_not(None),) if known else ()),
        )
        .scalar_subquery()
    )
    same = sa.and_(t.asset == named.c.asset, t.quantity == named.c.quantity, t.time == last)
    if known:
        same = sa.and_(same, t.value.is_not(None))
    chosen = sa.select(TELEMETRY).select_from(named.join(TELEMETRY, same))
    chosen = chosen.where(named.c.quantity.in_(list(quantities)))
    return chosen.order_by(t.asset, t.quantity, t.source.desc())


def put(db: sa.Connection, table: sa.Table, **row: Any) -> None:
    """Insert a row, or replace the one with its key."""
    key = (column == row[column.name] for column in table.primary_key.columns)
    db.execute(table.delete().where(*key))
    db.execute(table.insert().values(**row))


def put_event(
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
    if replacing is not None and not (before and holds and before.version == replacing):
        raise ChangedError(f"The event has another version than {replacing}.")
    if not (body or holds):
        raise ChangedError("The event was withdrawn before.")
    version = before.version + 1 if before else 1
    at = seconds(now)
    text = as_text(body) if body else None
    db.execute(EVENTS.insert().values(id=identifier, version=version, made_at=at, body=text))
    return Event(version, dict(body), at, at, new=not holds)


def as_text(body: Mapping[str, Any]) -> str:
    """A body as it is stored."""
    return json.dumps(body, sort_keys=True)


def put_measured(db: sa.Connection, measured: History) -> None:
    """Keep the steps in which anything was measured."""
    both = measured.load_kw, measured.pv_kw
    for t in np.flatnonzero(np.isfinite(np.hstack(both)).any(axis=1)).tolist():
        load_kw, pv_kw = (json.dumps(json_safe(kw[t].tolist())) for kw in both)
        time = seconds(measured.start + t * measured.step)
        put(db, MEASURED, time=time, load_kw=load_kw, pv_kw=pv_kw)


def note_refusal(
    db: sa.Connection, table: sa.Table, asset: str, said: Mapping[str, Any], at: int
) -> None:
    """A customer that could not be switched on, or dimmed, or was after all."""
    if said["status"] not in REFUSED:
        db.execute(table.delete().where(table.c.asset == asset))
        return
    put(db, table, asset=asset, at=at, reason=why_refused(said))


def why_refused(said: Mapping[str, Any]) -> str:
    """Refusal of a device in words."""
    return f"{said['status']}: {said['reason']}" if said["reason"] else str(said["status"])


def put_alarm(db: sa.Connection, row: AlarmRow) -> AlarmRow:
    """Add an alarm, or change one that has a number; as it is kept."""
    values = {**vars(row), "items": json.dumps(row.items)}
    number = values.pop("number")
    if number:
        db.execute(ALARMS.update().where(ALARMS.c.number == number).values(**values))
        return row
    key = db.execute(ALARMS.insert().values(**values)).inserted_primary_key
    return replace(row, number=int(key[0]))


def alarm_of(row: Any) -> AlarmRow:
    """An alarm from its row."""
    values = row._asdict()
    return AlarmRow(**{**values, "items": tuple(json.loads(values["items"]))})


def tag_of(text: str | None) -> str:
    """Name of what a setting says."""
    return hashlib.sha256((text or "").encode()).hexdigest()[:16]


def count_steps(db: sa.Connection, outcome: str, more: int) -> None:
    """Count steps of an outcome."""
    o = OUTCOMES.c
    counted = db.execute(
        sa.update(OUTCOMES).where(o.outcome == outcome).values(steps=o.steps + more)
    )
    if not counted.rowcount:
        db.execute(OUTCOMES.insert().values(outcome=outcome, steps=more))


def upserting(db: sa.Connection, table: sa.Table, value: str) -> Any:
    """Insert rows, replacing those whose value is another one; others are not counted."""
    dialect = {"sqlite": sqlite, "postgresql": postgresql}[db.dialect.name]
    insert = dialect.insert(table)
    keys = [column.name for column in table.primary_key.columns]
    rest = [column.name for column in table.columns if column.name not in keys]
    return insert.on_conflict_do_update(
        index_elements=keys,
        set_={name: insert.excluded[name] for name in rest},
        where=table.c[value].is_distinct_from(insert.excluded[value]),
    )


def note(db: sa.Connection, now: pd.Timestamp, actor: str, action: str, detail: str) -> None:
    """Add to the audit, of which nothing is ever changed."""
    db.execute(AUDIT.insert().values(at=seconds(now), actor=actor, action=action, detail=detail))
