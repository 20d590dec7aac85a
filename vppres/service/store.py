"""What the service knows and has said: one transaction a step, before anything is sent."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import starmap
from pathlib import Path
from typing import Any

import pandas as pd
import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from vppres.core.errors import InputError, Problem, StorageError, VppresError
from vppres.service.database import opened_database

LAYOUT = "1"
STATES_KEPT = 3
COMPACT = (",", ":")
COUNTED = {"preserve_rowcount": True}
REFUSED = ("rejected", "aborted")

_tables = sa.MetaData()

_meta = sa.Table(
    "meta",
    _tables,
    sa.Column("key", sa.String, primary_key=True),
    sa.Column("value", sa.String, nullable=False),
)
_telemetry = sa.Table(
    "telemetry",
    _tables,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("quantity", sa.String, primary_key=True),
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("source", sa.String, primary_key=True),
    sa.Column("resolution_s", sa.Integer, nullable=False),
    sa.Column("value", sa.Float),
)
_heard_of = sa.Table(
    "heard_of",
    _tables,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("quantity", sa.String, primary_key=True),
)
_contacts = sa.Table(
    "contacts",
    _tables,
    sa.Column("source", sa.String, primary_key=True),
    sa.Column("last_contact", sa.BigInteger, nullable=False),
)
_events = sa.Table(
    "events",
    _tables,
    sa.Column("id", sa.String, primary_key=True),
    sa.Column("version", sa.Integer, primary_key=True),
    sa.Column("made_at", sa.BigInteger, nullable=False),
    sa.Column("body", sa.Text),  # none: withdrawn
)
_forecasts = sa.Table(
    "forecasts",
    _tables,
    sa.Column("quantity", sa.String, primary_key=True),
    sa.Column("issued_at", sa.BigInteger, primary_key=True),
    sa.Column("body", sa.Text, nullable=False),
)
_steps = sa.Table(
    "steps",
    _tables,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("outcome", sa.String, nullable=False),
    sa.Column("plan", sa.Text, nullable=False),
)
_outcomes = sa.Table(
    "outcomes",
    _tables,
    sa.Column("outcome", sa.String, primary_key=True),
    sa.Column("steps", sa.BigInteger, nullable=False),
)
_states = sa.Table(
    "controller_state",
    _tables,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("state", sa.Text, nullable=False),
)
_measured = sa.Table(
    "measured",
    _tables,
    sa.Column("time", sa.BigInteger, primary_key=True),
    sa.Column("load_kw", sa.Text, nullable=False),
    sa.Column("pv_kw", sa.Text, nullable=False),
)
_acks = sa.Table(
    "acks",
    _tables,
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
_lost = sa.Table(
    "lost_customers",
    _tables,
    sa.Column("asset", sa.String, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("reason", sa.String, nullable=False),
)
_keys = sa.Table(
    "idempotency_keys",
    _tables,
    sa.Column("key", sa.String, primary_key=True),
    sa.Column("time", sa.BigInteger, nullable=False),
)
_audit = sa.Table(
    "audit",
    _tables,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),
    sa.Column("actor", sa.String, nullable=False),
    sa.Column("action", sa.String, nullable=False),
    sa.Column("detail", sa.Text, nullable=False),
)
_tokens = sa.Table(
    "tokens",
    _tables,
    sa.Column("name", sa.String, primary_key=True),
    sa.Column("sha256", sa.String, nullable=False),
    sa.Column("scopes", sa.String, nullable=False),
    sa.Column("expires", sa.Integer),  # none: never
)

# What is written down stays as it was written, whatever this program comes to do.
for _verb in ("UPDATE", "DELETE"):
    sa.event.listen(
        _audit,
        "after_create",
        sa.DDL(
            f"CREATE TRIGGER audit_no_{_verb.lower()} BEFORE {_verb} ON audit "
            "BEGIN SELECT RAISE(ABORT, 'the audit is only added to'); END"
        ).execute_if(dialect="sqlite"),
    )
    sa.event.listen(
        _audit,
        "after_create",
        sa.DDL(
            f"CREATE RULE audit_no_{_verb.lower()} AS ON {_verb} TO audit DO INSTEAD NOTHING"
        ).execute_if(dialect="postgresql"),
    )


def seconds(time: pd.Timestamp) -> int:
    """Whole seconds of UTC, as times are stored.

    >>> seconds(pd.Timestamp("1970-01-01T01:00:01+01:00"))
    1
    """
    return int(time.timestamp())


def moment(stored: int) -> pd.Timestamp:
    """The time of stored seconds."""
    return pd.Timestamp(stored, unit="s", tz="UTC")


@dataclass(frozen=True)
class Reading:
    """One reading; ``value`` is None where it is known to be missing."""

    asset: str
    quantity: str
    time: int
    source: str
    resolution_s: int
    value: float | None


@dataclass(frozen=True)
class Written:
    """What became of a batch of readings."""

    accepted: int
    duplicates: int


@dataclass(frozen=True)
class Event:
    """A version of an event.

    Parameters
    ----------
    version : int
        Its number, from 1.
    body : dict
        What it says; empty where it was withdrawn.
    made_at : int
        When it was written.
    since : int
        When the first version was, after it was withdrawn last.
    new : bool
        Whether no version held before it; told of one that was just written.
    """

    version: int
    body: dict[str, Any]
    made_at: int
    since: int
    new: bool = False


@dataclass(frozen=True)
class Lost:
    """Since when somebody cannot be supplied, and why."""

    at: int
    reason: str


@dataclass(frozen=True)
class Measured:
    """Demand and PV power of a step in the site's order, None where nothing was measured."""

    time: int
    load_kw: list[float | None]
    pv_kw: list[float | None]


