"""Trajectory to numbers: the figures of ``summary.json``, each a pure function of the record."""

from __future__ import annotations

import platform
from importlib import metadata
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats
from vppres.core.plain import json_safe
from vppres.core.text import counted, named
from vppres.core.units import kva_to_a
from vppres.day.inversions import headroom_words, inversion_words
from vppres.day.kind_tables import kind_figures, kind_words
from vppres.day.phase_figures import phase_figures
from vppres.day.recorder import OFF_BY_FAULT
from vppres.day.reliability import fairness_figures, reliability_figures
from vppres.day.trajectory import OPTIONS, Trajectory, supplied, time_on
from vppres.day.unused import without_effect
from vppres.io.digest import scenario_digest
from vppres.kinds.customer import record as customer
from vppres.plant.plant import NOBODY
from vppres.scenario.configuration import Branches
from vppres.scenario.remarks import darkness, unknown_phases

PACKAGES = ("vppres", "numpy", "cvxpy", "highspy", "pyscipopt", "pandapower")
MPC = "mpc"
AT_RATING = 0.95
"""Loading from which a line counts as at its rating: plans count with the lowest voltage."""

SURPLUS_KW = 0.05
"""Power beyond the export limit that the tolerances of plans and power flow explain."""

OFF_SHOWN = 5
"""Customers named in one sentence."""


def summarise(trajectory: Trajectory) -> dict[str, Any]:
    """Every key figure of ``summary.json``, safe for JSON: undefined values are None.

    Parameters
    ----------
    trajectory : Trajectory
        A finished run.

    Returns
    -------
    dict
        Keys as in ``summary.json``. Shares, resilience and island figures are None without an
        outage step.
    """
    summary = {
        "cautions": cautions(trajectory),
        "resilience": resilience(trajectory),
        "served_share": served_share(trajectory, outage=True),
        "served_share_connected": served_share(trajectory, outage=False),
        "cost_gbp": cost_gbp(trajectory),
        "import_kwh": import_kwh(trajectory),
        "export_kwh": export_kwh(trajectory),
        "export_revenue_gbp": export_revenue_gbp(trajectory),
        "net_cost_gbp": cost_gbp(trajectory) - export_revenue_gbp(trajectory),
        "pv_curtailed_kwh": pv_curtailed_kwh(trajectory),
        **voltage_figures(trajectory),
        **line_figures(trajectory),
        **island_figures(trajectory),
        **phase_figures(trajectory),
        "import_above_limit_max_kw": import_above_limit_max_kw(trajectory),
        **customer.figures(trajectory),
        **kind_figures(trajectory),
        "corrections": int(trajectory.steps["corrected"].sum()),
        **operation_figures(trajectory),
        **reliability_figures(trajectory),
        **fairness_figures(trajectory),
        "solve_s": solve_times(trajectory),
        "gap_max": trajectory.steps["gap"].max(),
        **{name: trajectory.options[name] for name in OPTIONS},
        "horizon_h": horizon_h(trajectory),
        "options": {
            name: value for name, value in trajectory.options.items() if name not in OPTIONS
        },
        "versions": versions(),
        "input_digest": scenario_digest(trajectory.scenario),
    }
    if trajectory.explanations is not None:
        summary |= reason_figures(trajectory.explanations)
    if trajectory.planned is not None:
        summary["resilience_planned"] = resilience_planned(trajectory)
    safe: dict[str, Any] = json_safe(summary)
    return safe


def cautions(trajectory: Trajectory) -> list[str]:
    """Cautions to read before any figure, in sentences."""
    off = off_with_grid(trajectory)
    return [
        *blackouts(trajectory),
        *fault_words(trajectory),
        *([off] if off else []),
        *customer.cautions(trajectory),
        *kind_words(trajectory),
        *unknown_phases(trajectory.scenario),
        *inversion_words(trajectory),
        *headroom_words(trajectory),
        *surplus_words(trajectory),
        *without_effect(trajectory),
    ]


