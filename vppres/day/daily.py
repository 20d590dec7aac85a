"""A run by the day: one row for each calendar day, however long the run is."""

from __future__ import annotations

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Wholes
from vppres.day.series import demand_kw, per_step, pv_available_kw, served_kw, stored_energy_kwh
from vppres.day.switching_figures import switched
from vppres.day.trajectory import Trajectory


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
    first = _first_steps(run, zone)
    dt_h = run.scenario.grid.dt_h
    steps = run.steps

    def total(values: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.asarray(values, dtype=float), first))

    outage = steps["outage"].to_numpy(bool)
    export_price = run.scenario.export_price[: len(steps)]
    demand = demand_kw(run)
    served = run.customers["served"].to_numpy(bool).reshape(len(steps), -1)
    weight = run.scenario.customers.weight
    weighted = total((served @ weight) * outage)
    asked = total(weight.sum() * outage)
    stored = stored_energy_kwh(run)
    actions = switched(run)
    of_customers = np.add.reduceat(actions.astype(float), first, axis=0)
    price = steps["price_gbp_per_kwh"].to_numpy(float)
    return pd.DataFrame(
        {
            "day": _times(run, zone)[first].strftime("%Y-%m-%d"),
            "hours": total(np.full(len(steps), dt_h)),
            "outage_h": dt_h * total(outage),
            "resilience": np.divide(
                weighted, asked, where=asked > 0, out=np.full(len(first), np.nan)
            ),
            "unserved_customer_h": dt_h * total((~served).sum(axis=1)),
            "demand_kwh": dt_h * total(demand),
            "unserved_kwh": dt_h * total(demand - served_kw(run)),
            "import_kwh": dt_h * total(run.imported_kw),
            "pv_available_kwh": dt_h * total(pv_available_kw(run)),
            "pv_curtailed_kwh": dt_h * total(per_step(run, run.pv["curtailed_kw"], run.pv)),
            "losses_kwh": dt_h * total(steps["losses_kw"].to_numpy(float)),
            "cost_gbp": dt_h * total(price * run.imported_kw),
            "export_kwh": dt_h * total(run.exported_kw),
            "export_revenue_gbp": dt_h * total(export_price * run.exported_kw),
            "stored_start_kwh": stored[first],
            "stored_end_kwh": stored[np.append(first[1:], len(steps))],
            "v_min_ac_pu": np.minimum.reduceat(steps["v_min_ac_pu"].to_numpy(float), first),
            "v_max_ac_pu": np.maximum.reduceat(steps["v_max_ac_pu"].to_numpy(float), first),
            "switching_actions": total(actions.sum(axis=1)).astype(int),
            "actions_max": of_customers.max(axis=1).astype(int),
            "fallbacks": total(steps["fallback"].to_numpy() != "none").astype(int),
            "solve_s": total(steps["solve_s"].to_numpy(float)),
        }
    )


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