@dataclass(frozen=True)
class After:
    """What a controller is at after a step.

    Parameters
    ----------
    state : str
        Its state as JSON.
    measured : Measured or None
        What its forecaster learned; None where none learns.
    """

    state: str
    measured: Measured | None = None


@dataclass(frozen=True)
class Asked:
    """Who asked for something, and when."""

    actor: str
    at: pd.Timestamp


@dataclass(frozen=True)
class Token:
    """Who may do what, until when in seconds; of the secret only the hash is kept."""

    name: str
    sha256: str
    scopes: str
    expires: int | None = None


class ChangedError(VppresError):
    """It is no longer as whoever wants to change it believes."""


class Store:
    """The database of one site.

    Parameters
    ----------
    place : Path or str
        A folder, made if it is not there, or the address of a PostgreSQL database.
    site : str
        Key of the site, to which the database belongs.
    reading : bool, optional
        Whether it is only read, beside the process that serves from it.

    Raises
    ------
    InputError
        If another process serves from it, or it belongs to another site or layout.
    """

    def __init__(self, place: Path | str, site: str, reading: bool = False) -> None:
        self._database = opened_database(place, reading)
        self._engine = self._database.engine
        self._reading = reading
        self._writing = threading.Lock()
        self.changes = 0  # whoever shows what is stored looks again when it has grown
        self._events_known: tuple[int, dict[str, Event]] | None = None
        self._event_changes = 0
        if not reading:
            with _plain_errors():
                _tables.create_all(self._engine)
        self._belongs_to(site, reading)
        if not reading:
            self._count_older_steps()
        self._items = self._known_items()

    def _known_items(self) -> set[tuple[str, str]]:
        """Assets and quantities that were ever heard of."""
        with self._reads() as db:
            return {(row.asset, row.quantity) for row in db.execute(sa.select(_heard_of))}

    @property
    def place(self) -> str:
        """Where it is, without a password."""
        return self._database.name

    def close(self) -> None:
        """Let go of the database."""
        self._database.close()

    def ready(self) -> bool:
        """Whether the database takes a transaction."""
        try:
            with self._changes(routine=True) as db:
                _put(db, _meta, key="checked", value="")
        except StorageError:
            return False
        return True

    # Telemetry

    def write_readings(
        self, readings: Iterable[Reading], now: pd.Timestamp, actor: str | None = None
    ) -> Written:
        """Keep readings; those that are there with the same value count as duplicates."""
        rows = [vars(reading) for reading in readings]
        if not rows:
            return Written(0, 0)
        with self._changes(routine=True) as db:
            written = _upsert(db, _telemetry, "value")
            accepted = db.execute(written, rows, execution_options=COUNTED).rowcount
            new = {(row["asset"], row["quantity"]) for row in rows} - self._items
            for asset, quantity in sorted(new):
                _put(db, _heard_of, asset=asset, quantity=quantity)
            for source in {row["source"] for row in rows}:
                _put(db, _contacts, source=source, last_contact=seconds(now))
            if actor is not None:
                _note(db, now, actor, "telemetry", f"{accepted} of {len(rows)} readings")
        self._items |= new
        return Written(accepted, len(rows) - accepted)

    def latest(self, until: pd.Timestamp, quantities: Iterable[str]) -> list[Reading]:
        """The last reading of each asset and quantity up to a time, that time included."""
        # Of two sources that speak at once the first by name counts.
        found = self._readings(_LATEST, {"until": seconds(until), "quantities": list(quantities)})
        return list({(r.asset, r.quantity): r for r in found}.values())

    def between(
        self, start: pd.Timestamp, end: pd.Timestamp, quantities: Iterable[str]
    ) -> list[Reading]:
        """Readings from a time on, up to but without another one."""
        named = {"start": seconds(start), "end": seconds(end), "quantities": list(quantities)}
        return self._readings(_BETWEEN, named)

    def _readings(self, chosen: Any, named: Mapping[str, Any]) -> list[Reading]:
        with self._reads() as db:
            return list(starmap(Reading, db.execute(chosen, named)))

    def contacts(self) -> dict[str, int]:
        """When each source was last heard from."""
        with self._reads() as db:
            return {row.source: row.last_contact for row in db.execute(sa.select(_contacts))}

    # Events and forecasts

    def put_event(
        self,
        identifier: str,
        body: dict[str, Any] | None,
        now: pd.Timestamp,
        actor: str,
        replacing: int | None = None,
    ) -> Event:
        """Keep a version of an event, none to withdraw it; the version.

        Parameters
        ----------
        identifier : str
            Of the event.
        body : dict or None
            What it says.
        now : pandas.Timestamp
            When it is said.
        actor : str
            Who says it.
        replacing : int, optional
            The version that it is to replace, whichever it is if not given.

        Raises
        ------
        ChangedError
            If the event has another version, or there is none to be withdrawn.
        """
        with self._changes() as db:
            e = _events.c
            newest = sa.select(_events).where(e.id == identifier).order_by(e.version.desc())
            before = db.execute(newest.limit(1)).first()
            holds = before is not None and before.body is not None
            if replacing is not None and (not holds or before.version != replacing):
                raise ChangedError(f"The event has another version than {replacing}.")
            if body is None and not holds:
                raise ChangedError("The event was withdrawn before.")
            version = 1 if before is None else before.version + 1
            text = None if body is None else json.dumps(body, sort_keys=True)
            _put(db, _events, id=identifier, version=version, made_at=seconds(now), body=text)
            action = "event withdrawn" if body is None else "event"
            _note(db, now, actor, action, f"{identifier} {text or ''}")
        self._event_changes += 1
        return Event(version, body or {}, seconds(now), seconds(now), new=not holds)

    def events(self) -> dict[str, Event]:
        """The latest version of each event that holds."""
        # Nobody else writes here, so that what was read holds until an event changes.
        seen = self._event_changes
        if self._events_known is None or self._events_known[0] != seen or self._reading:
            self._events_known = seen, self._events_stored()
        return dict(self._events_known[1])

    def _events_stored(self) -> dict[str, Event]:
        e = _events.c
        newest = sa.select(e.id, sa.func.max(e.version).label("version")).group_by(e.id).subquery()
        gone = (
            sa.select(e.id, sa.func.max(e.version).label("version"))
            .where(e.body.is_(None))
            .group_by(e.id)
            .subquery()
        )
        since = (
            sa.select(e.id, sa.func.min(e.made_at).label("made_at"))
            .outerjoin(gone, e.id == gone.c.id)
            .where(sa.or_(gone.c.version.is_(None), e.version > gone.c.version))
            .group_by(e.id)
            .subquery()
        )
        chosen = (
            sa.select(_events, since.c.made_at.label("since"))
            .join(newest, sa.and_(e.id == newest.c.id, e.version == newest.c.version))
            .join(since, e.id == since.c.id)
            .order_by(e.id)
        )
        with self._reads() as db:
            rows = db.execute(chosen).all()
        return {r.id: Event(r.version, json.loads(r.body), r.made_at, r.since) for r in rows}

    def event_versions(self, identifier: str) -> list[Event]:
        """All versions of an event, in their order; those that withdrew it have no body."""
        chosen = sa.select(_events).where(_events.c.id == identifier).order_by(_events.c.version)
        with self._reads() as db:
            rows = db.execute(chosen).all()
        found: list[Event] = []
        for row in rows:
            again = not found or not found[-1].body
            since = row.made_at if again else found[-1].since
            body = json.loads(row.body) if row.body else {}
            found.append(Event(row.version, body, row.made_at, since))
        return found

    def events_ever(self) -> list[list[Event]]:
        """All versions of every event that there ever was, as far as they are kept."""
        with self._reads() as db:
            names = db.execute(sa.select(_events.c.id).distinct()).scalars().all()
        return [self.event_versions(name) for name in names]

    def put_forecast(
        self, quantity: str, body: dict[str, Any], now: pd.Timestamp, actor: str
    ) -> None:
        """Keep a forecast beside older ones."""
        issued_at = pd.Timestamp(body["issued_at"])
        with self._changes() as db:
            text = json.dumps(body, sort_keys=True)
            _put(db, _forecasts, quantity=quantity, issued_at=seconds(issued_at), body=text)
            _note(db, now, actor, "forecast", f"{quantity} {body['issued_at']}")

    def forecast(self, quantity: str, now: pd.Timestamp) -> dict[str, Any] | None:
        """The forecast that was issued last, up to now."""
        with self._reads() as db:
            text = db.execute(_FORECAST, {"quantity": quantity, "now": seconds(now)}).scalar()
        found: dict[str, Any] | None = None if text is None else json.loads(text)
        return found

    # Steps

    def write_step(
        self,
        time: pd.Timestamp,
        plan: dict[str, Any],
        after: After | None = None,
        asked: Asked | None = None,
    ) -> None:
        """Keep a step: its plan and the controller's state after it, both or neither.

        Parameters
        ----------
        time : pandas.Timestamp
            The step.
        plan : dict
            Its plan.
        after : After, optional
            What the controller is at; nothing where it did not decide.
        asked : Asked, optional
            Who asked for the step, if somebody did.
        """
        at = seconds(time)
        with self._changes() as db:
            text = json.dumps(plan, allow_nan=False, separators=COMPACT)
            _put(db, _steps, time=at, outcome=plan["status"], plan=text)
            _count(db, plan["status"], 1)
            if after is not None:
                _put(db, _states, time=at, state=after.state)
                newest = sa.select(_states.c.time).order_by(_states.c.time.desc())
                kept = newest.limit(STATES_KEPT).scalar_subquery()
                db.execute(_states.delete().where(_states.c.time.not_in(kept)))
                if after.measured is not None:
                    _put_measured(db, [after.measured])
            if asked is not None:
                _note(db, asked.at, asked.actor, "step", f"{plan['id']} {plan['status']}")

    def step(self, time: pd.Timestamp) -> dict[str, Any] | None:
        """The plan of a step, None if it is none of ours."""
        chosen = sa.select(_steps.c.plan).where(_steps.c.time == seconds(time))
        return self._plan(chosen)

    def last_step(self, until: pd.Timestamp | None = None) -> dict[str, Any] | None:
        """The plan of the last step, or of the last one up to a time."""
        chosen = sa.select(_steps.c.plan).order_by(_steps.c.time.desc()).limit(1)
        if until is not None:
            chosen = chosen.where(_steps.c.time <= seconds(until))
        return self._plan(chosen)

    def plans(self, since: pd.Timestamp, until: pd.Timestamp | None = None) -> list[dict[str, Any]]:
        """The plans of the steps that begin from a time on, and before another one."""
        chosen = sa.select(_steps.c.plan).where(_steps.c.time >= seconds(since))
        if until is not None:
            chosen = chosen.where(_steps.c.time < seconds(until))
        with self._reads() as db:
            return [json.loads(text) for (text,) in db.execute(chosen.order_by(_steps.c.time))]

    def _plan(self, chosen: Any) -> dict[str, Any] | None:
        with self._reads() as db:
            text = db.execute(chosen).scalar()
        plan: dict[str, Any] | None = None if text is None else json.loads(text)
        return plan

    def outcomes(self) -> dict[str, int]:
        """How many steps there were of each outcome, those included that are forgotten."""
        with self._reads() as db:
            return {row.outcome: row.steps for row in db.execute(sa.select(_outcomes))}

    def _count_older_steps(self) -> None:
        """Count the steps of a database from before there was a table for it."""
        by_outcome = sa.select(_steps.c.outcome, sa.func.count()).group_by(_steps.c.outcome)
        with self._reads() as db:
            if db.execute(sa.select(_outcomes).limit(1)).first() is not None:
                return
            found = db.execute(by_outcome).all()
        if found:
            with self._changes() as db:
                for outcome, count in found:
                    _count(db, outcome, count)

    def state(self) -> str | None:
        """The controller's last state, as it was written."""
        chosen = sa.select(_states.c.state).order_by(_states.c.time.desc()).limit(1)
        with self._reads() as db:
            text: str | None = db.execute(chosen).scalar()
        return text

    def put_measured(self, rows: Iterable[Measured]) -> None:
        """Keep what was measured in steps."""
        with self._changes(routine=True) as db:
            _put_measured(db, rows)

    def measured(self, since: pd.Timestamp) -> list[Measured]:
        """What was measured in the steps from a time on."""
        m = _measured.c
        chosen = sa.select(_measured).where(m.time >= seconds(since)).order_by(m.time)
        with self._reads() as db:
            return [
                Measured(row.time, json.loads(row.load_kw), json.loads(row.pv_kw))
                for row in db.execute(chosen)
            ]

    def step_of_key(self, key: str, time: pd.Timestamp) -> pd.Timestamp:
        """The step that was asked for with a key: the first one, whatever is asked for now."""
        with self._changes() as db:
            found = db.execute(sa.select(_keys.c.time).where(_keys.c.key == key)).scalar()
            if found is None:
                db.execute(_keys.insert().values(key=key, time=seconds(time)))
        return time if found is None else moment(found)

    def forget(self, before: pd.Timestamp, learned_before: pd.Timestamp) -> None:
        """Drop what is older: readings, steps, forecasts, acknowledgements, events that are over.

        What holds stays, however old it is, and so does the audit; what a forecaster learns from
        has a time of its own.
        """
        at = seconds(before)
        f = _forecasts.c
        newest = sa.select(sa.func.max(f.issued_at)).group_by(f.quantity)
        e = _events.c
        later = _events.alias("later")
        replaced = sa.exists().where(later.c.id == e.id, later.c.version > e.version)
        with self._changes(routine=True) as db:
            db.execute(_telemetry.delete().where(_telemetry.c.time < at))
            db.execute(_steps.delete().where(_steps.c.time < at))
            db.execute(_measured.delete().where(_measured.c.time < seconds(learned_before)))
            db.execute(_keys.delete().where(_keys.c.time < at))
            db.execute(_acks.delete().where(_acks.c.at < at))
            db.execute(_forecasts.delete().where(f.issued_at < at, f.issued_at.not_in(newest)))
            db.execute(_events.delete().where(e.made_at < at, sa.or_(replaced, e.body.is_(None))))
        self._event_changes += 1

    # Acknowledgements

    def put_ack(
        self, setpoint: Mapping[str, Any], said: Mapping[str, Any], now: pd.Timestamp, actor: str
    ) -> None:
        """Keep what became of a set-point; what was said last is not kept twice."""
        values = {name: setpoint[name] for name in ("kind", "asset")}
        with self._changes() as db:
            a = _acks.c
            last = (
                sa.select(a.status, a.value, a.reason)
                .where(a.setpoint == setpoint["id"])
                .order_by(a.number.desc())
                .limit(1)
            )
            before = db.execute(last).first()
            if before is None or before._asdict() != dict(said):
                row = {"setpoint": setpoint["id"], "at": seconds(now), "actor": actor, **values}
                db.execute(_acks.insert().values(**row, **said))
                if setpoint.get("served"):  # whoever was to be on
                    _note_lost(db, setpoint["asset"], said, seconds(now))

    def lost(self) -> dict[str, Lost]:
        """Customers whose device did not switch them on when it was last told to."""
        with self._reads() as db:
            return {row.asset: Lost(row.at, row.reason) for row in db.execute(sa.select(_lost))}

    def acks(self, setpoints: Iterable[str]) -> dict[str, dict[str, Any]]:
        """What was said last of each set-point of which anything was."""
        a = _acks.c
        chosen = sa.select(_acks).where(a.setpoint.in_(list(setpoints))).order_by(a.number)
        with self._reads() as db:
            return {
                row.setpoint: {"status": row.status, "value": row.value, "reason": row.reason}
                for row in db.execute(chosen)
            }

    def refusing(self, kind: str) -> dict[str, int]:
        """Devices of a kind that did not do what they were told last, and since when."""
        with self._reads() as db:
            return {row.asset: row.at for row in db.execute(_REFUSING, {"kind": kind})}

    # Settings, people

    def put_setting(
        self, key: str, value: Any, now: pd.Timestamp, actor: str, replacing: str | None = None
    ) -> str:
        """Keep a setting, and who changed it; its tag.

        Raises
        ------
        ChangedError
            If it is to replace one with another tag than the present one's.
        """
        name = f"setting.{key}"
        with self._changes() as db:
            before = db.execute(sa.select(_meta.c.value).where(_meta.c.key == name)).scalar()
            if replacing is not None and replacing != _tag(before):
                raise ChangedError(f"The {key} has changed since.")
            text = json.dumps(value, sort_keys=True)
            _put(db, _meta, key=name, value=text)
            _note(db, now, actor, key, text)
        return _tag(text)

    def setting(self, key: str) -> tuple[Any, str]:
        """A setting, None if there is none, and its tag."""
        chosen = sa.select(_meta.c.value).where(_meta.c.key == f"setting.{key}")
        with self._reads() as db:
            text = db.execute(chosen).scalar()
        return (None if text is None else json.loads(text)), _tag(text)

    def add_token(self, token: Token, now: pd.Timestamp) -> None:
        """Let somebody in, in place of whoever had the name."""
        with self._changes() as db:
            _put(db, _tokens, **vars(token))
            _note(db, now, "command line", "token", f"{token.name} {token.scopes}")

    def remove_token(self, name: str, now: pd.Timestamp) -> bool:
        """Let somebody in no longer; whether there was such a token."""
        with self._changes() as db:
            found = bool(db.execute(_tokens.delete().where(_tokens.c.name == name)).rowcount)
            if found:
                _note(db, now, "command line", "token removed", name)
        return found

    def tokens(self) -> list[Token]:
        """Everybody who may come in."""
        with self._reads() as db:
            rows = db.execute(sa.select(_tokens).order_by(_tokens.c.name)).all()
        return [Token(row.name, row.sha256, row.scopes, row.expires) for row in rows]

    def audit(self) -> list[tuple[str, str, str]]:
        """Who did what, in order: actor, action, detail."""
        with self._reads() as db:
            rows = db.execute(sa.select(_audit).order_by(_audit.c.number)).all()
        return [(row.actor, row.action, row.detail) for row in rows]

    def _belongs_to(self, site: str, reading: bool) -> None:
        """Refuse the database of another site or layout; a new one is this site's."""
        wanted = {"layout": LAYOUT, "site": site}
        with self._reads() as db:
            known = {row.key: row.value for row in db.execute(sa.select(_meta))}
        missing = {key: value for key, value in wanted.items() if key not in known}
        if missing and not reading:
            with self._changes() as db:
                for key, value in missing.items():
                    _put(db, _meta, key=key, value=value)
        for key, value in wanted.items():
            if known.get(key, value) != value:
                self.close()
                raise InputError(
                    Problem(
                        self._database.name,
                        f"holds the state of another {key}",
                        "Give another place with --state, or remove this one.",
                        field=key,
                        value=known[key][:12],
                    )
                )

    @contextmanager
    def _changes(self, routine: bool = False) -> Iterator[sa.Connection]:
        """A transaction that writes; what is routine need not be seen at once."""
        with self._writing, _plain_errors(), self._engine.begin() as db:
            self._database.check(db)
            yield db
        self.changes += not routine

    @contextmanager
    def _reads(self) -> Iterator[sa.Connection]:
        with _plain_errors(), self._engine.connect() as db:
            yield db


