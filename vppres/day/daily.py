"""A run by the day: one row for each calendar day, however long the run is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from vppres.core.arrays import Floats, Wholes
from vppres.day.series import demand_kw, per_step, pv_available_kw, served_kw, stored_energy_kwh
from vppres.day.trajectory import Trajectory
from vppres.kinds.customer.record import switched


def daily_figures(run: Trajectory, zone: str | None = None) -> pd.DataFrame:
    """Figures of each calendar day of a run; energies and costs add up to those of the summary.

    A day is one of the clocks of a time zone: where they are changed it has 23 or 25 hours.

    Parameters
    ----------
    run : Trajectory
        A finished run.
    zone : str, optional
        Name of the time zone; the scenario's if not given.

    Returns
    -------
    DataFrame
        One row per day with ``day`` (ISO 8601), ``hours`` and ``outage_h``; ``resilience`` and
        ``unserved_customer_h``; ``demand_kwh``, ``unserved_kwh``, ``import_kwh``,
        ``pv_available_kwh``, ``pv_curtailed_kwh`` and ``losses_kwh``; ``cost_gbp`` of the import;
        ``export_kwh`` and ``export_revenue_gbp``;
        ``stored_start_kwh`` and ``stored_end_kwh`` of all batteries; ``v_min_ac_pu`` and
        ``v_max_ac_pu``; ``switching_actions`` of all customers and ``actions_max`` of one;
        ``fallbacks`` and ``solve_s``. ``resilience`` is NaN where a day has no outage.
    """
    days = _Days(run, _first_steps(run, zone))
    stored = stored_energy_kwh(days.run)
    after = np.append(days.first[1:], len(days.steps))
    low, high = (days.steps[name].to_numpy(float) for name in ("v_min_ac_pu", "v_max_ac_pu"))
    actions = switched(days.run)
    of_customers = np.add.reduceat(actions.astype(float), days.first, axis=0)
    return pd.DataFrame(
        {
            "day": _times(run, zone)[days.first].strftime("%Y-%m-%d"),
            "hours": days.hours(np.ones(len(run.steps))),
            "outage_h": days.hours(days.steps["outage"]),
            **_service(days),
            **_energies(days),
            **_money(days),
            "stored_start_kwh": stored[days.first],
            "stored_end_kwh": stored[after],
            "v_min_ac_pu": np.minimum.reduceat(low, days.first),
            "v_max_ac_pu": np.maximum.reduceat(high, days.first),
            "switching_actions": days.total(actions.sum(axis=1)).astype(int),
            "actions_max": of_customers.max(axis=1).astype(int),
            "fallbacks": days.total(days.steps["fallback"] != "none").astype(int),
            "solve_s": days.total(days.steps["solve_s"]),
        }
    )


@dataclass(frozen=True, eq=False)
class _Days:
    """A run, and the first step of each of its days."""

    run: Trajectory
    first: Wholes

    @property
    def steps(self) -> pd.DataFrame:
        """The table of steps."""
        return self.run.steps

    def total(self, values: ArrayLike) -> Floats:
        """Sum over the steps of each day."""
        return np.asarray(np.add.reduceat(np.asarray(values, dtype=float), self.first))

    def hours(self, values: ArrayLike) -> Floats:
        """Integral over each day: kWh of kW, hours of yes and no."""
        return self.run.scenario.grid.dt_h * self.total(values)


def _service(days: _Days) -> dict[str, Floats]:
    """Resilience of each day, and hours in which customers were off."""
    run = days.run
    outage = run.steps["outage"].to_numpy(bool)
    off = run.time_off
    weight = run.scenario.customers.weight
    weighted = days.total(((1.0 - off) @ weight) * outage)
    asked = days.total(weight.sum() * outage)
    unknown = np.full(len(days.first), np.nan)
    return {
        "resilience": np.divide(weighted, asked, where=asked > 0, out=unknown),
        "unserved_customer_h": days.hours(off.sum(axis=1)),
    }


def _energies(days: _Days) -> dict[str, Floats]:
    """Energies in kWh."""
    run = days.run
    demand = demand_kw(run)
    return {
        "demand_kwh": days.hours(demand),
        "unserved_kwh": days.hours(demand - served_kw(run)),
        "import_kwh": days.hours(run.imported_kw),
        "pv_available_kwh": days.hours(pv_available_kw(run)),
        "pv_curtailed_kwh": days.hours(per_step(run, run.pv["curtailed_kw"], run.pv)),
        "losses_kwh": days.hours(run.steps["losses_kw"]),
    }


def _money(days: _Days) -> dict[str, Floats]:
    """Cost of the import, and the export with its revenue."""
    run = days.run
    price = run.steps["price_gbp_per_kwh"].to_numpy(float)
    export_price = run.scenario.export_price[: len(run.steps)]
    return {
        "cost_gbp": days.hours(price * run.imported_kw),
        "export_kwh": days.hours(run.exported_kw),
        "export_revenue_gbp": days.hours(export_price * run.exported_kw),
    }


def spans_days(run: Trajectory, zone: str | None = None) -> bool:
    """Whether a run has steps of more than one calendar day."""
    return len(_first_steps(run, zone)) > 1


def _times(run: Trajectory, zone: str | None) -> pd.DatetimeIndex:
    """Beginnings of the steps as the clocks of a time zone show them."""
    times = pd.DatetimeIndex(run.steps["time"])
    return times.tz_convert(zone or run.scenario.grid.zone)


def _first_steps(run: Trajectory, zone: str | None) -> Wholes:
    """The first step of each day."""
    midnight = _times(run, zone).tz_localize(None).normalize()
    return np.flatnonzero(np.append(True, midnight[1:] != midnight[:-1]))
