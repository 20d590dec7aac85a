"""Measured series of a site, step by step, for a forecaster.

Each decided step leaves a row in a table of its own. Where there is none yet, as when a forecaster
is chosen for a service that ran without one, the rows are made of the readings that are kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.live.past import REMEMBERED_DAYS
from vppres.scenario.history import History
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.storage.records import moment
from vppres.service.storage.store import Store

QUANTITIES = ("load_kw", "pv_kw")


def learned(store: Store, scenario: Scenario, now: pd.Timestamp) -> History | None:
    """Measurements up to a time, after the site's own history; None if there are none.

    What is made of readings is kept in the store, so that it stays as it is.
    """
    since = now - pd.Timedelta(days=REMEMBERED_DAYS)
    found = store.measured(since, scenario.grid)
    if not found:
        # The present step may have been decided before this forecaster was chosen.
        store.put_measured(_read(store, scenario, since, now + scenario.grid.step))
        found = store.measured(since, scenario.grid)
    before = scenario.history
    if before:
        before = before.in_steps_of(scenario.grid.step_minutes)
    if not found:
        return before
    if not before or before.end < since:
        return found
    return before.followed_by(found.start, found.load_kw, found.pv_kw).last_days(REMEMBERED_DAYS)


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


def _read(store: Store, scenario: Scenario, since: pd.Timestamp, end: pd.Timestamp) -> History:
    """Readings of the steps up to a time."""
    step = scenario.grid.step
    n_steps = (end - since) // step
    grid = replace(scenario.grid, start=end - n_steps * step, n_steps=n_steps)
    readings = InSteps(store, grid)
    load_kw, pv_kw = (
        readings.laid(quantity, ids, np.full((n_steps, len(ids)), np.nan))
        for quantity, ids in zip(QUANTITIES, (scenario.customers.id, scenario.pv.id), strict=True)
    )
    return History(grid.start, grid.step_minutes, load_kw, pv_kw, zone=grid.zone)
