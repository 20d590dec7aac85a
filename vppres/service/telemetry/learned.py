"""Measured series of a site, step by step, for a forecaster.

Each decided step leaves a row in a table of its own. Where there is none yet, as when a forecaster
is chosen for a service that ran without one, the rows are made of the readings that are kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.plain import json_safe
from vppres.live.controller import Controller
from vppres.live.past import REMEMBERED_DAYS
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.storage.records import Measured, moment, seconds
from vppres.service.storage.store import Store

QUANTITIES = ("load_kw", "pv_kw")


def measured_in(controller: Controller) -> Measured | None:
    """The row of the step that was decided last; None where no forecaster learns from it."""
    last = controller.measured
    return _row(last.start, last.load_kw[0], last.pv_kw[0]) if last else None


def learned(store: Store, scenario: Scenario, now: pd.Timestamp) -> History | None:
    """Measurements up to a time, after the site's own history; None if there are none.

    What is made of readings is kept in the store, so that it stays as it is.
    """
    since = now - pd.Timedelta(days=REMEMBERED_DAYS)
    rows = store.measured(since)
    if not rows:
        # The present step may have been decided before this forecaster was chosen.
        rows = _read(store, scenario, since, now + scenario.grid.step)
        store.put_measured(rows)
    before = scenario.history
    if before:
        before = before.in_steps_of(scenario.grid.step_minutes)
    if not rows:
        return before
    start = moment(rows[0].time)
    step = scenario.grid.step
    n_steps = round((moment(rows[-1].time) - start) / step) + 1
    places = [round((moment(row.time) - start) / step) for row in rows]
    load_kw = _laid(places, [row.load_kw for row in rows], n_steps)
    pv_kw = _laid(places, [row.pv_kw for row in rows], n_steps)
    grid = scenario.grid
    if not before or before.end < since:
        return History(start, grid.step_minutes, load_kw, pv_kw, zone=grid.zone)
    return before.followed_by(start, load_kw, pv_kw).last_days(REMEMBERED_DAYS)


class InSteps:
    """Readings of a time, the first of each step in which one was taken."""

    def __init__(self, store: Store, grid: TimeGrid) -> None:
        step = grid.step
        self._first: dict[tuple[str, str, int], float] = {}
        for reading in store.between(grid.start, grid.end, ("soc", *QUANTITIES)):
            t = (moment(reading.time) - grid.start) // step
            if reading.known:
                self._first.setdefault((reading.quantity, reading.asset, t), reading.value)

    def laid(self, quantity: str, ids: Names, series: Floats) -> Floats:
        """A series (T, items) with what was measured in its place."""
        found = series.copy()
        places = {str(name): i for i, name in enumerate(ids)}
        for (kind, asset, t), value in self._first.items():
            if kind == quantity and asset in places:
                found[t, places[asset]] = value
        return found


def _read(
    store: Store, scenario: Scenario, since: pd.Timestamp, end: pd.Timestamp
) -> list[Measured]:
    """Rows of the steps up to a time in which anything was read."""
    step = scenario.grid.step
    n_steps = (end - since) // step
    grid = replace(scenario.grid, start=end - n_steps * step, n_steps=n_steps)
    readings = InSteps(store, grid)
    load_kw, pv_kw = (
        readings.laid(quantity, ids, np.full((n_steps, len(ids)), np.nan))
        for quantity, ids in zip(QUANTITIES, (scenario.customers.id, scenario.pv.id), strict=True)
    )
    known = np.isfinite(np.hstack([load_kw, pv_kw])).any(axis=1)
    return [_row(grid.times[t], load_kw[t], pv_kw[t]) for t in np.flatnonzero(known).tolist()]


def _row(time: pd.Timestamp, load_kw: Floats, pv_kw: Floats) -> Measured:
    """Row of what was measured in a step."""
    return Measured(seconds(time), json_safe(load_kw.tolist()), json_safe(pv_kw.tolist()))


def _laid(places: list[int], rows: list[list[float | None]], n_steps: int) -> Floats:
    """Rows in their places, NaN in between and for what is not known, (n, items)."""
    values = np.array(rows, dtype=float)
    found = np.full((n_steps, values.shape[1]), np.nan)
    found[places] = values
    return found
