"""Plans of steps, the controller's state behind them, and what was measured in them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa

from vppres.core.arrays import Floats
from vppres.core.plain import json_safe
from vppres.scenario.history import History
from vppres.scenario.timegrid import TimeGrid
from vppres.service.clock import written
from vppres.service.storage.records import After, Asked, moment, seconds
from vppres.service.storage.tables import KEYS, MEASURED, OUTCOMES, STATES, STEPS, note, put
from vppres.service.storage.transactions import Transactions

STATES_KEPT = 3


class StoredSteps(Transactions):
    """Steps of a site: one transaction each, before anything is sent."""

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
            was = db.execute(sa.select(STEPS.c.outcome).where(STEPS.c.time == at)).scalar()
            put(db, STEPS, time=at, outcome=plan["status"], plan=plan)
            if was is not None:  # decided anew: a step counts once
                _count(db, was, -1)
            _count(db, plan["status"], 1)
            if after:
                put(db, STATES, time=at, state=after.state)
                newest = sa.select(STATES.c.time).order_by(STATES.c.time.desc())
                kept = newest.limit(STATES_KEPT).scalar_subquery()
                db.execute(STATES.delete().where(STATES.c.time.not_in(kept)))
                if after.measured:
                    _put_measured(db, after.measured)
            if asked:
                note(db, asked.at, asked.actor, "step", f"{plan['id']} {plan['status']}")

    def step(self, time: pd.Timestamp) -> dict[str, Any]:
        """The plan of a step, empty if it is none of ours."""
        return self._plan(sa.select(STEPS.c.plan).where(STEPS.c.time == seconds(time)))

    def last_step(self, until: pd.Timestamp | None = None) -> dict[str, Any]:
        """The plan of the last step, or of the last one up to a time; empty if there is none."""
        chosen = sa.select(STEPS.c.plan).order_by(STEPS.c.time.desc()).limit(1)
        return self._plan(chosen.where(STEPS.c.time <= seconds(until)) if until else chosen)

    def _plan(self, chosen: Any) -> dict[str, Any]:
        return next(iter(self._values(chosen)), {})

    def plans(self, since: pd.Timestamp, until: pd.Timestamp | None = None) -> list[dict[str, Any]]:
        """The plans of the steps that begin from a time on, and before another one."""
        chosen = sa.select(STEPS.c.plan).where(STEPS.c.time >= seconds(since))
        if until:
            chosen = chosen.where(STEPS.c.time < seconds(until))
        return self._values(chosen.order_by(STEPS.c.time))

    def outcomes(self) -> dict[str, int]:
        """How many steps there were of each outcome, those included that are forgotten."""
        return self._mapping(sa.select(OUTCOMES))

    def states(self) -> list[str]:
        """The controller's states that are kept, the last one first, as they were written."""
        return self._values(sa.select(STATES.c.state).order_by(STATES.c.time.desc()))

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
            _put_measured(db, measured)

    def measured(self, since: pd.Timestamp, grid: TimeGrid) -> History | None:
        """Measurements of the steps from a time on; None if there are none."""
        m = MEASURED.c
        rows = self._rows(sa.select(MEASURED).where(m.time >= seconds(since)).order_by(m.time))
        if not rows:
            return None
        start = moment(rows[0].time)
        places = [round((moment(row.time) - start) / grid.step) for row in rows]

        def laid(kept: Iterable[Any]) -> Floats:
            values = np.array([*kept], dtype=float)
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


def _count(db: sa.Connection, outcome: str, more: int) -> None:
    """Count steps of an outcome."""
    o = OUTCOMES.c
    counted = db.execute(OUTCOMES.update().where(o.outcome == outcome).values(steps=o.steps + more))
    if not counted.rowcount:
        db.execute(OUTCOMES.insert().values(outcome=outcome, steps=more))


def _put_measured(db: sa.Connection, measured: History) -> None:
    """Keep the steps in which anything was measured."""
    both = measured.load_kw, measured.pv_kw
    for t in np.flatnonzero(np.isfinite(np.hstack(both)).any(axis=1)).tolist():
        load_kw, pv_kw = (json_safe(kw[t].tolist()) for kw in both)
        time = seconds(measured.start + t * measured.step)
        put(db, MEASURED, time=time, load_kw=load_kw, pv_kw=pv_kw)