def _latest() -> Any:
    """The last reading of each asset and quantity up to a time."""
    named = _heard_of
    t = _telemetry.c
    earlier = _telemetry.alias("earlier")
    last = (
        sa.select(sa.func.max(earlier.c.time))
        .where(
            earlier.c.asset == named.c.asset,
            earlier.c.quantity == named.c.quantity,
            earlier.c.time <= sa.bindparam("until"),
        )
        .scalar_subquery()
    )
    same = sa.and_(t.asset == named.c.asset, t.quantity == named.c.quantity, t.time == last)
    chosen = sa.select(_telemetry).select_from(named.join(_telemetry, same))
    chosen = chosen.where(named.c.quantity.in_(sa.bindparam("quantities", expanding=True)))
    return chosen.order_by(t.asset, t.quantity, t.source.desc())


def _between() -> Any:
    """Readings from a time on, before another one."""
    t = _telemetry.c
    inside = sa.and_(t.time >= sa.bindparam("start"), t.time < sa.bindparam("end"))
    named = t.quantity.in_(sa.bindparam("quantities", expanding=True))
    return sa.select(_telemetry).where(inside, named).order_by(t.time, t.source)


def _forecast() -> Any:
    """The forecast of a quantity that was issued last, up to a time."""
    f = _forecasts.c
    issued = sa.and_(f.quantity == sa.bindparam("quantity"), f.issued_at <= sa.bindparam("now"))
    return sa.select(f.body).where(issued).order_by(f.issued_at.desc()).limit(1)


