"""Answers of devices to set-points, and devices that cannot be used since."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import unquote

import pandas as pd
import sqlalchemy as sa

from vppres.service.payloads import read_moment
from vppres.service.storage.records import Lost, asks, dims, seconds, versions
from vppres.service.storage.steps import StoredSteps
from vppres.service.storage.tables import ACKS, LOST, UNDIMMED, put

REJECTED = "rejected"
REFUSED = (REJECTED, "aborted")
"""What devices say that did not follow their set-points."""


class StoredAnswers(StoredSteps):
    """Answers of devices to the set-points of a site's steps."""

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
                    _note_refusal(db, LOST, setpoint["asset"], said, seconds(now))
                if dims(setpoint):
                    _note_refusal(db, UNDIMMED, setpoint["asset"], said, seconds(now))

    def lost(self) -> dict[str, Lost]:
        """Customers whose device did not switch them on when it was last told to."""
        return self._refusals(LOST)

    def undimmed(self) -> dict[str, Lost]:
        """Customers whose device did not dim them when it was last told to."""
        return self._refusals(UNDIMMED)

    def _refusals(self, table: sa.Table) -> dict[str, Lost]:
        return {row.asset: Lost(row.at, row.reason) for row in self._rows(sa.select(table))}

    def acks(self, setpoints: Iterable[str]) -> dict[str, dict[str, Any]]:
        """Last status of each set-point that has one."""
        a = ACKS.c
        said = sa.select(a.setpoint, a.status, a.value, a.reason)
        rows = self._rows(said.where(a.setpoint.in_(list(setpoints))).order_by(a.number))
        return {
            row.setpoint: {"status": row.status, "value": row.value, "reason": row.reason}
            for row in rows
        }

    def rejected(self, setpoints: Iterable[str]) -> set[str]:
        """Set-points of these that devices rejected at any time: they never followed them."""
        a = ACKS.c
        found = sa.select(a.setpoint).where(a.setpoint.in_(list(setpoints)), a.status == REJECTED)
        return {*self._values(found)}

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


def _note_refusal(
    db: sa.Connection, table: sa.Table, asset: str, said: Mapping[str, Any], at: int
) -> None:
    """A customer that could not be switched on, or dimmed, or was after all."""
    if said["status"] in REFUSED:
        put(db, table, asset=asset, at=at, reason=why_refused(said))
    else:
        db.execute(table.delete().where(table.c.asset == asset))


def why_refused(said: Mapping[str, Any]) -> str:
    """Refusal of a device in words."""
    return f"{said['status']}: {said['reason']}" if said["reason"] else str(said["status"])
