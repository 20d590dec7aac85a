"""Reduces a run to what the figures and tables need; its source is a part of every job's digest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from experiments.results import DayResult
from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.core.plain import json_safe
from vppres.day.metrics import summarise
from vppres.day.series import served_kw, stored_energy_kwh
from vppres.day.trajectory import Trajectory

# Columns of the steps table that are kept as they are.
STEP_COLUMNS = (
    "outage",
    "price_gbp_per_kwh",
    "p_grid_kw",
    "losses_kw",
    "v_min_ac_pu",
    "v_error_pu",
    "corrected",
    "correction_reason",
    "solve_s",
    "gap",
    "status",
)


def shorten(run: Trajectory) -> DayResult:
    """Keep of a run what the figures and tables need."""
    customers = run.customers
    pv = run.pv
    batteries = run.batteries
    steps = {name: run.steps[name].tolist() for name in STEP_COLUMNS}
    steps |= {
        "v_min_model_pu": run.buses.groupby("time")["v_model_pu"].min().tolist(),
        "load_kw": _total(customers["p_load_kw"], customers),
        "served_kw": served_kw(run).tolist(),
        "pv_kw": _total(pv["available_kw"], pv),
        "pv_curtailed_kw": _total(pv["curtailed_kw"], pv),
        "charge_kw": _total(batteries["charge_kw"] - batteries["discharge_kw"], batteries),
        "energy_kwh": stored_energy_kwh(run).tolist(),
        "eta_charge": batteries.groupby("time")["eta_charge"].mean().tolist(),
        "temperature_max_c": batteries.groupby("time")["temperature_c"].max().tolist(),
    }
    return DayResult(
        **json_safe({"summary": summarise(run), "steps": steps, "planned": _planned(run)})
    )


def _planned(run: Trajectory) -> dict[str, list[float]]:
    """Totals of a full-horizon plan, and what its served customers demand in fact."""
    if run.planned is None:
        return {}
    served = np.array(run.planned["served"], dtype=float)
    errors = ForecastErrors(**run.options["errors"])
    forecaster = Forecaster(run.scenario, errors, run.options["seed"])
    forecast = forecaster.at(0, range(run.scenario.grid.n_steps))
    return {
        "energy_kwh": run.planned["energy_kwh"],
        "p_grid_kw": run.planned["p_grid_kw"],
        "served_forecast_kw": (forecast.load_kw * served).sum(axis=1).tolist(),
        "served_actual_kw": (run.scenario.load_kw * served).sum(axis=1).tolist(),
    }


def _total(values: pd.Series[Any], table: pd.DataFrame) -> list[float]:
    """Sum over the items of each step."""
    totals: list[float] = values.groupby(table["time"]).sum().tolist()
    return totals
