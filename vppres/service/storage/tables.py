"""The tables of a service's state."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

TABLES = sa.MetaData()


def _table(name: str, *columns: sa.Column[Any]) -> sa.Table:
    return sa.Table(name, TABLES, *columns)


def _key(name: str, kind: Any = sa.String) -> sa.Column[Any]:
    return sa.Column(name, kind, primary_key=True)


def _filled(name: str, kind: Any = sa.String, index: bool = False) -> sa.Column[Any]:
    return sa.Column(name, kind, nullable=False, index=index or None)


META = _table("meta", _key("key"), _filled("value"))
TELEMETRY = _table(
    "telemetry",
    _key("asset"),
    _key("quantity"),
    _key("time", sa.BigInteger),
    _key("source"),
    _filled("resolution_s", sa.Integer),
    sa.Column("value", sa.Float),
)
HEARD_OF = _table("heard_of", _key("asset"), _key("quantity"))
CONTACTS = _table("contacts", _key("source"), _filled("last_contact", sa.BigInteger))
EVENTS = _table(
    "events",
    _key("id"),
    _key("version", sa.Integer),
    _filled("made_at", sa.BigInteger),
    sa.Column("body", sa.Text),  # none: withdrawn
)
FORECASTS = _table(
    "forecasts",
    _key("quantity"),
    _key("issued_at", sa.BigInteger),
    _filled("body", sa.Text),
)
STEPS = _table("steps", _key("time", sa.BigInteger), _filled("outcome"), _filled("plan", sa.Text))
OUTCOMES = _table("outcomes", _key("outcome"), _filled("steps", sa.BigInteger))
STATES = _table("controller_state", _key("time", sa.BigInteger), _filled("state", sa.Text))
MEASURED = _table(
    "measured",
    _key("time", sa.BigInteger),
    _filled("load_kw", sa.Text),
    _filled("pv_kw", sa.Text),
)
ACKS = _table(
    "acks",
    _key("number", sa.Integer),
    _filled("at", sa.BigInteger),
    _filled("actor"),
    _filled("setpoint", index=True),
    _filled("kind"),
    _filled("asset"),
    _filled("status"),
    sa.Column("value", sa.Float),
    _filled("reason"),
)
LOST = _table("lost_customers", _key("asset"), _filled("at", sa.BigInteger), _filled("reason"))
UNDIMMED = _table(
    "undimmed_customers", _key("asset"), _filled("at", sa.BigInteger), _filled("reason")
)
ALARMS = _table(
    "alarms",
    _key("number", sa.Integer),
    _filled("kind"),
    _filled("subject"),
    _filled("priority"),
    _filled("text", sa.Text),
    _filled("items", sa.Text),
    sa.Column("due_at", sa.BigInteger),
    _filled("raised_at", sa.BigInteger),
    sa.Column("acknowledged_at", sa.BigInteger),
    _filled("acknowledged_by"),
    sa.Column("cleared_at", sa.BigInteger, index=True),
    sa.Column("shelved_until", sa.BigInteger),
    _filled("shelved_by"),
)
KEYS = _table("idempotency_keys", _key("key"), _filled("time", sa.BigInteger))
AUDIT = _table(
    "audit",
    _key("number", sa.Integer),
    _filled("at", sa.BigInteger),
    _filled("actor"),
    _filled("action"),
    _filled("detail", sa.Text),
)
TOKENS = _table(
    "tokens",
    _key("name"),
    _filled("sha256"),
    _filled("scopes"),
    sa.Column("expires", sa.Integer),  # none: never
)

# What is written down stays as it was written, whatever this program comes to do.
for _verb in ("UPDATE", "DELETE"):
    sa.event.listen(
        AUDIT,
        "after_create",
        sa.DDL(
            f"CREATE TRIGGER audit_no_{_verb.lower()} BEFORE {_verb} ON audit "
            "BEGIN SELECT RAISE(ABORT, 'the audit is only added to'); END"
        ).execute_if(dialect="sqlite"),
    )
    sa.event.listen(
        AUDIT,
        "after_create",
        sa.DDL(
            f"CREATE RULE audit_no_{_verb.lower()} AS ON {_verb} TO audit DO INSTEAD NOTHING"
        ).execute_if(dialect="postgresql"),
    )