def blackouts(trajectory: Trajectory) -> list[str]:
    """Islands that were blacked out though a battery could form them."""
    steps = trajectory.steps
    if darkness(trajectory.scenario) or "dark" not in steps or not steps["dark"].any():
        return []
    dark = steps[steps["dark"] > 0]
    reasons = sorted({str(reason) for reason in dark["dark_reason"] if reason})
    why = f": {'; '.join(reasons)}" if reasons else ""
    words = [f"The island was blacked out in {counted(len(dark), 'step')}{why}."]
    promised = dark[dark["shed_kw"] > 0] if "shed_kw" in dark else dark.iloc[:0]
    if len(promised):
        words.append(f"The plan had promised supply in {len(promised)} of them.")
    return words


def fault_words(trajectory: Trajectory) -> list[str]:
    """Customers in blacked-out parts of a feeder with a fault, by reason, the most hours first."""
    if OFF_BY_FAULT not in trajectory.customers:
        return []
    reasons = trajectory.customers[OFF_BY_FAULT]
    counts = reasons[reasons != ""].value_counts()
    dt_h = trajectory.scenario.grid.dt_h
    return [
        f"Blacked out for {count * dt_h:g} customer hours: {reason}."
        for reason, count in counts.items()
    ]


def surplus_words(trajectory: Trajectory) -> list[str]:
    """Fixed generation that neither demand, batteries nor the grid may take, in a sentence."""
    scenario = trajectory.scenario
    if scenario.network.p_fixed_kw.sum() >= 0.0:
        return []
    most_kw = scenario.export_max_kw[: len(trajectory.steps)]
    beyond_kw = -trajectory.steps["p_grid_kw"].to_numpy(float) - most_kw
    found = ~scenario.outage[: len(beyond_kw)] & (beyond_kw > SURPLUS_KW)
    if not found.any():
        return []
    first = scenario.grid.local(scenario.grid.times[int(np.argmax(found))])
    return [
        f"Fixed generation is more than demand, batteries and the export limit take, by up to "
        f"{beyond_kw[found].max():,.1f} kW in {counted(int(found.sum()), 'step')}, first at "
        f"{first:%d %b %H:%M}: it cannot be curtailed, and flows to the grid all the same."
    ]


def off_with_grid(trajectory: Trajectory) -> str:
    """Which customers were off while the grid was on, and why; empty if none was."""
    rows = _customers(trajectory, outage=False)
    rows = rows[~rows["served"].astype(bool)]
    if rows.empty:
        return ""
    dt_h = trajectory.scenario.grid.dt_h
    steps = rows.groupby("id", sort=False).agg(
        tier=("tier", "first"), weight=("weight", "first"), steps=("time", "size")
    )
    steps = steps.sort_values(["weight", "steps"], ascending=False, kind="stable")
    names = [f"{name} ({row.tier}) {row.steps * dt_h:g} h" for name, row in steps.iterrows()]
    return (
        f"Off with the grid on: {len(names)} of {len(trajectory.scenario.customers)} customers, "
        f"{len(rows) * dt_h:g} customer hours. Most important first: "
        f"{named(names, OFF_SHOWN)}.{_why_off(trajectory, rows)}"
        f"{_at_rating(trajectory, rows)}"
    )


def _at_rating(trajectory: Trajectory, off: pd.DataFrame) -> str:
    """Lines at their rating while customers were off."""
    net = trajectory.scenario.network
    if not net.has_ratings:
        return ""
    then = trajectory.steps["time"].isin(off["time"]).to_numpy(bool)
    full = (np.nan_to_num(line_loading(trajectory))[then] > AT_RATING).sum(axis=0)
    lines = [
        f"{net.from_bus[line]} to {net.to_bus[line]}"
        for line in np.argsort(-full, kind="stable")
        if full[line]
    ]
    return f" Lines at their rating then: {named(lines, OFF_SHOWN)}." if lines else ""


