"""What is kept of a simulated day: its summary and one number for each step and quantity."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from vppres.forecast import Forecaster, ForecastErrors
from vppres.metrics import summarise
from vppres.plots import served_kw, stored_energy_kwh
from vppres.trajectory import Trajectory, json_safe

Floats = NDArray[np.float64]

# Columns of the steps table that are kept as they are.
STEP_COLUMNS = ("outage", "price_gbp_per_kwh", "p_grid_kw", "losses_kw", "v_min_ac_pu",
                "v_error_pu", "corrected", "correction_reason", "solve_s", "gap", "status")


@dataclass(frozen=True)
class DayResult:
    """A simulated day in short.

    Parameters
    ----------
    summary : mapping
        The figures of :func:`vppres.metrics.summarise`.
    steps : mapping of str to list
        One value per step and quantity; ``energy_kwh`` has one more, the end of the day.
    planned : mapping of str to list
        Of a full-horizon plan, like ``steps``: ``energy_kwh``, ``p_grid_kw``,
        ``served_forecast_kw`` and ``served_actual_kw``, the demand of the customers whom the plan
        serves as it was forecast and as it came. Empty without a plan.
    """

    summary: Mapping[str, Any]
    steps: Mapping[str, list[Any]]
    planned: Mapping[str, list[float]]

    @property
    def resilience(self) -> float:
        """Weighted share of service in the outage."""
        return float(self.summary["resilience"])

    @property
    def corrected_hours(self) -> list[int]:
        """Steps in which the plan was overruled."""
        return [hour for hour, was in enumerate(self.steps["corrected"]) if was]

    def why_corrected(self) -> str:
        """Which hours were corrected, and why the first one was."""
        reasons = [text for text in self.steps["correction_reason"] if text]
        first = f" (first: {reasons[0]})" if reasons else ""
        return f"Corrected hours: {', '.join(map(str, self.corrected_hours)) or 'none'}{first}."

    def evidence(self) -> str:
        """Figures that help to see why a day came out as it did."""
        shares = ", ".join(f"{tier} {share:.0%}"
                           for tier, share in self.summary["served_share"].items())
        stored_kwh = self.steps["energy_kwh"][self.steps["outage"].index(True)]
        return (f"Served in the outage: {shares}; stored at its beginning: {stored_kwh:,.0f} kWh. "
                f"{self.why_corrected()}")

    def series(self, name: str) -> Floats:
        """One quantity of every step."""
        return np.array(self.steps[name], dtype=float)

    def to_json(self) -> str:
        """The day as JSON text."""
        return json.dumps(asdict(self), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> DayResult:
        """A day from its JSON text."""
        return cls(**json.loads(text))


def shorten(run: Trajectory) -> DayResult:
    """Keep of a run what the figures and tables need."""
    customers, pv, batteries = run.customers, run.pv, run.batteries
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
    return DayResult(**json_safe({"summary": summarise(run), "steps": steps,
                                  "planned": _planned(run)}))


def _planned(run: Trajectory) -> dict[str, list[float]]:
    """Totals of a full-horizon plan, and what its served customers demand in fact."""
    if run.planned is None:
        return {}
    served = np.array(run.planned["served"], dtype=float)
    errors = ForecastErrors(**run.options["errors"])
    forecaster = Forecaster(run.scenario, errors, run.options["seed"])
    forecast = forecaster.at(0, range(run.scenario.grid.n_steps))
    return {"energy_kwh": run.planned["energy_kwh"], "p_grid_kw": run.planned["p_grid_kw"],
            "served_forecast_kw": (forecast.load_kw * served).sum(axis=1).tolist(),
            "served_actual_kw": (run.scenario.load_kw * served).sum(axis=1).tolist()}


def _total(values: pd.Series[Any], table: pd.DataFrame) -> list[float]:
    """Sum over the items of each step."""
    totals: list[float] = values.groupby(table["time"]).sum().tolist()
    return totals
