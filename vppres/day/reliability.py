"""Cost of an outage to the customers: interruptions, minutes lost, energy and its worth.

The indices are those of IEEE Std 1366 (SAIFI, SAIDI) and of British regulation (CI, CML), taken
over one run instead of a year.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.units import h_to_minutes
from vppres.day.trajectory import Trajectory


def reliability_figures(run: Trajectory) -> dict[str, float]:
    """Interruptions, minutes lost and energy not supplied of all customers together.

    Returns
    -------
    dict
        ``customer_interruptions`` (CI): every loss of supply of every customer;
        ``interruptions_per_customer`` (SAIFI): the same per customer;
        ``customer_minutes_lost``, and per customer ``minutes_lost_per_customer`` (CML, SAIDI);
        ``energy_not_supplied_kwh``; ``voll_gbp_per_kwh``, the value of lost load of the scenario,
        and ``energy_not_supplied_gbp`` at that value. A customer in K parts counts as one, of which
        a part may be off, and one that stands for several homes as so many.
    """
    table = reliability_by_tier(run)
    total = table.sum()
    customers = max(float(total["customers"]), 1.0)
    voll = run.scenario.voll_gbp_per_kwh
    return {
        "customer_interruptions": float(total["interruptions"]),
        "interruptions_per_customer": float(total["interruptions"]) / customers,
        "customer_minutes_lost": float(total["minutes_lost"]),
        "minutes_lost_per_customer": float(total["minutes_lost"]) / customers,
        "energy_not_supplied_kwh": float(total["unserved_kwh"]),
        "voll_gbp_per_kwh": voll,
        "energy_not_supplied_gbp": voll * float(total["unserved_kwh"]),
    }


def reliability_by_tier(run: Trajectory) -> pd.DataFrame:
    """The sums behind the indices, tier by tier.

    Returns
    -------
    DataFrame
        By tier, in the scenario's order: ``customers``; ``interrupted``, those that lost supply at
        least once; ``interruptions``; ``minutes_lost``; ``demand_kwh`` and ``unserved_kwh``.
        Steps of a service that were decided anew count by their parts.
    """
    c = run.scenario.customers
    dt_h = run.scenario.grid.dt_h
    off, losses = run.time_off, run.losses_of_supply.sum(axis=0)
    demand_kw = run.by_step("customers", "p_load_kw")
    share = _shares_of_a_customer(run) * c.homes
    of_customers = pd.DataFrame(
        {
            "customers": share,
            "interrupted": share * (losses > 0.0),
            "interruptions": share * losses,
            "minutes_lost": share * off.sum(axis=0) * h_to_minutes(dt_h),
            "demand_kwh": demand_kw.sum(axis=0) * dt_h,
            "unserved_kwh": (demand_kw * (1.0 - run.supplied)).sum(axis=0) * dt_h,
        }
    )
    present = [tier for tier in run.scenario.tiers if (c.tier == tier).any()]
    return of_customers.groupby(np.asarray(c.tier)).sum().reindex(present)


def fairness_figures(run: Trajectory) -> dict[str, dict[str, float | None]]:
    """How unlike customers of a tier are in the time that they were off supply.

    Returns
    -------
    dict
        By tier ``minutes_off_max``, minutes of the customer that was off longest, and
        ``minutes_off_gini``, the Gini coefficient of the minutes: 0 where all were off alike, near
        1 where one was off alone. None of a tier without customers; parts of a customer are one.
    """
    c = run.scenario.customers
    off_h = run.time_off.sum(axis=0) * run.scenario.grid.dt_h
    minutes = off_h * h_to_minutes(1.0) * _shares_of_a_customer(run)
    parts = run.options.get("parts", {})
    of_part = {f"{name}/{k}": name for name, n in parts.items() for k in range(1, int(n) + 1)}
    names = [of_part.get(str(name), str(name)) for name in c.id]
    of_customers = pd.DataFrame({"tier": c.tier, "minutes": minutes}, index=names)
    found: dict[str, dict[str, float | None]] = {"minutes_off_max": {}, "minutes_off_gini": {}}
    for tier in run.scenario.tiers:
        off = of_customers[of_customers["tier"] == tier]["minutes"]
        each = off.groupby(level=0).sum().to_numpy(float)
        found["minutes_off_max"][tier] = float(each.max()) if len(each) else None
        found["minutes_off_gini"][tier] = gini(each) if len(each) else None
    return found


def gini(values: Floats) -> float:
    """Gini coefficient of values that are not negative; 0 where all are 0.

    >>> gini(np.array([3.0, 3.0])), gini(np.array([0.0, 0.0, 0.0, 6.0]))
    (0.0, 0.75)
    """
    total = float(values.sum())
    if total == 0.0:
        return 0.0
    apart = np.abs(values[:, None] - values).sum()
    return float(apart / (2.0 * len(values) * total))


def _shares_of_a_customer(run: Trajectory) -> Floats:
    """1 for each customer, 1 / K for each of K parts, (C,)."""
    parts: Mapping[str, Any] = run.options.get("parts", {})
    of_part = {f"{name}/{k}": 1.0 / n for name, n in parts.items() for k in range(1, int(n) + 1)}
    return np.array([of_part.get(str(name), 1.0) for name in run.scenario.customers.id])
