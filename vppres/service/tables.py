"""The tables of a service's state."""

from __future__ import annotations

import sqlalchemy as sa

TABLES = sa.MetaData()

META = sa.Table(
    "meta",
    TABLES,
    sa.Column("key", sa.String, primary_key=True),
    sa.Column("value", sa.String, nullable=False),
)
TELEMETRY = sa.Table(
    "telemetry",
    TABLES,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("quantity", sa.String, primary_key=True),
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("source", sa.String, primary_key=True),
    sa.Column("resolution_s", sa.Integer, nullable=False),
    sa.Column("value", sa.Float),
)
HEARD_OF = sa.Table(
    "heard_of",
    TABLES,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("quantity", sa.String, primary_key=True),
)
CONTACTS = sa.Table(
    "contacts",
    TABLES,
    sa.Column("source", sa.String, primary_key=True),
    sa.Column("last_contact", sa.BigInteger, nullable=False),
)
EVENTS = sa.Table(
    "events",
    TABLES,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("version", sa.Integer, primary_key=True),
    sa.Column("made_at", sa.BigInteger, nullable=False),
    sa.Column("body", sa.Text),  # none: withdrawn
)
FORECASTS = sa.Table(
    "forecasts",
    TABLES,
    sa.Column("quantity", sa.String, primary_key=True),
    sa.Column("issued_at", sa.BigInteger, primary_key=True),
    sa.Column("body", sa.Text, nullable=False),
)
STEPS = sa.Table(
    "steps",
    TABLES,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("outcome", sa.String, nullable=False),
    sa.Column("plan", sa.Text, nullable=False),
)
OUTCOMES = sa.Table(
    "outcomes",
    TABLES,
    sa.Column("outcome", sa.String, primary_key=True),
    sa.Column("steps", sa.BigInteger, nullable=False),
)
STATES = sa.Table(
    "controller_state",
    TABLES,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("state", sa.Text, nullable=False),
)
MEASURED = sa.Table(
    "measured",
    TABLES,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("load_kw", sa.Text, nullable=False),
    sa.Column("pv_kw", sa.Text, nullable=False),
)
ACKS = sa.Table(
    "acks",
    TABLES,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("actor", sa.String, nullable=False),
    sa.Column("setpoint", sa.String, nullable=False, index=True),
    sa.Column("kind", sa.String, nullable=False),
    sa.Column("asset", sa.String, nullable=False),
    sa.Column("status", sa.String, nullable=False),
    sa.Column("value", sa.Float),
    sa.Column("reason", sa.String, nullable=False),
)
LOST = sa.Table(
    "lost_customers",
    TABLES,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("reason", sa.String, nullable=False),
)
ALARMS = sa.Table(
    "alarms",
    TABLES,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("kind", sa.String, nullable=False),
    sa.Column("subject", sa.String, nullable=False),
    sa.Column("priority", sa.String, nullable=False),
    sa.Column("text", sa.Text, nullable=False),
    sa.Column("items", sa.Text, nullable=False),
    sa.Column("due_at", sa.BigInteger),
    sa.Column("raised_at", sa.BigInteger, nullable=False),
    sa.Column("acknowledged_at", sa.BigInteger),
    sa.Column("acknowledged_by", sa.String, nullable=False),
    sa.Column("cleared_at", sa.BigInteger, index=True),
    sa.Column("shelved_until", sa.BigInteger),
    sa.Column("shelved_by", sa.String, nullable=False),
)
KEYS = sa.Table(
    "idempotency_keys",
    TABLES,
    sa.Column("key", sa.String, primary_key=True),
    sa.Column("time", sa.BigInteger, nullable=False),
)
AUDIT = sa.Table(
    "audit",
    TABLES,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("actor", sa.String, nullable=False),
    sa.Column("action", sa.String, nullable=False),
    sa.Column("detail", sa.Text, nullable=False),
)
TOKENS = sa.Table(
    "tokens",
    TABLES,
    sa.Column("name", sa.String, primary_key=True),
    sa.Column("sha256", sa.String, nullable=False),
    sa.Column("scopes", sa.String, nullable=False),
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
