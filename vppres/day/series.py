"""Series of a run that figures and charts draw."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names, spans_of
from vppres.day.metrics import line_current_a, line_loading
from vppres.day.trajectory import Trajectory, supplied


def stored_energy_kwh(run: Trajectory) -> Floats:
    """Energy in all batteries at the beginning of each step and at the end, shape (T + 1,)."""
    energy_kwh = np.tile(run.scenario.batteries.energy_kwh, len(run.steps))
    start = per_step(run, run.batteries["soc_start"] * energy_kwh, run.batteries)
    end = per_step(run, run.batteries["soc_end"] * energy_kwh, run.batteries)
    return np.append(start, end[-1])


def energy_limits_kwh(run: Trajectory) -> tuple[float, float]:
    """Least and most energy that all batteries together may hold."""
    b = run.scenario.batteries
    return float(b.energy_kwh @ b.soc_min), float(b.energy_kwh @ b.soc_max)


def served_kw(run: Trajectory) -> Floats:
    """Demand of the customers that were served, shape (T,)."""
    return per_step(run, run.customers["p_load_kw"] * supplied(run.customers), run.customers)


def demand_kw(run: Trajectory) -> Floats:
    """Demand of all customers, served or not, shape (T,)."""
    return per_step(run, run.customers["p_load_kw"], run.customers)


def off_kw(run: Trajectory) -> Floats:
    """Demand that is off supply, of dimmed customers the rest, shape (T,)."""
    off = np.maximum(1.0 - supplied(run.customers), 0.0)
    return per_step(run, run.customers["p_load_kw"] * off, run.customers)


def pv_available_kw(run: Trajectory) -> Floats:
    """Power that all PV systems could give, shape (T,)."""
    return per_step(run, run.pv["available_kw"], run.pv)


def battery_power_kw(run: Trajectory) -> Floats:
    """Net charging power of all batteries, shape (T,)."""
    net_kw = run.batteries["charge_kw"] - run.batteries["discharge_kw"]
    return per_step(run, net_kw, run.batteries)


def lowest_model_v_pu(run: Trajectory) -> Floats:
    """Lowest bus voltage of the optimisation, shape (T,)."""
    return run.buses.groupby("time")["v_model_pu"].min().to_numpy(float)


def line_values(run: Trajectory, rated: bool) -> Floats:
    """Loading of each line in per cent, NaN without a rating; else its current in A, (T, L)."""
    return 100.0 * line_loading(run) if rated else line_current_a(run)


def edges_of(run: Trajectory) -> Names:
    """Beginning of every step and the end of the last, as datetimes in UTC, shape (T + 1,)."""
    grid = run.scenario.grid
    times = pd.date_range(grid.start, periods=len(run.steps) + 1, freq=grid.step)
    return np.asarray(times.tz_convert(UTC).to_pydatetime())


def per_step(run: Trajectory, values: pd.Series[Any], table: pd.DataFrame) -> Floats:
    """Sum over the items of each step, shape (T,); zero where there are no items."""
    total = values.groupby(table["time"]).sum()
    return total.reindex(run.steps["time"], fill_value=0.0).to_numpy(float)


def outage_spans(run: Trajectory) -> list[tuple[int, int]]:
    """Half-open ranges of steps without grid."""
    return spans_of(run.steps["outage"].to_numpy(bool))


QUANTITIES: dict[str, Callable[[Trajectory], Floats]] = {
    "load_kw": demand_kw,
    "served_kw": served_kw,
    "pv_kw": pv_available_kw,
    "charge_kw": battery_power_kw,
    "energy_kwh": stored_energy_kwh,
    "v_min_model_pu": lowest_model_v_pu,
}
"""Totals of a run by name, beside the columns of its steps."""


def quantity(run: Trajectory, name: str) -> Floats:
    """A total of a run, or a column of its steps, shape (T,); energy at instants, (T + 1,)."""
    if name in QUANTITIES:
        return QUANTITIES[name](run)
    return run.steps[name].to_numpy(float)
