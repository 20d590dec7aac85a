"""From what is stored to the measurement of a step: what is heard, late, lost, or expected.

A reading holds for its own resolution, and for a step at least. What is older is left to the guard,
which estimates it; a battery that has been silent for three times as long, or was never heard of,
is left out of the plan.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean
from vppres.live.controller import Controller
from vppres.live.door import RANGES, Range
from vppres.live.measurement import Measurement
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.payloads import Readings, read_duration, read_moment
from vppres.service.store import Reading, Store, moment, seconds

INSTANT = ("soc", "load_kw", "pv_kw", "online")
MEAN = ("battery_kw", "import_kw")
GRID = "grid"
LOST_AFTER = 3
"""Multiples of the time for which a reading holds."""

WHERE = "telemetry"
_FLAG = Range(0.0, 1.0, "must be 0 or 1", "Give 1 where the battery can work, else 0.")


@dataclass(frozen=True)
class Heard:
    """How old a quantity of an asset is.

    Parameters
    ----------
    asset, quantity, source : str
        What it is, and who said so.
    age_s : int
        Time since the reading.
    state : {"ok", "stale", "lost"}
        Whether it holds, is estimated, or has been silent for too long.
    """

    asset: str
    quantity: str
    source: str
    age_s: int
    state: str


@dataclass(frozen=True, eq=False)
class Known:
    """What is known at a step.

    Parameters
    ----------
    measurement : Measurement
        For the controller.
    heard : list of Heard
        Age of everything that was ever heard of.
    soc : dict of str to float
        State of charge that was read.
    """

    measurement: Measurement
    heard: list[Heard]
    soc: dict[str, float] = field(default_factory=dict)

    @property
    def limits_kw(self) -> pd.Series[float]:
        """Limits of import over the window, infinite where there are none."""
        return pd.Series(self.measurement.grid_limit_kw)


def assets_of(scenario: Scenario) -> dict[str, list[str]]:
    """Assets of each quantity."""
    batteries = [str(name) for name in scenario.batteries.id]
    return {
        "soc": batteries,
        "battery_kw": batteries,
        "online": batteries,
        "load_kw": [str(name) for name in scenario.customers.id],
        "pv_kw": [str(name) for name in scenario.pv.id],
        "import_kw": [GRID],
    }


def readings_of(
    batch: Iterable[Readings], scenario: Scenario, until: pd.Timestamp
) -> tuple[list[Reading], list[Problem]]:
    """Readings that can be kept, and what is wrong with the others.

    Parameters
    ----------
    batch : iterable of Readings
        As they were sent.
    scenario : Scenario
        The site.
    until : pandas.Timestamp
        End of the next step: later readings are of another clock.
    """
    assets = assets_of(scenario)
    good: list[Reading] = []
    problems: list[Problem] = []
    for one in batch:
        known = assets[one.quantity]
        if one.asset not in known:
            cure = did_you_mean(one.asset, known, "Give an asset of the site.")
            problems.append(Problem(WHERE, "is not at the site", cure, None, "asset", one.asset))
            continue
        last = one.start + (len(one.values) - 1) * one.resolution
        if last >= until:
            problems.append(
                Problem(
                    WHERE,
                    "lies in the future",
                    f"Set the clock of {one.source}; the present step ends at {written(until)}.",
                    None,
                    f"time of {one.asset}",
                    written(last),
                )
            )
            continue
        permitted = _FLAG if one.quantity == "online" else RANGES[one.quantity]
        for step, value in enumerate(one.values):
            if value is not None and not permitted.holds(value):
                field_name = f"{one.quantity} of {one.asset}"
                message = permitted.text(value)
                problems.append(Problem(WHERE, message, permitted.cure, None, field_name, value))
                continue
            time = seconds(one.start + step * one.resolution)
            long = int(one.resolution.total_seconds())
            good.append(Reading(one.asset, one.quantity, time, one.source, long, value))
    return good, problems


def known_at(time: pd.Timestamp, controller: Controller, store: Store) -> Known:
    """What is known at the beginning of a step.

    Parameters
    ----------
    time : pandas.Timestamp
        The step.
    controller : Controller
        Whose window is to be known.
    store : Store
        What was heard.
    """
    scenario = controller.scenario
    step_s = round(scenario.grid.step_minutes * 60)
    found = {(r.asset, r.quantity): r for r in store.latest(time, INSTANT)}
    heard = [_heard(reading, time, step_s) for reading in found.values()]
    state = {(one.asset, one.quantity): one.state for one in heard}
    fresh = {
        key: np.nan if reading.value is None else reading.value
        for key, reading in found.items()
        if state[key] == "ok"
    }
    soc = {asset: value for (asset, quantity), value in fresh.items() if quantity == "soc"}
    means = _means(store, time, step_s)
    batteries = assets_of(scenario)["battery_kw"]
    power = {name: means[name, "battery_kw"] for name in batteries if (name, "battery_kw") in means}
    window = _Window.of(controller, time)
    measurement = Measurement(
        time,
        soc=soc,
        load_kw=window.expected("load_kw", scenario.customers.id, found, fresh, store),
        pv_kw=window.expected("pv_kw", scenario.pv.id, found, fresh, store),
        price_gbp_per_kwh=pd.Series(window.prices(store), window.times),
        grid_limit_kw=pd.Series(window.limits_kw(store), window.times),
        battery_kw=power or None,
        online={
            name: bool(fresh.get((name, "online"), 1.0) != 0.0)
            and state.get((name, "soc"), "lost") != "lost"
            for name in batteries
        },
        import_kw=means.get((GRID, "import_kw")),
    )
    return Known(measurement, heard, {k: v for k, v in soc.items() if np.isfinite(v)})


def heard_at(time: pd.Timestamp, store: Store, step_s: int) -> list[Heard]:
    """Age of everything that was ever heard of."""
    return [_heard(reading, time, step_s) for reading in store.latest(time, INSTANT)]


def _heard(reading: Reading, time: pd.Timestamp, step_s: int) -> Heard:
    """How old a reading is."""
    age_s = seconds(time) - reading.time
    holds_s = max(reading.resolution_s, step_s)
    state = "ok" if age_s <= holds_s else "stale" if age_s <= LOST_AFTER * holds_s else "lost"
    return Heard(reading.asset, reading.quantity, reading.source, age_s, state)


def _means(store: Store, time: pd.Timestamp, step_s: int) -> dict[tuple[str, str], float]:
    """Means of the step that is over, of the readings that begin in it."""
    begun = time - pd.Timedelta(seconds=step_s)
    values: dict[tuple[str, str], list[float]] = {}
    for reading in store.between(begun, time, MEAN):
        if reading.value is not None:
            values.setdefault((reading.asset, reading.quantity), []).append(reading.value)
    return {key: sum(each) / len(each) for key, each in values.items()}


@dataclass(frozen=True, eq=False)
class _Window:
    """The steps that a decision looks at.

    Parameters
    ----------
    times : DatetimeIndex, length W
        Their beginnings.
    length : Timedelta
        Of each.
    series : dict of str to array, shape (W, ...)
        What the profile says of them.
    """

    times: pd.DatetimeIndex
    length: pd.Timedelta
    series: Mapping[str, Floats]

    @classmethod
    def of(cls, controller: Controller, time: pd.Timestamp) -> _Window:
        times = controller.window(time)
        scenario = controller.scenario
        inside = (scenario.grid.times >= times[0]) & (scenario.grid.times <= times[-1])
        series = {name: values[inside] for name, values in scenario.series.items()}
        return cls(times, pd.Timedelta(minutes=scenario.grid.step_minutes), series)

    def expected(
        self,
        quantity: str,
        ids: Any,
        found: Mapping[tuple[str, str], Reading],
        fresh: Mapping[tuple[str, str], float],
        store: Store,
    ) -> pd.DataFrame | None:
        """Profile, over it the forecast, and in the first row what is read; NaN what is missing."""
        if not len(ids):
            return None
        table = pd.DataFrame(self.series[quantity].copy(), self.times, [str(name) for name in ids])
        forecast = store.forecast(quantity, self.times[0] + self.length)
        if forecast is not None:
            self._lay(table, forecast)
        for name in table.columns:
            key = (name, quantity)
            if key in found:
                table.loc[self.times[0], name] = fresh.get(key, np.nan)
        return table

    def _lay(self, table: pd.DataFrame, forecast: Mapping[str, Any]) -> None:
        """The medians of a forecast in their places."""
        for name, quantiles in forecast["assets"].items():
            steps = self._steps(forecast, quantiles["p50"])
            if name in table.columns:
                for time, value in steps.items():
                    table.loc[time, name] = value

    def _steps(self, body: Mapping[str, Any], values: list[float]) -> dict[pd.Timestamp, float]:
        """Values of a body that begin with a step of the window."""
        start = read_moment(body["start"]).tz_convert("UTC")
        length = read_duration(body["resolution"])
        times = {start + step * length: value for step, value in enumerate(values)}
        return {time: times[time] for time in self.times if time in times}

    def prices(self, store: Store) -> Floats:
        """Import prices, those of events over those of the profile."""
        prices = self.series["price_gbp_per_kwh"].copy()
        for _, body in store.events().values():
            if body["type"] == "price":
                for time, value in self._steps(body, body["price_gbp_per_kwh"]).items():
                    prices[self.times.get_loc(time)] = value
        return prices

    def limits_kw(self, store: Store) -> Floats:
        """Import limits, 0 in every step that an outage touches."""
        limits = self.series["grid_limit_kw"].copy()
        for _, body in store.events().values():
            if body["type"] in ("outage", "import_limit"):
                touched = self.times + self.length > read_moment(body["start"])
                if body["end"] is not None:
                    touched &= self.times < read_moment(body["end"])
                most = 0.0 if body["type"] == "outage" else float(body["limit_kw"])
                limits = np.where(touched, np.minimum(limits, most), limits)
        return np.asarray(limits)


def check_forecast(
    quantity: str,
    assets: Mapping[str, Any],
    start: pd.Timestamp,
    length: pd.Timedelta,
    of: Scenario,
) -> None:
    """Whether a forecast is of the site and its steps.

    Raises
    ------
    InputError
        With everything that is not.
    """
    known = assets_of(of)[quantity]
    problems = [
        Problem("forecast", "is not at the site", did_you_mean(name, known, "Leave it out."))
        for name in assets
        if name not in known
    ]
    step = pd.Timedelta(minutes=of.grid.step_minutes)
    if length != step:
        problems.append(
            Problem(
                "forecast",
                "is not the length of a step",
                f"Steps last {of.grid.step_minutes:g} min.",
                field="resolution",
                value=str(length),
            )
        )
    elif (start - of.grid.start) % step != pd.Timedelta(0):
        problems.append(
            Problem(
                "forecast",
                "is not the beginning of a step",
                f"Steps last {of.grid.step_minutes:g} min; one begins at {written(of.grid.start)}.",
                field="start",
                value=written(start),
            )
        )
    if problems:
        raise InputError(problems)


def last_heard(store: Store) -> dict[str, str]:
    """When each source was last heard from, as answers have it."""
    return {source: written(moment(at)) for source, at in store.contacts().items()}