def _refusing() -> Any:
    """Devices of a kind whose last word is that they did not."""
    a = _acks.c
    newest = sa.select(sa.func.max(a.number)).where(a.kind == sa.bindparam("kind"))
    last = newest.group_by(a.asset).scalar_subquery()
    return sa.select(a.asset, a.at).where(a.number.in_(last), a.status.in_(REFUSED))


# Statements of every step are put together once.
_LATEST = _latest()
_BETWEEN = _between()
_FORECAST = _forecast()
_REFUSING = _refusing()


def _put(db: sa.Connection, table: sa.Table, **row: Any) -> None:
    """Insert a row, or replace the one with its key."""
    db.execute(table.delete().where(_where(table, row)))
    db.execute(table.insert().values(**row))


def _put_measured(db: sa.Connection, rows: Iterable[Measured]) -> None:
    for row in rows:
        load_kw, pv_kw = (json.dumps(values) for values in (row.load_kw, row.pv_kw))
        _put(db, _measured, time=row.time, load_kw=load_kw, pv_kw=pv_kw)


def _note_lost(db: sa.Connection, asset: str, said: Mapping[str, Any], at: int) -> None:
    """A customer that could not be switched on, or was after all."""
    if said["status"] not in REFUSED:
        db.execute(_lost.delete().where(_lost.c.asset == asset))
        return
    reason = f"{said['status']}: {said['reason']}" if said["reason"] else said["status"]
    _put(db, _lost, asset=asset, at=at, reason=reason)