def _why_off(trajectory: Trajectory, off: pd.DataFrame) -> str:
    """Reasons by the record for customers off: the scarce limit, else the driver."""
    told = trajectory.explanations
    if told is None:
        return ""
    told = told[(told["action"] == "not_served") & told["time"].isin(off["time"])]
    counts = told["binding"].where(told["binding"] != "", told["driver"]).value_counts()
    reasons = [f"{str(driver).replace('_', ' ')} {count}" for driver, count in counts.items()]
    return f" Reasons: {', '.join(reasons)}." if reasons else ""


def resilience(trajectory: Trajectory) -> float | None:
    """Weighted share of service in the outage (paper, Performance Metrics); None without outage.

    ``R = sum_t sum_c w_c x(t, c) / sum_t sum_c w_c`` over the outage steps ``t``; a dimmed customer
    counts with its share, and what it catches up does not.
    """
    rows = _customers(trajectory, outage=True)
    total = float(rows["weight"].sum())
    return float((rows["weight"] * rows["served"]).sum()) / total if total else None


def resilience_planned(trajectory: Trajectory) -> float | None:
    """The resilience that the plan promised; None without a plan or an outage."""
    in_outage = trajectory.steps["outage"].to_numpy(bool)
    if trajectory.planned is None or not in_outage.any():
        return None
    weight = trajectory.scenario.customers.weight
    served = np.asarray(trajectory.planned["served"], dtype=float)[in_outage]
    return float(served.mean(axis=0) @ weight / weight.sum())


def served_share(trajectory: Trajectory, outage: bool) -> dict[str, float | None]:
    """Share of customer-steps served, for each tier, over the outage or the connected steps.

    ``sum_t sum_c x(t, c) / sum_t sum_c 1`` over the customers ``c`` of the tier. None where there
    is no such step or no such customer.
    """
    share = _customers(trajectory, outage).groupby("tier")["served"].mean()
    return {
        tier: float(share[tier]) if tier in share.index else None
        for tier in trajectory.scenario.tiers
    }


def service_by_tier(trajectory: Trajectory) -> pd.DataFrame:
    """Share of customers served, shape (T, tiers): one row per step, one column per tier."""
    served = supplied(trajectory.customers).clip(upper=1)
    customers = trajectory.customers.assign(served=served)
    share = customers.pivot_table(
        index="time", columns="tier", values="served", aggfunc="mean", observed=False
    )
    present = [tier for tier in trajectory.scenario.tiers if tier in share.columns]
    return share[present].astype(float)


def service_by_customer(trajectory: Trajectory) -> pd.DataFrame:
    """One row per customer: hours without supply and energy not supplied, over the whole run.

    Returns
    -------
    DataFrame
        ``id``, ``bus``, ``tier``, ``unserved_h``, ``unserved_kwh``, in the scenario's order.
    """
    dt_h = trajectory.scenario.grid.dt_h
    rows = trajectory.customers
    lost_kw = (1.0 - supplied(rows)) * rows["p_load_kw"]
    off_h = (1.0 - time_on(rows)) * dt_h
    lost = rows.assign(unserved_h=off_h, unserved_kwh=lost_kw * dt_h)
    return (
        lost.groupby("id", sort=False)
        .agg(
            bus=("bus", "first"),
            tier=("tier", "first"),
            unserved_h=("unserved_h", "sum"),
            unserved_kwh=("unserved_kwh", "sum"),
        )
        .reset_index()
    )


def cost_gbp(trajectory: Trajectory) -> float:
    """Cost of the imported energy: ``sum_t rho(t) P_grid(t) dt`` over grid-available steps (AC).

    What the export earns is not in it.
    """
    steps = trajectory.steps[~trajectory.steps["outage"].astype(bool)]
    price = steps["price_gbp_per_kwh"]
    return float((price * _imported_kw(trajectory)).sum() * trajectory.scenario.grid.dt_h)


