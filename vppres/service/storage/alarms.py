"""Alarms, from their rise to their end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import pandas as pd
import sqlalchemy as sa

from vppres.service.storage.records import AlarmRow, UnknownError, seconds
from vppres.service.storage.tables import ALARMS, note
from vppres.service.storage.transactions import Transactions


class StoredAlarms(Transactions):
    """Alarms of a site."""

    def write_alarms(self, rows: Iterable[AlarmRow]) -> list[AlarmRow]:
        """Keep alarms, new ones and changed ones; as they are kept, with their numbers."""
        with self._changes() as db:
            return [_put_alarm(db, row) for row in rows]

    def change_alarm(
        self,
        number: int,
        values: Mapping[str, Any],
        now: pd.Timestamp,
        actor: str,
        action: str,
        reason: str,
    ) -> AlarmRow:
        """Change what an operator may of an alarm, and note it.

        Raises
        ------
        UnknownError
            If there is no such alarm.
        """
        a = ALARMS.c
        with self._changes() as db:
            db.execute(ALARMS.update().where(a.number == number).values(**values))
            row = db.execute(sa.select(ALARMS).where(a.number == number)).first()
            if not row:
                raise UnknownError("There is no such alarm.")
            note(db, now, actor, action, f"{number} {row.kind} {row.subject} {reason}".strip())
        return _alarm(row)

    def alarms(self, since: pd.Timestamp) -> list[AlarmRow]:
        """Alarms that stand, and those that were cleared since a time."""
        cleared_at = ALARMS.c.cleared_at
        shown = sa.or_(cleared_at.is_(None), cleared_at >= seconds(since))
        return self._alarms(sa.select(ALARMS).where(shown))

    def standing_alarms(self) -> list[AlarmRow]:
        """Alarms that stand."""
        return self._alarms(sa.select(ALARMS).where(ALARMS.c.cleared_at.is_(None)))

    def last_alarm(self, kind: str, subject: str) -> AlarmRow | None:
        """The last one of a kind about something."""
        a = ALARMS.c
        chosen = sa.select(ALARMS).where(a.kind == kind, a.subject == subject)
        return next(iter(self._alarms(chosen.order_by(a.number.desc()).limit(1))), None)

    def _alarms(self, chosen: Any) -> list[AlarmRow]:
        return [_alarm(row) for row in self._rows(chosen)]


def _put_alarm(db: sa.Connection, row: AlarmRow) -> AlarmRow:
    """Add an alarm, or change one that has a number; as it is kept."""
    values = dict(vars(row))
    number = values.pop("number")
    if number:
        db.execute(ALARMS.update().where(ALARMS.c.number == number).values(**values))
        return row
    key = db.execute(ALARMS.insert().values(**values)).inserted_primary_key
    return replace(row, number=int(key[0]))


def _alarm(row: Any) -> AlarmRow:
    """An alarm from its row."""
    found = AlarmRow(*row)
    return replace(found, items=tuple(found.items))
