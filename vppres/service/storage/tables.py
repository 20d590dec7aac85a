"""The tables of a service's state, and how rows are written."""

from __future__ import annotations

import json
from types import UnionType
from typing import Any, get_args, get_type_hints

import pandas as pd
import sqlalchemy as sa

from vppres.service.storage.records import AlarmRow, Reading, Token, seconds

TABLES = sa.MetaData()

NUMBER = "number"
"""A key that the database counts."""


class Json(sa.TypeDecorator[Any]):
    """A plain value as text."""

    impl = sa.Text
    cache_ok = True
    is_sorted = False

    def process_bind_param(self, value: Any, dialect: Any) -> str | None:
        """The text of a value."""
        if value is None:
            return None
        short = (",", ":")
        return json.dumps(value, allow_nan=False, separators=short, sort_keys=self.is_sorted)

    def process_result_value(self, value: Any, dialect: Any) -> Any:
        """The value of a text."""
        return None if value is None else json.loads(value)


class SortedJson(Json):
    """The body of a request, whatever order its fields were sent in."""

    cache_ok = True
    is_sorted = True


COLUMNS = {str: sa.String, int: sa.BigInteger, float: sa.Float, tuple[str, ...]: Json}
"""Columns by what they hold."""


def _table(name: str, keys: str, /, index: str = "", **fields: Any) -> sa.Table:
    """A table of fields, each with what it holds; ``keys`` are those of its primary key."""
    columns = [
        sa.Column(
            field,
            sa.Integer if field == NUMBER else _column(holds),
            primary_key=field in keys.split(),
            nullable=isinstance(holds, UnionType),
            index=field == index or None,
        )
        for field, holds in fields.items()
    ]
    return sa.Table(name, TABLES, *columns)


def _column(holds: Any) -> Any:
    """The type of a column by what it holds, or None beside it."""
    kind = get_args(holds)[0] if isinstance(holds, UnionType) else holds
    return COLUMNS.get(kind, kind)


META = _table("meta", "key", key=str, value=str)
TELEMETRY = _table(
    "telemetry",
    "asset quantity time source",
    **{**get_type_hints(Reading), "value": float | None},  # none: known to be missing
)
HEARD_OF = _table("heard_of", "asset quantity", asset=str, quantity=str)
CONTACTS = _table("contacts", "source", source=str, last_contact=int)
EVENTS = _table(
    "events",
    "id version",
    id=str,
    version=int,
    made_at=int,
    body=SortedJson | None,  # none: withdrawn
)
WRITTEN = _table("written_events", "number", number=int, id=str, version=int)
"""The order in which versions of events were written, also of those of the same second."""

FORECASTS = _table("forecasts", "quantity issued_at", quantity=str, issued_at=int, body=SortedJson)
STEPS = _table("steps", "time", time=int, outcome=str, plan=Json)
OUTCOMES = _table("outcomes", "outcome", outcome=str, steps=int)
STATES = _table("controller_state", "time", time=int, state=sa.Text)
MEASURED = _table("measured", "time", time=int, load_kw=Json, pv_kw=Json)
ACKS = _table(
    "acks",
    NUMBER,
    index="setpoint",
    number=int,
    at=int,
    actor=str,
    setpoint=str,
    kind=str,
    asset=str,
    status=str,
    value=float | None,
    reason=str,
)
LOST = _table("lost_customers", "asset", asset=str, at=int, reason=str)
UNDIMMED = _table("undimmed_customers", "asset", asset=str, at=int, reason=str)
ALARMS = _table("alarms", NUMBER, index="cleared_at", **get_type_hints(AlarmRow))
KEYS = _table("idempotency_keys", "key", key=str, time=int)
AUDIT = _table("audit", NUMBER, number=int, at=int, actor=str, action=str, detail=sa.Text)
TOKENS = _table("tokens", "name", **get_type_hints(Token))


def put(db: sa.Connection, table: sa.Table, **row: Any) -> None:
    """Insert a row, or replace the one with its key."""
    key = (column == row[column.name] for column in table.primary_key.columns)
    db.execute(table.delete().where(*key))
    db.execute(table.insert().values(**row))


def note(db: sa.Connection, now: pd.Timestamp, actor: str, action: str, detail: str) -> None:
    """Add to the audit, of which nothing is ever changed."""
    db.execute(AUDIT.insert().values(at=seconds(now), actor=actor, action=action, detail=detail))


# What is written down stays as it was written, whatever this program comes to do.
for _verb in ("UPDATE", "DELETE"):
    _name = f"audit_no_{_verb.lower()}"
    for _dialect, _rule in {
        "sqlite": f"CREATE TRIGGER {_name} BEFORE {_verb} ON audit "
        "BEGIN SELECT RAISE(ABORT, 'the audit is only added to'); END",
        "postgresql": f"CREATE RULE {_name} AS ON {_verb} TO audit DO INSTEAD NOTHING",
    }.items():
        ddl = sa.DDL(_rule).execute_if(dialect=_dialect)
        sa.event.listen(AUDIT, "after_create", ddl)
