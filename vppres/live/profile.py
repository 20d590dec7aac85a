"""A scenario's days as a profile by the clock on the wall, from which the steps of any day follow.

A site runs without end, a scenario ends. What people use, pay and produce repeats with their
clocks: a step is given what the scenario says of that time of day, and of that weekday where the
scenario has all of them. Steps are equally long in UTC; a day of 23 hours skips what the clocks
skip, a day of 25 has its hour twice. Outages do not repeat: they are events.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import InputError
from vppres.scenario.scenario import Scenario

DAY_MINUTES = 1440
WEEK = 7


@dataclass(frozen=True, eq=False)
class ClockProfile:
    """Series by the clock.

    Examples
    --------
    >>> import vppres
    >>> profile = ClockProfile.of(vppres.load_scenario("uk-heatwave-2022"))
    >>> night = profile.steps(pd.Timestamp("2026-01-31T22:00Z"), 4)
    >>> night.grid.times[2].isoformat(), night.load_kw.shape, night.outage.any()
    ('2026-02-01T00:00:00+00:00', (4, 32), np.False_)
    """

    scenario: Scenario  #: the site
    minutes: Wholes  #: minutes since local midnight, or since that of Monday, rising, (K,)
    series: dict[str, Floats]  #: what holds from each of them on, (K, ...)
    weekly: bool  #: whether weekdays differ

    @classmethod
    def of(cls, scenario: Scenario) -> ClockProfile:
        """The profile of a scenario's days; times that it has more than once are averaged.

        Raises
        ------
        InputError
            If it does not fill a day.
        """
        grid = scenario.grid
        if grid.n_steps * grid.step_minutes < DAY_MINUTES:
            raise InputError.of(
                "site",
                "does not fill a day, which is to be repeated",
                "Give a scenario of whole days.",
                field="hours",
                value=round(grid.n_steps * grid.dt_h, 2),
            )
        weekly = grid.n_steps * grid.step_minutes >= WEEK * DAY_MINUTES
        minutes, place = np.unique(_minutes(grid.times, grid.zone, weekly), return_inverse=True)
        # Import limits are without outages, in which the least of the other limits holds.
        connected = scenario.grid_limit_kw[~scenario.outage]
        limits_kw = np.where(scenario.outage, connected.min(initial=np.inf), scenario.grid_limit_kw)
        values = {**scenario.series, "grid_limit_kw": limits_kw}
        series = {name: _means(rows, place, len(minutes)) for name, rows in values.items()}
        return cls(scenario, minutes, series, weekly)

    def steps(self, start: pd.Timestamp, n_steps: int) -> Scenario:
        """The site with the steps from a time on, which is the beginning of one.

        Raises
        ------
        InputError
            If no step begins then.
        """
        scenario = self.scenario
        begun = scenario.grid.begun(start)
        if begun != start:
            raise InputError.of(
                "site",
                "is not the beginning of a step",
                f"Steps last {scenario.grid.step_minutes:g} min; the one then began at "
                f"{begun.isoformat()}.",
                field="time",
                value=start.isoformat(),
            )
        grid = replace(scenario.grid, start=start, n_steps=n_steps)
        now = _minutes(grid.times, grid.zone, self.weekly)
        # Where the profile lacks a time, as after a change of clocks, the one before it holds.
        row = (np.searchsorted(self.minutes, now, side="right") - 1) % len(self.minutes)
        series: dict[str, Floats] = {name: rows[row] for name, rows in self.series.items()}
        return replace(
            scenario,
            grid=grid,
            history=None,
            **series,  # type: ignore[arg-type]
        )


def _minutes(times: pd.DatetimeIndex, zone: str, weekly: bool) -> Wholes:
    """Minutes since midnight, or that of Monday, on the clocks of a zone."""
    local = times.tz_convert(zone)
    minutes = local.hour * 60 + local.minute
    if weekly:
        minutes = minutes + local.dayofweek * DAY_MINUTES
    return minutes.to_numpy(dtype=np.int64)


def _means(rows: Floats, place: Wholes, n_places: int) -> Floats:
    """Mean of the rows of each place, (K, ...); a row that is alone stays as it is."""
    total = np.zeros((n_places, *rows.shape[1:]))
    np.add.at(total, place, rows)
    counts = np.bincount(place, minlength=n_places)
    return np.asarray(total / counts.reshape(-1, *[1] * (rows.ndim - 1)))
