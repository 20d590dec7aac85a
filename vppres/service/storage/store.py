"""Store of readings, events and plans: one transaction a step, before anything is sent."""

from __future__ import annotations

import json
import threading
import time as machine
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import starmap
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pandas as pd
import sqlalchemy as sa

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, StorageError
from vppres.scenario.history import History
from vppres.scenario.timegrid import TimeGrid
from vppres.service.clock import written
from vppres.service.payloads import Forecasts, read_moment
from vppres.service.storage.database import opened_database
from vppres.service.storage.records import (
    After,
    AlarmRow,
    Asked,
    ChangedError,
    Event,
    Lost,
    Reading,
    Token,
    UnknownError,
    Written,
    asks,
    dims,
    moment,
    seconds,
    versions,
)
from vppres.service.storage.statements import (
    REFUSED,
    REJECTED,
    alarm_of,
    as_text,
    count_steps,
    last_readings,
    note,
    note_refusal,
    put,
    put_alarm,
    put_event,
    put_measured,
    tag_of,
    upserting,
)
from vppres.service.storage.tables import (
    ACKS,
    ALARMS,
    AUDIT,
    CONTACTS,
    EVENTS,
    FORECASTS,
    HEARD_OF,
    KEYS,
    LOST,
    MEASURED,
    META,
    OUTCOMES,
    STATES,
    STEPS,
    TABLES,
    TELEMETRY,
    TOKENS,
    UNDIMMED,
)

LAYOUT = "1"
STATES_KEPT = 3
TRIED_S = 5.0
"""For how long the database is as it was when it was last written to."""

COMPACT = (",", ":")
COUNTED = {"preserve_rowcount": True}