def import_kwh(trajectory: Trajectory) -> float:
    """Imported energy in kWh: ``sum_t P_grid(t) dt`` over grid-available steps (AC)."""
    return float(_imported_kw(trajectory).sum() * trajectory.scenario.grid.dt_h)


def export_kwh(trajectory: Trajectory) -> float:
    """Exported energy in kWh over grid-available steps (AC); 0 for an import-only connection."""
    return float(trajectory.exported_kw.sum() * trajectory.scenario.grid.dt_h)


def export_revenue_gbp(trajectory: Trajectory) -> float:
    """Revenue of the exported energy in GBP, negative where it costs."""
    day = trajectory.scenario
    price = day.export_price[: len(trajectory.steps)]
    return float(price @ trajectory.exported_kw * day.grid.dt_h)


def pv_curtailed_kwh(trajectory: Trajectory) -> float:
    """Curtailed PV energy in kWh over the whole run."""
    return float(trajectory.pv["curtailed_kw"].sum() * trajectory.scenario.grid.dt_h)


def voltage_figures(trajectory: Trajectory) -> dict[str, float]:
    """Extremes of the AC voltages, mean of the hourly lowest, and the optimisation's largest error.

    ``v_mean_of_min_ac_pu = mean_t min_n V_ac(t, n)``;
    ``v_error_max_pu = max_t max_n |V_model(t, n) - V_ac(t, n)|``.
    """
    steps = trajectory.steps
    return {
        "v_min_ac_pu": float(steps["v_min_ac_pu"].min()),
        "v_max_ac_pu": float(steps["v_max_ac_pu"].max()),
        "v_mean_of_min_ac_pu": float(steps["v_min_ac_pu"].mean()),
        "v_error_max_pu": float(steps["v_error_pu"].max()),
    }


def line_current_a(trajectory: Trajectory) -> Floats:
    """Current of each line, and in runs that move switches each tie, (T, L) or (T, E).

    ``I = |S| / (sqrt(3) V)`` with power and voltage at the sending end; without shunts it is the
    same along the line. Zero where a bus has no voltage.
    """
    net = trajectory.scenario.network
    s_kva = np.hypot(*(trajectory.by_step("lines", name) for name in ("p_ac_kw", "q_ac_kvar")))
    first = Branches.of(trajectory.scenario).ends[: s_kva.shape[1], 0]
    v_pu = trajectory.by_step("buses", "v_ac_pu")[:, first]
    live = np.nan_to_num(v_pu) > 0
    current = kva_to_a(s_kva, np.where(live, v_pu, 1.0) * net.base_kv)
    return np.where(live, current, 0.0)


def line_loading(trajectory: Trajectory) -> Floats:
    """Current of each line as a share of its rating, shape (T, L); NaN for lines without one."""
    current_a = line_current_a(trajectory)
    rating = Branches.of(trajectory.scenario).rating_a[: current_a.shape[1]]
    return current_a / np.where(np.isfinite(rating), rating, np.nan)


def line_figures(trajectory: Trajectory) -> dict[str, float | None]:
    """Largest line current in A, and largest loading of any line that has a rating."""
    loading = line_loading(trajectory)
    rated = np.isfinite(loading).any()
    return {
        "line_current_max_a": float(line_current_a(trajectory).max()),
        "line_loading_max": float(np.nanmax(loading)) if rated else None,
    }


def island_figures(trajectory: Trajectory) -> dict[str, float | None]:
    """Largest balance at the slack bus of an island, although its grid is dead.

    The optimisation's island is lossless; the AC power flow draws the losses, and any mismatch,
    from the slack bus. ``import`` is active power into the feeder, ``export`` a surplus that has
    nowhere to go (both at least 0), ``reactive`` the absolute value in kvar. None without outage.
    """
    island = trajectory.steps[trajectory.steps["outage"].astype(bool)]
    if island.empty:
        return {
            "island_import_max_kw": None,
            "island_export_max_kw": None,
            "island_reactive_max_kvar": None,
        }
    return {
        "island_import_max_kw": max(0.0, float(island["p_grid_kw"].max())),
        "island_export_max_kw": max(0.0, float(-island["p_grid_kw"].min())),
        "island_reactive_max_kvar": float(island["q_grid_kvar"].abs().max()),
    }


