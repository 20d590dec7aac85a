"""The steps that a decision looks at, and what is expected of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from vppres.control.guard.series import FAR
from vppres.core.arrays import Flags, Floats
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean
from vppres.live.controller import Controller
from vppres.live.ranges import ranges_of
from vppres.scenario.scenario import Scenario
from vppres.service.payloads import Forecasts, Prices, Quantiles

CAUTIOUS = {"load_kw": "p90", "pv_kw": "p10"}
"""Quantiles that stand in for what has been silent for too long."""


@dataclass(frozen=True, eq=False)
class Window:
    """The steps that a decision looks at."""

    times: pd.DatetimeIndex
    length: pd.Timedelta
    series: Mapping[str, Floats]

    @classmethod
    def of(cls, controller: Controller, time: pd.Timestamp) -> Window:
        """The steps that a controller's decision looks at."""
        times = controller.ahead(time)
        scenario = controller.scenario
        inside = (scenario.grid.times >= times[0]) & (scenario.grid.times <= times[-1])
        series = {name: values[inside] for name, values in scenario.series.items()}
        return cls(times, scenario.grid.step, series)

    def touched(self, start: pd.Timestamp, end: pd.Timestamp) -> Flags:
        """Which steps an interval touches, (W,)."""
        return np.asarray((self.times + self.length > start) & (self.times < end))

    def lay(
        self, series: Floats, bodies: Iterable[tuple[Prices | Forecasts, Sequence[float]]]
    ) -> None:
        """Put the mean of what bodies say of each step in a series' place; a later one counts.

        A step of which none says anything stays, and time of it that none covers does not count.
        """
        step_s = self.length.total_seconds()
        steps_s = self.times[0].timestamp() + step_s * np.arange(len(self.times) + 1)
        pieces = [
            (start + each * np.arange(len(values) + 1), values)
            for body, values in bodies
            for start, each in [(body.start.timestamp(), body.resolution.total_seconds())]
            if start < steps_s[-1] and start + each * len(values) > steps_s[0]
        ]
        edges_s = np.unique(np.concatenate([steps_s, *(ends for ends, _ in pieces)]))
        said = np.full(len(edges_s) - 1, np.nan)
        for ends_s, values in pieces:
            places = np.searchsorted(edges_s, ends_s)
            said[places[0] : places[-1]] = np.repeat(values, np.diff(places))
        held_s = np.diff(edges_s)
        bounds = np.searchsorted(edges_s, steps_s)
        for row, (first, after) in enumerate(pairwise(bounds)):
            known = np.flatnonzero(~np.isnan(said[first:after])) + first
            if len(known):
                alike = np.ptp(said[known]) == 0.0
                mean = np.average(said[known], weights=held_s[known])
                series[row] = said[known[0]] if alike else mean

    def expected(
        self,
        quantity: str,
        ids: Iterable[Any],
        forecast: Forecasts | None,
        lost: Iterable[str] = (),
    ) -> tuple[Floats, list[str]]:
        """Expected values, (W, items), and lost items for which they are cautious.

        Over the ``forecast``, the one that was issued last, stands nothing, and under it the
        profile. Those that are ``lost`` have been silent for too long.
        """
        table = self.series[quantity].copy()
        columns = {str(name): column for column, name in enumerate(ids)}
        silent = set(lost)
        cautious = list[str]()
        if not forecast:
            return table, cautious
        for name, quantiles in forecast.assets.items():
            if name not in columns:
                continue
            careful = getattr(quantiles, CAUTIOUS[quantity]) if name in silent else None
            if careful:
                cautious.append(name)
            self.lay(table[:, columns[name]], [(forecast, careful or quantiles.p50)])
        return table, cautious


def check_forecast(
    quantity: str, assets: Mapping[str, Quantiles], of: Scenario, read_kw: Mapping[str, float]
) -> None:
    """Whether a forecast is of the site, and of what its devices can do.

    ``read_kw`` are the last readings of demand.

    Raises
    ------
    InputError
        With everything that is not.
    """
    known = [str(name) for name in (of.customers if quantity == "load_kw" else of.pv).id]
    problems = [
        Problem("forecast", "is not at the site", did_you_mean(name, known, "Leave it out."))
        for name in assets
        if name not in known
    ]
    problems += _beyond_ratings(quantity, assets, of)
    if quantity == "load_kw":
        problems += _far_from_demand(assets, of, read_kw)
    if problems:
        raise InputError(problems)


def _beyond_ratings(
    quantity: str, assets: Mapping[str, Quantiles], of: Scenario
) -> Iterator[Problem]:
    """Devices of which more is expected than a reading of theirs may say."""
    own = ranges_of(of)
    for name, quantiles in assets.items():
        permitted = own.get((quantity, name))
        most_kw = _most_kw(quantiles)
        if permitted and not permitted.holds(most_kw):
            field = f"{quantity} of {name}"
            yield Problem(
                "forecast", permitted.text(most_kw), permitted.cure, field=field, value=most_kw
            )


def _far_from_demand(
    assets: Mapping[str, Quantiles], of: Scenario, read_kw: Mapping[str, float]
) -> Iterator[Problem]:
    """Customers of which so much is expected that it must be in another unit."""
    for name, profile_kw in zip(map(str, of.customers.id), of.load_kw.max(axis=0), strict=True):
        usual_kw = max(profile_kw, read_kw.get(name, 0.0))
        if name in assets and profile_kw > 0.0 and _most_kw(assets[name]) > FAR * usual_kw:
            message = f"is more than {FAR:g} times all that was read or is in the profile"
            field, cure = f"load_kw of {name}", "Give the power in kW."
            yield Problem("forecast", message, cure, field=field, value=_most_kw(assets[name]))


def _most_kw(quantiles: Quantiles) -> float:
    return max(max(row) for row in (quantiles.p50, quantiles.p90) if row)