def _tag(text: str | None) -> str:
    """Name of what a setting says."""
    return hashlib.sha256((text or "").encode()).hexdigest()[:16]


def _count(db: sa.Connection, outcome: str, more: int) -> None:
    """Count steps of an outcome."""
    o = _outcomes.c
    counted = db.execute(
        sa.update(_outcomes).where(o.outcome == outcome).values(steps=o.steps + more)
    )
    if not counted.rowcount:
        db.execute(_outcomes.insert().values(outcome=outcome, steps=more))


def _upsert(db: sa.Connection, table: sa.Table, value: str) -> Any:
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


def _where(table: sa.Table, row: dict[str, Any]) -> Any:
    """The row's key."""
    return sa.and_(*(column == row[column.name] for column in table.primary_key.columns))


def _note(db: sa.Connection, now: pd.Timestamp, actor: str, action: str, detail: str) -> None:
    """Add to the audit, of which nothing is ever changed."""
    db.execute(_audit.insert().values(at=seconds(now), actor=actor, action=action, detail=detail))


@contextmanager
def _plain_errors() -> Iterator[None]:
    """What the database says as an error of ours."""
    try:
        yield
    except sa.exc.SQLAlchemyError as error:
        words = str(getattr(error, "orig", None) or type(error).__name__)
        raise StorageError(f"The database does not answer: {words}.") from error
