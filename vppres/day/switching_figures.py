"""How often customers were switched and how far set-points moved, from the record of a run."""

from __future__ import annotations

from typing import Any

import numpy as np

from vppres.core.arrays import Flags
from vppres.day.trajectory import Trajectory
from vppres.scenario.parts import part_names

PAIR = 2


def switching_figures(trajectory: Trajectory) -> dict[str, Any]:
    """Figures of ``summary.json`` on switching.

    Returns
    -------
    dict
        ``switching_actions``: customers switched off or on, over all steps; all customers are
        supplied before the first step. ``actions_beyond_one_pair``: those beyond one off/on pair of
        each customer. ``switching_relaxed_steps``: steps in which duties to serve were dropped.
        ``setpoint_moves_kw``: how far battery powers were moved away from what the plan one step
        before had foreseen, summed over batteries and steps. ``served_share_of_customer``, where
        customers have parts: share served in the outage, the mean over the parts.
    """
    actions = switched(trajectory).sum(axis=0)
    steps = trajectory.steps
    figures = {
        "switching_actions": int(actions.sum()),
        "actions_beyond_one_pair": int(np.maximum(actions - PAIR, 0).sum()),
        "switching_relaxed_steps": int(steps["switching_relaxed"].sum())
        if "switching_relaxed" in steps
        else 0,
        "setpoint_moves_kw": float(steps["moved_kw"].sum()) if "moved_kw" in steps else None,
    }
    shares = share_of_customers(trajectory)
    return figures | ({"served_share_of_customer": shares} if shares else {})


def switched(trajectory: Trajectory) -> Flags:
    """Whether each customer was switched off or on at the beginning of each step, (T, C)."""
    served = trajectory.by_step("customers", "served")
    before = np.vstack([np.ones_like(served[:1]), served[:-1]])
    return np.asarray(served != before)


def share_of_customers(trajectory: Trajectory) -> dict[str, float | None]:
    """Share of the outage that each customer in several parts was served, by its identifier."""
    rows = trajectory.customers
    dark = trajectory.steps.loc[trajectory.steps["outage"].astype(bool), "time"]
    rows = rows[rows["time"].isin(dark)]
    shares = {}
    for name, count in trajectory.options.get("parts", {}).items():
        served = rows.loc[rows["id"].isin(part_names(name, count)), "served"]
        shares[name] = float(served.mean()) if len(served) else None
    return shares
