"""A reading that the grid is lost: what contradicts it, and whether it stands alone."""

from __future__ import annotations

import pandas as pd

from vppres.control.guard.balance import tolerance_kw
from vppres.kinds.kind import EARLY_SHARE
from vppres.live.by_phase import GRID
from vppres.service.clock import written
from vppres.service.events.announced import announced_at
from vppres.service.storage.records import Reading, moment, seconds
from vppres.service.storage.store import Store

LIMIT = "limit"
"""Who says that there is no grid where one is read, of which nothing may be imported."""

GRID_ON, IMPORT = "grid_on", "import_kw"

AGAIN_S = 10
"""Within which a reading that stands alone is to be sent again."""

BACK_STEPS = 24
"""Steps over which a source is followed back to when it began to say that the grid is lost."""

DUE = 2
"""Multiples of its time after which the next reading of an import is overdue."""

CONTRADICTED = "grid_on = 0 of {} is contradicted by"

FED_SHARE = 0.1
"""An import of more than this share of the demand feeds it; losses of an island are less."""


def contradiction(
    zero: Reading | None, now: pd.Timestamp, step: pd.Timedelta, store: Store, demand_kw: float
) -> str:
    """Contradiction of a reading that the grid is lost; empty if there is none.

    Another source that sees it at that time or later; an import of that time or later, of more than
    meters are off by; or one that feeds the site while the source says already that the grid is
    lost, the last one and while the next is not overdue. To count on a grid that is lost is the
    worse mistake.
    """
    if not zero or zero.value != 0.0:
        return ""
    end = now + EARLY_SHARE * step
    told = CONTRADICTED.format(zero.source)
    for one in store.between(moment(zero.time), end, (GRID_ON,)):
        if one.source != zero.source and one.value == 1.0:
            return f"{told} {one.source}"
    imports = imports_since(began(zero, step, store), end, store)
    if not imports:
        return ""
    last = imports[-1]
    kw, off_kw = abs(last.value), tolerance_kw(demand_kw)
    if last.time < zero.time:
        off_kw = max(off_kw, FED_SHARE * demand_kw)
        if seconds(now) > last.time + DUE * last.resolution_s:
            return ""
    return f"{told} an import of {last.value:g} kW" if kw > off_kw else ""


def stands_alone(zero: Reading | None, now: pd.Timestamp, step: pd.Timedelta, store: Store) -> str:
    """Request to confirm a reading that the grid is lost; empty if another reading confirms it.

    Neither announced, nor said by another source or twice by the same one, nor followed by an
    import that was measured.
    """
    if not zero or zero.value != 0.0 or began(zero, step, store) < moment(zero.time):
        return ""
    end = now + EARLY_SHARE * step
    others = store.between(moment(zero.time) - EARLY_SHARE * step, end, (GRID_ON,))
    borne_out = any(one.source != zero.source and one.value == 0.0 for one in others)
    announced = announced_at([*store.events().values()], moment(zero.time))
    if borne_out or announced or imports_since(moment(zero.time), end, store):
        return ""
    return (
        f"grid_on = 0 of {zero.source} at {written(moment(zero.time))} stands alone: send grid_on "
        f"again within {AGAIN_S} s, and import_kw since then"
    )


def imports_since(begin: pd.Timestamp, end: pd.Timestamp, store: Store) -> list[Reading]:
    """Imports that were measured after a time, up to another, the last one last."""
    found = store.between(begin, end, (IMPORT,))
    return [
        one
        for one in found
        if one.asset == GRID and one.known and one.time + one.resolution_s <= seconds(end)
    ]


def began(zero: Reading, step: pd.Timedelta, store: Store) -> pd.Timestamp:
    """When a source began to say that the grid is lost, as far as it is looked back."""
    latest = moment(zero.time)
    said = [
        one
        for one in store.between(latest - BACK_STEPS * step, latest, (GRID_ON,))
        if one.source == zero.source and one.known
    ]
    since = zero
    for one in reversed(said):
        if one.value != 0.0:
            break
        since = one
    return moment(since.time)


def lost_now(now: pd.Timestamp, step: pd.Timedelta, store: Store) -> Reading | None:
    """The last reading of the grid, if it says that it is lost."""
    end = now + EARLY_SHARE * step
    found = [one for one in store.latest(end, (GRID_ON,)) if one.asset == GRID]
    return found[0] if found and found[0].value == 0.0 else None