def import_above_limit_max_kw(trajectory: Trajectory) -> float | None:
    """Largest import beyond the connection's limit; None where no step with grid has one.

    Plans of the paper's mode have no losses: where the limit binds, these come on top of it.
    """
    excess_kw = import_above_limit_kw(trajectory)
    return float(np.nanmax(excess_kw)) if not np.isnan(excess_kw).all() else None


def import_above_limit_kw(trajectory: Trajectory) -> Floats:
    """Import beyond the connection's limit, (T,); NaN without a limit and in the outage."""
    limit_kw = trajectory.scenario.grid_limit_kw
    import_kw = trajectory.steps["p_grid_kw"].to_numpy(float)
    limited = np.isfinite(limit_kw) & (limit_kw > 0.0)
    return np.where(limited, np.maximum(import_kw - limit_kw, 0.0), np.nan)


def reason_figures(explanations: pd.DataFrame) -> dict[str, Any]:
    """How many actions have a reason, and how often each drove one.

    An action is a customer not served in a step, a battery that moved by more than 1 kW, or a PV
    system curtailed by more than that. ``explained_share`` is None where there is none.
    """
    actions = explanations[explanations["item"] != "step"]
    explained = actions["driver"] != "unexplained"
    drivers = {
        action: rows["driver"].value_counts().sort_index().to_dict()
        for action, rows in actions.groupby("action")
    }
    return {
        "explained_share": float(explained.mean()) if len(actions) else None,
        "drivers": drivers,
    }


def operation_figures(trajectory: Trajectory) -> dict[str, Any]:
    """How many steps had a fallback, in all and by kind, an estimate, and no AC solution."""
    steps = trajectory.steps
    kinds = steps.loc[steps["fallback"] != "none", "fallback"]
    failed = steps["ac_failed"].astype(str)
    not_found = failed.str.startswith(NOBODY)
    return {
        "fallbacks": len(kinds),
        "fallbacks_by_kind": {str(kind): int(n) for kind, n in kinds.value_counts().items()},
        "estimated_steps": int((steps["estimated"] != "").sum()),
        "ac_failures": int(((failed != "") & ~not_found).sum()),
        "ac_not_found": int(not_found.sum()),
    }


def solve_times(trajectory: Trajectory) -> dict[str, float]:
    """Total, median, 95th percentile and largest time of a decision, in s."""
    seconds = trajectory.steps["solve_s"]
    return {
        "total": float(seconds.sum()),
        "median": float(seconds.median()),
        "p95": float(seconds.quantile(0.95)),
        "max": float(seconds.max()),
    }


def horizon_h(trajectory: Trajectory) -> float | None:
    """Prediction horizon in h; None for controllers other than the MPC, which have none."""
    if trajectory.options["controller"] != MPC:
        return None
    return float(trajectory.options["horizon_h"])


def versions() -> dict[str, str | None]:
    """Versions of the packages a result depends on; None for one that is not installed."""
    return {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def _customers(trajectory: Trajectory, outage: bool) -> pd.DataFrame:
    """Rows of the customers' table in the outage, or out of it; dimmed ones served in part."""
    steps = trajectory.steps
    times = steps.loc[steps["outage"] == outage, "time"]
    rows = trajectory.customers[trajectory.customers["time"].isin(times)]
    return rows.assign(served=supplied(rows).clip(upper=1))


def _imported_kw(trajectory: Trajectory) -> pd.Series:
    """Import of the steps with a grid."""
    steps = trajectory.steps
    connected = ~steps["outage"].astype(bool)
    return pd.Series(trajectory.imported_kw, steps.index)[connected]


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
