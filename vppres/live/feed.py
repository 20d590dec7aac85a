"""Series that a live controller is fed with as time goes, checked and appended to what it knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, VppresError
from vppres.kinds.table import SERIES
from vppres.live.door import Door, moment_of, readable
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

WHERE = "feed"

LAST_KNOWN = ("temperature_c", "export_limit_kw", "export_price_gbp_per_kwh")
"""Series that need not be given: they stay as they are."""

MOST_STEPS = 366 * 1440
"""As many as the longest scenario has: a year of minutes."""


@dataclass(frozen=True, eq=False)
class Feed:
    """Series of the steps to come, each with a time index.

    Parameters
    ----------
    load_kw : DataFrame
        Demand, one column per customer.
    price_gbp_per_kwh : Series
        Import price.
    pv_kw : DataFrame, optional
        Available power, one column per PV system; needed where there are any.
    grid_limit_kw : Series, optional
        Largest import, 0 in an outage; no limit if not given.
    temperature_c : Series, optional
        Ambient temperature; the last known one if not given.
    export_limit_kw, export_price_gbp_per_kwh : Series, optional
        Largest export and what it earns; the last known ones if not given.
    of_kinds : mapping of str to DataFrame, optional
        Series of kinds by name, one column per unit; needed where there are any.

    Examples
    --------
    >>> times = pd.date_range("2025-07-02", periods=2, freq="12h", tz="UTC")
    >>> Feed(pd.DataFrame({"c2": [10.0, 12.0]}, times), pd.Series([0.2, 0.3], times)).first
    Timestamp('2025-07-02 00:00:00+0000', tz='UTC')
    """

    load_kw: pd.DataFrame
    price_gbp_per_kwh: pd.Series
    pv_kw: pd.DataFrame | None = None
    grid_limit_kw: pd.Series | None = None
    temperature_c: pd.Series | None = None
    export_limit_kw: pd.Series | None = None
    export_price_gbp_per_kwh: pd.Series | None = None
    of_kinds: Mapping[str, pd.DataFrame] = field(default_factory=dict)

    @classmethod
    def of(cls, scenario: Scenario) -> Feed:
        """The series of a scenario."""
        times = scenario.grid.times
        return cls(
            load_kw=pd.DataFrame(scenario.load_kw, times, list(scenario.customers.id)),
            price_gbp_per_kwh=pd.Series(scenario.price_gbp_per_kwh, times),
            pv_kw=pd.DataFrame(scenario.pv_kw, times, list(scenario.pv.id)),
            grid_limit_kw=pd.Series(scenario.grid_limit_kw, times),
            **{name: pd.Series(_rows(scenario, name), times) for name in LAST_KNOWN},
            of_kinds={
                name: pd.DataFrame(getattr(scenario, name), times, list(ids))
                for name, ids in _units(scenario).items()
            },
        )

    @property
    def of_tables(self) -> bool:
        """Whether everything is a table, and what must be given is."""
        of_kinds: Any = self.of_kinds
        given = [getattr(self, f.name) for f in fields(self) if f.name != "of_kinds"]
        if not isinstance(of_kinds, Mapping):
            return False
        given += of_kinds.values()
        tables = all(isinstance(value, (pd.DataFrame, pd.Series, type(None))) for value in given)
        needed = isinstance(self.load_kw, pd.DataFrame) and self.price_gbp_per_kwh is not None
        return tables and needed

    @property
    def moments(self) -> list[pd.Timestamp]:
        """The times of the demand, those with an offset."""
        moments = [moment_of(time) for time in self.load_kw.index]
        return [one for one in moments if one and one.tzinfo]

    @property
    def first(self) -> pd.Timestamp | None:
        """The earliest time of the demand, None if there is none."""
        return min(self.moments, default=None)


def extended(
    scenario: Scenario, more: Feed | Scenario, earliest: int, *, replacing: bool = False
) -> Scenario:
    """A scenario with more steps at its end.

    ``earliest`` is the first step that is not decided yet. With ``replacing`` the steps may begin
    earlier, and replace the known ones from there on.

    Raises
    ------
    InputError
        For another site, gaps, overlaps, steps that are over, and with every value that is wrong.
    """
    feed = _feed_of(scenario, more)
    try:
        start = _start(scenario, feed, earliest, replacing)
        new = _read(scenario, feed, start)
    except VppresError:
        raise
    except Exception as error:  # tables may come from any caller
        raise InputError.of(
            WHERE,
            f"cannot be read: {type(error).__name__}, {readable(error)}",
            "Give plain DataFrames and Series, indexed by time.",
        ) from error
    kept = round((start - scenario.grid.start) / scenario.grid.step)
    rows: dict[str, Any] = {
        name: np.concatenate([_rows(scenario, name)[:kept], new[name]]) for name in new
    }
    return replace(
        scenario, grid=replace(scenario.grid, n_steps=len(rows["price_gbp_per_kwh"])), **rows
    )


def _feed_of(scenario: Scenario, more: Feed | Scenario) -> Feed:
    """The series, of the same site."""
    if isinstance(more, Scenario):
        if Site.of(more).key != Site.of(scenario).key:
            raise InputError.of(
                WHERE,
                "is the scenario of another site: network, assets or step differ",
                "Give a scenario with the same files but for the series.",
                field="scenario",
                value=more.name,
            )
        return Feed.of(more)
    if not isinstance(more, Feed) or not more.of_tables:
        raise InputError.of(
            WHERE,
            "is neither a Scenario nor a Feed of DataFrames and Series",
            "Give a vppres.Scenario or a vppres.Feed.",
            field="more",
            value=type(more).__name__,
        )
    return more


def _start(scenario: Scenario, feed: Feed, earliest: int, replacing: bool) -> pd.Timestamp:
    """Beginning of the new steps: the end of the known ones, or before if they may be replaced."""
    grid = scenario.grid
    first = feed.first
    if first is None:
        message = "has no row with a time and a time zone"
        cure = "Give the demand with an index of times, for example 2025-07-02T00:00Z."
    elif first > grid.end:
        message = f"leaves a gap: what is known ends at {grid.end.isoformat()}"
        cure = "Give all steps from there on."
    elif first == grid.end:
        return grid.end
    elif first < grid.start or first < _time(grid, earliest):
        message = f"goes back: the next step is {_time(grid, earliest).isoformat()}"
        cure = "Leave out what is over."
    elif not replacing:
        message = f"overlaps with what is known until {grid.end.isoformat()}"
        cure = "Leave out those steps, or give replacing=True."
    elif (first - grid.start) % grid.step != pd.Timedelta(0):
        message = "is not the beginning of a step"
        cure = f"Steps last {grid.step_minutes:g} min and begin at {grid.start.isoformat()}."
    else:
        return first
    raise InputError.of(WHERE, message, cure, field="load_kw", value=first)


def _read(scenario: Scenario, feed: Feed, start: pd.Timestamp) -> dict[str, Floats]:
    """The new rows of every series, (n, items) or (n,)."""
    grid = TimeGrid(start, scenario.grid.step_minutes, _length(scenario.grid, feed, start))
    door = Door(grid, start, where=WHERE)
    n = grid.n_steps
    empty = np.full(n, np.nan)
    customers = scenario.customers.id
    pv = scenario.pv.id
    found = {
        "load_kw": door.table(
            "load_kw", feed.load_kw, customers, np.full((n, len(customers)), np.nan)
        ),
        "pv_kw": door.table("pv_kw", feed.pv_kw, pv, np.full((n, len(pv)), np.nan)),
        "price_gbp_per_kwh": door.series("price_gbp_per_kwh", feed.price_gbp_per_kwh, empty),
        "grid_limit_kw": door.series(
            "grid_limit_kw",
            feed.grid_limit_kw,
            np.full(n, np.inf) if feed.grid_limit_kw is None else empty,
        ),
    }
    for name in LAST_KNOWN:
        given = getattr(feed, name)
        last = _rows(scenario, name)[-1]
        found[name] = door.series(name, given, np.full(n, last) if given is None else empty)
    of_kinds = _units(scenario)
    for name, units in of_kinds.items():
        nothing = np.full((n, len(units)), np.nan)
        found[name] = door.table(name, feed.of_kinds.get(name), units, nothing)
    for name in feed.of_kinds.keys() - of_kinds.keys():
        door.problem(name, "is no series of the site's units", "Leave it out.")
    if not door.problems:
        for name, values in found.items():
            ids = {"load_kw": customers, "pv_kw": pv, **of_kinds}.get(name)
            _complete(door, name, values if ids is not None else values[:, None], ids)
    door.finish()
    found["pv_kw"] = np.minimum(found["pv_kw"], scenario.pv.p_max_kw)
    return found


def _units(scenario: Scenario) -> dict[str, Names]:
    """Identifiers of the units of each series of a kind that the site has any of."""
    tables = {name: getattr(scenario, of) for name, of in SERIES.items()}
    return {name: table.id for name, table in tables.items() if len(table)}


def _length(grid: TimeGrid, feed: Feed, start: pd.Timestamp) -> int:
    """Steps from the start to the last time of the demand."""
    last = max(feed.moments)
    steps = int((last - start) // grid.step) + 1
    if steps > MOST_STEPS:
        raise InputError.of(
            WHERE,
            f"has more than {MOST_STEPS} steps",
            "Give less at once.",
            field="load_kw",
            value=last,
        )
    return steps


def _complete(door: Door, name: str, values: Floats, ids: Any) -> None:
    """No step and no identifier is left out."""
    missing = np.isnan(values)
    if ids is not None:
        for i in np.flatnonzero(missing.all(axis=0)):
            door.problem(name, "is missing", "Give every identifier a column.", of=ids[i])
        missing = missing[:, ~missing.all(axis=0)]
    for t in np.flatnonzero(missing.any(axis=1)).tolist():
        time = door.grid.times[t]
        door.problem(name, "has no value for a step", "Give every step a row.", time)


def _rows(scenario: Scenario, name: str) -> Floats:
    """A series, (T,) or (T, items), also where the scenario has one number for all steps."""
    values: Floats = getattr(scenario, name)
    return values if values.ndim else np.broadcast_to(values, scenario.grid.n_steps)


def _time(grid: TimeGrid, step: int) -> pd.Timestamp:
    return grid.start + step * grid.step
