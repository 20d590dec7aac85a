"""Store of a site: the statements of each subject, and how long what is kept."""

from __future__ import annotations

import pandas as pd
import sqlalchemy as sa

from vppres.service.storage.alarms import StoredAlarms
from vppres.service.storage.events import StoredEvents
from vppres.service.storage.followed import StoredAnswers
from vppres.service.storage.people import StoredSettings
from vppres.service.storage.readings import StoredReadings
from vppres.service.storage.records import seconds
from vppres.service.storage.tables import (
    ACKS,
    ALARMS,
    EVENTS,
    FORECASTS,
    KEYS,
    MEASURED,
    STEPS,
    TELEMETRY,
    WRITTEN,
)


class Store(StoredReadings, StoredEvents, StoredAnswers, StoredAlarms, StoredSettings):
    """All that is kept of one site."""

    def forget(self, before: pd.Timestamp, learned_before: pd.Timestamp) -> None:
        """Drop what is older: readings, steps, forecasts, acknowledgements, events and alarms.

        What holds stays, however old it is, and so does the audit; what a forecaster learns from
        has a time of its own.
        """
        at = seconds(before)
        e, f, w = EVENTS.c, FORECASTS.c, WRITTEN.c
        newest = sa.select(sa.func.max(f.issued_at)).group_by(f.quantity)
        later = EVENTS.alias("later")
        replaced = sa.exists().where(later.c.id == e.id, later.c.version > e.version)
        too_old = {
            TELEMETRY: TELEMETRY.c.time < at,
            STEPS: STEPS.c.time < at,
            MEASURED: MEASURED.c.time < seconds(learned_before),
            KEYS: KEYS.c.time < at,
            ACKS: ACKS.c.at < at,
            FORECASTS: sa.and_(f.issued_at < at, f.issued_at.not_in(newest)),
            ALARMS: ALARMS.c.cleared_at < at,
            EVENTS: sa.and_(e.made_at < at, sa.or_(replaced, e.body.is_(None))),
            WRITTEN: sa.not_(sa.exists().where(e.id == w.id, e.version == w.version)),
        }
        with self._changes(routine=True) as db:
            for table, old in too_old.items():
                db.execute(table.delete().where(old))
        self._event_changes += 1