class Store:
    """The database of one site, which belongs to that site alone.

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
        self._trying = threading.Lock()
        self._takes = not reading
        self._tried_at = -TRIED_S
        self.changes = 0  # a reader of what is stored looks again when it has grown
        self._events_known: tuple[int, dict[str, list[Event]]] = (-1, {})
        self._event_changes = 0
        if not reading:
            with _plain_errors():
                TABLES.create_all(self._engine)
        self._belongs_to(site)
        # Assets and quantities that were ever received.
        self._items = {(row.asset, row.quantity) for row in self._rows(sa.select(HEARD_OF))}

    @property
    def place(self) -> str:
        """Address of the database, without a password."""
        return self._database.name

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def ready(self) -> bool:
        """Whether the database takes a transaction; tried now and then, however often it is asked.

        A reader that asks while it is tried gets the time before.
        """
        if self._trying.acquire(blocking=False):
            try:
                if machine.monotonic() - self._tried_at > TRIED_S:
                    with suppress(StorageError), self._changes(routine=True) as db:
                        put(db, META, key="checked", value="")
            finally:
                self._trying.release()
        return self._takes

    # Telemetry

    def write_readings(
        self, readings: Iterable[Reading], now: pd.Timestamp, actor: str | None = None
    ) -> Written:
        """Keep readings; those that are there with the same value count as duplicates."""
        rows = [{**vars(one), "value": one.value if one.known else None} for one in readings]
        if not rows:
            return Written(0, 0)
        with self._changes(routine=True) as db:
            written = upserting(db, TELEMETRY, "value")
            accepted = db.execute(written, rows, execution_options=COUNTED).rowcount
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
        found = self._readings(last_readings(seconds(until), quantities, known))
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

    def _readings(self, chosen: Any) -> list[Reading]:
        # NULL is a missing value.
        return [
            Reading(asset, quantity, time, source, long, np.nan if value is None else value)
            for asset, quantity, time, source, long, value in self._rows(chosen)
        ]

    def contacts(self) -> dict[str, int]:
        """When each source was last heard from."""
        return {row.source: row.last_contact for row in self._rows(sa.select(CONTACTS))}

    # Events and forecasts

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
                name: put_event(db, name, body, now, replacing) for name, body in bodies.items()
            }
            for name, body in bodies.items():
                action = "event" if body else "event withdrawn"
                note(db, now, actor, action, f"{name} {as_text(body) if body else ''}")
        self._event_changes += 1
        return found

    def events(self) -> dict[str, Event]:
        """The latest version of each event that holds."""
        last = {name: each[-1] for name, each in self.events_ever().items()}
        return {name: event for name, event in last.items() if event.body}

    def events_ever(self) -> dict[str, list[Event]]:
        """All versions of every event that are kept, in their order; without body if withdrawn."""
        # Nothing else writes here, so that what was read holds until an event changes.
        seen = self._event_changes
        if self._events_known[0] != seen or self._reading:
            chosen = sa.select(EVENTS).order_by(EVENTS.c.id, EVENTS.c.version)
            found: dict[str, list[Event]] = {}
            for row in self._rows(chosen):
                earlier = found.setdefault(row.id, [])
                goes_on = earlier and earlier[-1].body
                since = earlier[-1].since if goes_on else row.made_at
                body = json.loads(row.body) if row.body else {}
                earlier.append(Event(row.version, body, row.made_at, since))
            self._events_known = seen, found
        return self._events_known[1]

    def put_forecast(
        self, quantity: str, body: dict[str, Any], now: pd.Timestamp, actor: str
    ) -> None:
        """Keep a forecast beside older ones; parts that were issued together are one."""
        key = {"quantity": quantity, "issued_at": seconds(pd.Timestamp(body["issued_at"]))}
        before = self._body(sa.select(FORECASTS.c.body).filter_by(**key))
        if all(before.get(name) == body[name] for name in ("start", "resolution")):
            body = {**body, "assets": before["assets"] | body["assets"]}
        with self._changes() as db:
            put(db, FORECASTS, **key, body=json.dumps(body, sort_keys=True))
            note(db, now, actor, "forecast", f"{quantity} {body['issued_at']}")

    def forecast(self, quantity: str, now: pd.Timestamp) -> Forecasts | None:
        """The forecast that was issued last, up to now."""
        f = FORECASTS.c
        issued = sa.select(f.body).where(f.quantity == quantity, f.issued_at <= seconds(now))
        body = self._body(issued.order_by(f.issued_at.desc()).limit(1))
        return Forecasts.model_validate(body) if body else None

    # Steps

    def write_step(
        self,
        time: pd.Timestamp,
        plan: dict[str, Any],
        after: After | None = None,
        asked: Asked | None = None,
    ) -> None:
        """Keep a step's plan, and the controller's state after it if it decided: all or nothing."""
        at = seconds(time)
        with self._changes() as db:
            text = json.dumps(plan, allow_nan=False, separators=COMPACT)
            was = db.execute(sa.select(STEPS.c.outcome).where(STEPS.c.time == at)).scalar()
            put(db, STEPS, time=at, outcome=plan["status"], plan=text)
            if was is not None:  # decided anew: a step counts once
                count_steps(db, was, -1)
            count_steps(db, plan["status"], 1)
            if after:
                put(db, STATES, time=at, state=after.state)
                newest = sa.select(STATES.c.time).order_by(STATES.c.time.desc())
                kept = newest.limit(STATES_KEPT).scalar_subquery()
                db.execute(STATES.delete().where(STATES.c.time.not_in(kept)))
                if after.measured:
                    put_measured(db, after.measured)
            if asked:
                note(db, asked.at, asked.actor, "step", f"{plan['id']} {plan['status']}")

    def step(self, time: pd.Timestamp) -> dict[str, Any]:
        """The plan of a step, empty if it is none of ours."""
        return self._body(sa.select(STEPS.c.plan).where(STEPS.c.time == seconds(time)))

    def last_step(self, until: pd.Timestamp | None = None) -> dict[str, Any]:
        """The plan of the last step, or of the last one up to a time; empty if there is none."""
        chosen = sa.select(STEPS.c.plan).order_by(STEPS.c.time.desc()).limit(1)
        if until:
            chosen = chosen.where(STEPS.c.time <= seconds(until))
        return self._body(chosen)

    def plans(self, since: pd.Timestamp, until: pd.Timestamp | None = None) -> list[dict[str, Any]]:
        """The plans of the steps that begin from a time on, and before another one."""
        chosen = sa.select(STEPS.c.plan).where(STEPS.c.time >= seconds(since))
        if until:
            chosen = chosen.where(STEPS.c.time < seconds(until))
        return [json.loads(text) for (text,) in self._rows(chosen.order_by(STEPS.c.time))]

    def _body(self, chosen: Any) -> dict[str, Any]:
        """Stored JSON of a row; empty if there is no such row."""
        return next((json.loads(text) for (text,) in self._rows(chosen)), {})

    def outcomes(self) -> dict[str, int]:
        """How many steps there were of each outcome, those included that are forgotten."""
        return {row.outcome: row.steps for row in self._rows(sa.select(OUTCOMES))}

    def states(self) -> list[str]:
        """The controller's states that are kept, the last one first, as they were written."""
        chosen = sa.select(STATES.c.state).order_by(STATES.c.time.desc())
        return [text for (text,) in self._rows(chosen)]

    def withdraw(self, since: pd.Timestamp, now: pd.Timestamp, reason: str) -> None:
        """Take back the steps from a time on, with all that came of them."""
        with self._changes() as db:
            gone = 0
            for table in (STATES, MEASURED, STEPS):
                gone = db.execute(table.delete().where(table.c.time >= seconds(since))).rowcount
            note(db, now, "clock", "steps withdrawn", f"{gone} from {written(since)} on: {reason}")

    def put_measured(self, measured: History) -> None:
        """Keep the steps in which anything was measured."""
        with self._changes(routine=True) as db:
            put_measured(db, measured)

    def measured(self, since: pd.Timestamp, grid: TimeGrid) -> History | None:
        """Measurements of the steps from a time on; None if there are none."""
        m = MEASURED.c
        rows = self._rows(sa.select(MEASURED).where(m.time >= seconds(since)).order_by(m.time))
        if not rows:
            return None
        start = moment(rows[0].time)
        places = [round((moment(row.time) - start) / grid.step) for row in rows]

        def laid(kept: Iterable[str]) -> Floats:
            values = np.array([json.loads(kw) for kw in kept], dtype=float)
            found = np.full((places[-1] + 1, values.shape[1]), np.nan)
            found[places] = values
            return found

        load_kw, pv_kw = laid(row.load_kw for row in rows), laid(row.pv_kw for row in rows)
        return History(start, grid.step_minutes, load_kw, pv_kw, zone=grid.zone)

    def step_of_key(self, key: str, time: pd.Timestamp) -> pd.Timestamp:
        """The step that was asked for with a key: the first one, whatever is asked for now."""
        with self._changes() as db:
            found = db.execute(sa.select(KEYS.c.time).where(KEYS.c.key == key)).scalar()
            if found is None:
                db.execute(KEYS.insert().values(key=key, time=seconds(time)))
        return time if found is None else moment(found)

    def forget(self, before: pd.Timestamp, learned_before: pd.Timestamp) -> None:
        """Drop what is older: readings, steps, forecasts, acknowledgements, events and alarms.

        What holds stays, however old it is, and so does the audit; what a forecaster learns from
        has a time of its own.
        """
        at = seconds(before)
        f = FORECASTS.c
        newest = sa.select(sa.func.max(f.issued_at)).group_by(f.quantity)
        e = EVENTS.c
        later = EVENTS.alias("later")
        replaced = sa.exists().where(later.c.id == e.id, later.c.version > e.version)
        with self._changes(routine=True) as db:
            db.execute(TELEMETRY.delete().where(TELEMETRY.c.time < at))
            db.execute(STEPS.delete().where(STEPS.c.time < at))
            db.execute(MEASURED.delete().where(MEASURED.c.time < seconds(learned_before)))
            db.execute(KEYS.delete().where(KEYS.c.time < at))
            db.execute(ACKS.delete().where(ACKS.c.at < at))
            db.execute(FORECASTS.delete().where(f.issued_at < at, f.issued_at.not_in(newest)))
            db.execute(ALARMS.delete().where(ALARMS.c.cleared_at < at))
            db.execute(EVENTS.delete().where(e.made_at < at, sa.or_(replaced, e.body.is_(None))))
        self._event_changes += 1

    # Acknowledgements

    def put_ack(
        self, setpoint: Mapping[str, Any], said: Mapping[str, Any], now: pd.Timestamp, actor: str
    ) -> None:
        """Keep what became of a set-point; what was said last is not kept twice."""
        values = {name: setpoint[name] for name in ("kind", "asset")}
        with self._changes() as db:
            a = ACKS.c
            last = (
                sa.select(a.status, a.value, a.reason)
                .where(a.setpoint == setpoint["id"])
                .order_by(a.number.desc())
                .limit(1)
            )
            before = db.execute(last).first()
            if not before or before._asdict() != dict(said):
                row = {"setpoint": setpoint["id"], "at": seconds(now), "actor": actor, **values}
                db.execute(ACKS.insert().values(**row, **said))
                # One that is on, dimmed, can be supplied; one that rejects to be dimmed too.
                if asks(setpoint) or (setpoint.get("served") and said["status"] not in REFUSED):
                    note_refusal(db, LOST, setpoint["asset"], said, seconds(now))
                if dims(setpoint):
                    note_refusal(db, UNDIMMED, setpoint["asset"], said, seconds(now))

    def lost(self) -> dict[str, Lost]:
        """Customers whose device did not switch them on when it was last told to."""
        return {row.asset: Lost(row.at, row.reason) for row in self._rows(sa.select(LOST))}

    def undimmed(self) -> dict[str, Lost]:
        """Customers whose device did not dim them when it was last told to."""
        return {row.asset: Lost(row.at, row.reason) for row in self._rows(sa.select(UNDIMMED))}

    def acks(self, setpoints: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Last status of each set-point that has one."""
        a = ACKS.c
        chosen = sa.select(ACKS).where(a.setpoint.in_(list(setpoints))).order_by(a.number)
        return {
            row.setpoint: {"status": row.status, "value": row.value, "reason": row.reason}
            for row in self._rows(chosen)
        }

    def rejected(self, setpoints: Iterable[str]) -> set[str]:
        """Set-points of these that devices rejected at any time: they never followed them."""
        a = ACKS.c
        found = sa.select(a.setpoint).where(a.setpoint.in_(list(setpoints)), a.status == REJECTED)
        return {row.setpoint for row in self._rows(found)}

    def refusing(self, kind: str) -> dict[str, int]:
        """Devices of a kind that rejected what they were asked for last, and since when."""
        a = ACKS.c
        last = sa.select(sa.func.max(a.number)).where(a.kind == kind).group_by(a.asset)
        refused = a.number.in_(last.scalar_subquery()), a.status.in_(REFUSED)
        rows = self._rows(sa.select(a.asset, a.at, a.setpoint).where(*refused))
        points = ((row, self.setpoint(row.setpoint)) for row in rows)
        return {row.asset: row.at for row, one in points if one is None or asks(one)}

    def setpoint(self, identifier: str) -> dict[str, Any] | None:
        """A set-point by its identifier, as it is or as in an address; None if there is none."""
        try:
            time = read_moment(identifier.partition("/")[0])
        except ValueError:
            return None
        said = [one for plan in versions(self.last_step(time)) for one in plan.get("setpoints", ())]
        return next((o for o in said if identifier in (o["id"], unquote(o["id"]))), None)

    # Alarms

    def write_alarms(self, rows: Iterable[AlarmRow]) -> list[AlarmRow]:
        """Keep alarms, new ones and changed ones; as they are kept, with their numbers."""
        with self._changes() as db:
            return [put_alarm(db, row) for row in rows]

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
        return alarm_of(row)

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
        found = self._alarms(chosen.order_by(a.number.desc()).limit(1))
        return found[0] if found else None

    def _alarms(self, chosen: Any) -> list[AlarmRow]:
        return [alarm_of(row) for row in self._rows(chosen)]

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
            before = db.execute(sa.select(META.c.value).where(META.c.key == name)).scalar()
            if replacing is not None and replacing != tag_of(before):
                raise ChangedError(f"The {key} has changed since.")
            text = json.dumps(value, sort_keys=True)
            put(db, META, key=name, value=text)
            note(db, now, actor, key, text)
        return tag_of(text)

    def setting(self, key: str) -> tuple[Any, str]:
        """A setting, empty if there is none, and its tag."""
        chosen = sa.select(META.c.value).where(META.c.key == f"setting.{key}")
        text = next((row.value for row in self._rows(chosen)), None)
        return (json.loads(text) if text else {}), tag_of(text)

    def add_token(self, token: Token, now: pd.Timestamp) -> None:
        """Add a token, instead of the one that had the name."""
        with self._changes() as db:
            put(db, TOKENS, **vars(token))
            note(db, now, "command line", "token", f"{token.name} {token.scopes}")

    def remove_token(self, name: str, now: pd.Timestamp) -> bool:
        """Remove a token; whether there was such a token."""
        with self._changes() as db:
            found = bool(db.execute(TOKENS.delete().where(TOKENS.c.name == name)).rowcount)
            if found:
                note(db, now, "command line", "token removed", name)
        return found

    def tokens(self) -> list[Token]:
        """All tokens."""
        return list(starmap(Token, self._rows(sa.select(TOKENS).order_by(TOKENS.c.name))))

    def audit(self) -> list[tuple[str, str, str]]:
        """Audit log in order: actor, action, detail."""
        a = AUDIT.c
        chosen = sa.select(a.actor, a.action, a.detail).order_by(a.number)
        return [tuple(row) for row in self._rows(chosen)]

    def _belongs_to(self, site: str) -> None:
        """Refuse the database of another site or layout; a new one is this site's."""
        wanted = {"layout": LAYOUT, "site": site}
        known = {row.key: row.value for row in self._rows(sa.select(META))}
        missing = {key: value for key, value in wanted.items() if key not in known}
        if missing and not self._reading:
            with self._changes() as db:
                for key, value in missing.items():
                    put(db, META, key=key, value=value)
        for key, value in wanted.items():
            if known.get(key, value) != value:
                self.close()
                message = f"holds the state of another {key}"
                cure = "Give another place with --state, or remove this one."
                place = {"field": key, "value": known[key][:12]}
                raise InputError.of(self._database.name, message, cure, **place)

    @contextmanager
    def _changes(self, routine: bool = False) -> Iterator[sa.Connection]:
        """A transaction that writes; what is routine need not be seen at once."""
        try:
            with self._writing:
                with _plain_errors(), self._engine.begin() as db:
                    self._database.check(db)
                    yield db
                self.changes += not routine
        except StorageError:
            self._takes = False
            raise
        finally:
            self._tried_at = machine.monotonic()
        self._takes = True

    def _rows(self, chosen: Any) -> list[Any]:
        with _plain_errors(), self._engine.connect() as db:
            return list(db.execute(chosen))


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Translate errors of the database into those of vppres."""
    try:
        yield
    except sa.exc.SQLAlchemyError as error:
        words = str(getattr(error, "orig", None) or type(error).__name__)
        raise StorageError(f"The database does not answer: {words}.") from error
