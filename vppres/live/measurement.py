"""What a plant of one's own measures and expects, laid over a scenario's series."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes
from vppres.core.errors import InputError, Problem
from vppres.io.messages import did_you_mean
from vppres.plant.plant import BatteryState
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

Values = Mapping[str, float] | pd.Series  # by identifier
WHERE = "measurement"


@dataclass(frozen=True, eq=False)
class Measurement:
    """What is known at the beginning of a step: measured now, expected for the steps ahead.

    Only the time and the states of charge must be given. Whatever else is not given is what the
    scenario's series say, so that a scenario can serve as the forecast of a day.

    Parameters
    ----------
    time : pandas.Timestamp
        Beginning of the step to decide on, with time zone; one of the scenario's steps.
    soc : mapping or Series
        State of charge of every battery by its identifier, as a share of its capacity. What lies
        outside the battery's limits counts as the limit.
    load_kw, pv_kw : mapping, Series or DataFrame, optional
        Demand of customers and available power of PV systems in kW, by identifier. A mapping or
        Series is the current step; a DataFrame has one row per time (its index) and one column per
        identifier. PV power above a system's rating counts as the rating.
    price_gbp_per_kwh, grid_limit_kw : float or Series, optional
        Import price in GBP/kWh and largest import in kW (0 in an outage): a number for the current
        step, or a Series by time.
    eta_charge, eta_discharge : mapping or Series, optional
        Measured efficiencies by identifier; nominal where not given.

    Examples
    --------
    >>> now = Measurement(pd.Timestamp("2022-07-19T13:00Z"), soc={"b02": 0.5}, grid_limit_kw=0.0)
    >>> now.soc["b02"]
    0.5
    """

    time: pd.Timestamp
    soc: Values
    load_kw: Values | pd.DataFrame | None = None
    pv_kw: Values | pd.DataFrame | None = None
    price_gbp_per_kwh: float | pd.Series | None = None
    grid_limit_kw: float | pd.Series | None = None
    eta_charge: Values | None = None
    eta_discharge: Values | None = None


@dataclass(frozen=True, eq=False)
class Seen:
    """A measurement in the arrays of the closed loop: step, scenario as seen, batteries."""

    t: int
    scenario: Scenario
    state: BatteryState


def see(scenario: Scenario, measured: Measurement, t_cell_c: Floats) -> Seen:
    """Lay a measurement over a scenario.

    Parameters
    ----------
    scenario : Scenario
        What holds where nothing was measured.
    measured : Measurement
        The measurement.
    t_cell_c : array, shape (B,)
        Cell temperature; it bears on nothing within a step.

    Raises
    ------
    InputError
        With every value that does not fit the scenario.
    """
    desk = _Desk(scenario.grid, measured.time)
    c = scenario.customers
    pv = scenario.pv
    b = scenario.batteries
    load = desk.table("load_kw", measured.load_kw, c.id, scenario.load_kw)
    pv_kw = desk.table("pv_kw", measured.pv_kw, pv.id, scenario.pv_kw)
    price = desk.series("price_gbp_per_kwh", measured.price_gbp_per_kwh,
                        scenario.price_gbp_per_kwh)
    limit = desk.series("grid_limit_kw", measured.grid_limit_kw, scenario.grid_limit_kw)
    soc = desk.values("soc", measured.soc, b.id, np.full(len(b), np.nan))
    eta_charge = desk.values("eta_charge", measured.eta_charge, b.id, b.eta_charge)
    eta_discharge = desk.values("eta_discharge", measured.eta_discharge, b.id, b.eta_discharge)
    desk.finish()
    seen = replace(scenario, load_kw=load, pv_kw=np.minimum(pv_kw, pv.p_max_kw),
                   price_gbp_per_kwh=price, grid_limit_kw=limit)
    state = BatteryState(np.clip(soc, b.soc_min, b.soc_max), eta_charge, eta_discharge, t_cell_c)
    return Seen(desk.t, seen, state)


def step_at(grid: TimeGrid, time: pd.Timestamp) -> int:
    """The step that begins at a time.

    Raises
    ------
    InputError
        If none does.
    """
    desk = _Desk(grid, time)
    desk.finish()
    return desk.t


class _Desk:
    """Reads the parts of one measurement and collects their problems."""

    def __init__(self, grid: TimeGrid, time: pd.Timestamp) -> None:
        self.grid = grid
        self.problems = list[Problem]()
        self.t = int(self._steps("time", pd.Index([time]))[0])

    def finish(self) -> None:
        """Raise all problems at once."""
        if self.problems:
            raise InputError(self.problems)

    def table(self, field: str, given: Values | pd.DataFrame | None, ids: Iterable[Any],
              series: Floats) -> Floats:
        """A series of shape (T, items) with what was given in its place."""
        if given is None:
            return series
        frame = (given if isinstance(given, pd.DataFrame)
                 else pd.DataFrame([dict(given)], index=[self.grid.times[max(self.t, 0)]]))
        rows = self._steps(field, frame.index)
        columns = self._positions(field, frame.columns, ids)
        values = frame.to_numpy(dtype=float)
        self._check(field, values, [str(name) for name in frame.columns])
        if self.problems:
            return series
        result = series.copy()
        result[np.ix_(rows, columns)] = values
        return result

    def series(self, field: str, given: float | pd.Series | None, series: Floats) -> Floats:
        """A series of shape (T,) with what was given in its place."""
        if given is None:
            return series
        by_time = given if isinstance(given, pd.Series) else pd.Series(
            [given], index=[self.grid.times[max(self.t, 0)]])
        return self.table(field, by_time.to_frame(field), [field], series[:, np.newaxis])[:, 0]

    def values(self, field: str, given: Values | None, ids: Iterable[Any],
               default: Floats) -> Floats:
        """One share for each battery; those without default must be given."""
        named = {} if given is None else dict(given)
        positions = self._positions(field, list(named), ids)
        result = default.copy()
        for name, position, value in zip(named, positions, named.values(), strict=True):
            lowest = 0.0 if field == "soc" else 1e-6
            if not (np.isfinite(value) and lowest <= value <= 1.0):
                self._problem("must lie between 0 and 1", "Give a share, for example 0.5.",
                              f"{field} of {name}", value)
            elif position >= 0:
                result[position] = value
        self.problems += [
            Problem(WHERE, "is missing", "Give the state of charge of every battery.",
                    field=f"{field} of {name}")
            for name, value in zip(ids, result, strict=True)
            if np.isnan(value) and name not in named]
        return result

    def _steps(self, field: str, times: pd.Index) -> Wholes:
        """Steps of the scenario that begin at these times, -1 for those that do not."""
        known = {time: t for t, time in enumerate(self.grid.times)}
        steps = np.array([known.get(time, -1) for time in times], dtype=np.int64)
        grid = self.grid
        for time in times[steps < 0]:
            self._problem("is not the beginning of a step",
                          f"The scenario's steps begin at {grid.start.isoformat()} and last "
                          f"{grid.step_minutes:g} min; there are {grid.n_steps}.", field, time)
        return steps

    def _positions(self, field: str, names: Iterable[Any], ids: Iterable[Any]) -> Wholes:
        """Positions of identifiers, -1 for those that the scenario does not have."""
        position = {name: i for i, name in enumerate(ids)}
        for name in names:
            if name not in position:
                self._problem("is not in the scenario",
                              did_you_mean(str(name), [*map(str, ids)], "Correct the identifier."),
                              field, name)
        return np.array([position.get(name, -1) for name in names], dtype=np.int64)

    def _check(self, field: str, values: Floats, names: Sequence[str]) -> None:
        """Values that are no amounts; only the grid's limit may be infinite."""
        finite = np.isfinite(values) | (field == "grid_limit_kw") & np.isposinf(values)
        for row, column in np.argwhere(~(finite & (values >= 0))):
            what = field if names == [field] else f"{field} of {names[column]}"
            self._problem("must be a number not below 0", "Correct the measurement.", what,
                          values[row, column])

    def _problem(self, message: str, cure: str, field: str, value: object) -> None:
        self.problems.append(Problem(WHERE, message, cure, field=field, value=value))
