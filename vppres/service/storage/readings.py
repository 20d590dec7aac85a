"""Readings, and when their sources were last heard from."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from vppres.service.storage.records import Reading, Written, seconds
from vppres.service.storage.tables import CONTACTS, HEARD_OF, TELEMETRY, note, put
from vppres.service.storage.transactions import Transactions

COUNTED = {"preserve_rowcount": True}
INSERTS = {"sqlite": sqlite.insert, "postgresql": postgresql.insert}


class StoredReadings(Transactions):
    """Readings of a site."""

    def __init__(self, place: Path | str, site: str, reading: bool = False) -> None:
        super().__init__(place, site, reading)
        # Assets and quantities that were ever received.
        self._items = {(row.asset, row.quantity) for row in self._rows(sa.select(HEARD_OF))}

    def write_readings(
        self, readings: Iterable[Reading], now: pd.Timestamp, actor: str | None = None
    ) -> Written:
        """Keep readings; those that are there with the same value count as duplicates."""
        rows = [{**vars(one), "value": one.value if one.known else None} for one in readings]
        if not rows:
            return Written(0, 0)
        with self._changes(routine=True) as db:
            accepted = db.execute(_replacing(db), rows, execution_options=COUNTED).rowcount
            new = {(row["asset"], row["quantity"]) for row in rows} - self._items
            for asset, quantity in sorted(new):
                put(db, HEARD_OF, asset=asset, quantity=quantity)
            for source in {row["source"] for row in rows}:
                put(db, CONTACTS, source=source, last_contact=seconds(now))
            if actor:
                note(db, now, actor, "telemetry", f"{accepted} of {len(rows)} readings")
        self._items |= new
        return Written(accepted, len(rows) - accepted)

    def was_heard(self, asset: str, quantity: str) -> bool:
        """Whether there ever was a reading."""
        return (asset, quantity) in self._items

    def latest(
        self, until: pd.Timestamp, quantities: Iterable[str], known: bool = False
    ) -> list[Reading]:
        """The last reading of each asset and quantity up to a time, that time included.

        Missing values are passed over if only ``known`` ones are asked for.
        """
        # Of two sources that speak at once the first by name counts.
        found = self._readings(_latest(seconds(until), quantities, known))
        return list({(r.asset, r.quantity): r for r in found}.values())

    def has_turned(self, asset: str, quantity: str, since: int) -> bool:
        """Whether a state was read as 0 since a time, or was not read before it."""
        t = TELEMETRY.c
        own = sa.select(t.time).where(t.asset == asset, t.quantity == quantity).limit(1)
        off = own.where(t.time > since, t.value == 0.0)
        return bool(self._rows(off)) or not self._rows(own.where(t.time <= since))

    def between(
        self, start: pd.Timestamp, end: pd.Timestamp, quantities: Iterable[str]
    ) -> list[Reading]:
        """Readings from a time on, up to but without another one."""
        t = TELEMETRY.c
        inside = sa.and_(t.time >= seconds(start), t.time < seconds(end))
        chosen = sa.select(TELEMETRY).where(inside, t.quantity.in_(list(quantities)))
        return self._readings(chosen.order_by(t.time, t.source))

    def contacts(self) -> dict[str, int]:
        """When each source was last heard from."""
        return self._mapping(sa.select(CONTACTS))

    def _readings(self, chosen: Any) -> list[Reading]:
        # NULL is a missing value.
        return [
            Reading(asset, quantity, time, source, long, np.nan if value is None else value)
            for asset, quantity, time, source, long, value in self._rows(chosen)
        ]


def _replacing(db: sa.Connection) -> Any:
    """Insert readings, replacing those with another value; others are not counted."""
    t = TELEMETRY.c
    insert = INSERTS[db.dialect.name](TELEMETRY)
    return insert.on_conflict_do_update(
        index_elements=[column.name for column in TELEMETRY.primary_key.columns],
        set_={name: insert.excluded[name] for name in ("resolution_s", "value")},
        where=t.value.is_distinct_from(insert.excluded.value),
    )


def _latest(until: int, quantities: Iterable[str], known: bool) -> Any:
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
