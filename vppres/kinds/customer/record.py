"""Customers in the record of a run: switching, times off, parts, and who was dimmed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, spans_of
from vppres.core.text import iso, named
from vppres.day.trajectory import WHOLE_SHARE, Trajectory, taken
from vppres.scenario.parts import part_names

PAIR = 2

NAMES_SHOWN = 5
"""Customers named in one sentence."""

ROUNDING_H = 1e-9
"""By how much sums of steps may miss a whole number of them, in h."""


def switched(run: Trajectory) -> Flags:
    """Whether each customer was switched off or on at the beginning of each step, (T, C)."""
    served = run.by_step("customers", "served")
    before = np.vstack([np.ones_like(served[:1]), served[:-1]])
    return np.asarray(served != before)


def off_before_h(served: Flags, dt_h: float) -> Floats:
    """How long each customer had been off at the beginning of each step in h, (T, C).

    Before the first step all customers were supplied.

    >>> off_before_h(np.array([[False], [False], [True]]), 0.5).ravel().tolist()
    [0.0, 0.5, 1.0]
    """
    found = np.zeros(served.shape)
    for t in range(1, len(served)):
        found[t] = np.where(served[t - 1], 0.0, found[t - 1] + dt_h)
    return found


def figures(run: Trajectory) -> dict[str, Any]:
    """Figures of ``summary.json`` on switching and times off.

    Returns
    -------
    dict
        ``switching_actions``: customers switched off or on, over all steps; all customers are
        supplied before the first step. ``actions_beyond_one_pair``: those beyond one off/on pair of
        each customer. ``switching_relaxed_steps``: steps in which duties to serve were dropped.
        ``setpoint_moves_kw``: how far battery powers were moved away from what the plan one step
        before had foreseen, summed over batteries and steps. ``served_share_of_customer``, where
        customers have parts: share served in the outage, the mean over the parts. ``off_too_long``,
        where one has a longest time off: customer, first step, hours off and limit of each time off
        beyond it.
    """
    actions = switched(run).sum(axis=0)
    steps = run.steps
    found: dict[str, Any] = {
        "switching_actions": int(actions.sum()),
        "actions_beyond_one_pair": int(np.maximum(actions - PAIR, 0).sum()),
        "switching_relaxed_steps": int(steps["switching_relaxed"].sum())
        if "switching_relaxed" in steps
        else 0,
        "setpoint_moves_kw": float(steps["moved_kw"].sum()) if "moved_kw" in steps else None,
    }
    if shares := _shares_of_parts(run):
        found["served_share_of_customer"] = shares
    customers, times = run.scenario.customers, run.scenario.grid.times
    if np.isfinite(customers.longest_off_h).any():
        found["off_too_long"] = [
            {
                "customer": str(customers.id[c]),
                "from": iso(times[t]),
                "off_h": off_h,
                "limit_h": limit_h,
            }
            for c, t, off_h, limit_h in _too_long(run)
        ]
    return found


def cautions(run: Trajectory) -> list[str]:
    """Which customers were off for longer than they may be, in a sentence; empty if none was."""
    c = run.scenario.customers
    names = [
        f"{c.id[i]} ({c.tier[i]}) {off_h:g} h of {limit_h:g} h"
        for i, _, off_h, limit_h in _too_long(run)
    ]
    return [f"Off beyond the longest time off: {named(names, NAMES_SHOWN)}."] if names else []


def events(run: Trajectory) -> Iterator[tuple[int, str]]:
    """When customers begin and end to get a part of their demand."""
    share = taken(run.customers).to_numpy(float).reshape(len(run.steps), -1)
    dimmed = (share > 0.0) & (share < WHOLE_SHARE)
    for c in np.flatnonzero(dimmed.any(axis=0)):
        for first, last in spans_of(dimmed[:, c]):
            least = share[first:last, c].min()
            yield first, f"{run.scenario.customers.id[c]} dimmed, to {least:.0%} at the least."


def assumptions(run: Trajectory) -> list[str]:
    """Assumptions of plans on customers, in sentences."""
    customers = run.scenario.customers
    limited, dimmable = np.isfinite(customers.longest_off_h).sum(), customers.dimmable.sum()
    found = []
    if limited:
        found.append(
            f"Longest times off ({limited} of {len(customers)} customers) are kept where they "
            "can be, and broken by the least where not."
        )
    if dimmable:
        found.append(
            f"{dimmable} of {len(customers)} customers may be dimmed: of one that is, service "
            "counts in proportion to what it gets."
        )
    return found


def _too_long(run: Trajectory) -> list[tuple[int, int, float, float]]:
    """Customer, first step, hours and limit in h of times off beyond it, by falling weight."""
    customers, dt_h = run.scenario.customers, run.scenario.grid.dt_h
    off, limits_h = ~run.by_step("customers", "served"), customers.longest_off_h
    limited = np.flatnonzero(np.isfinite(limits_h))
    found = [
        (c, first, (last - first) * dt_h, float(limits_h[c]))
        for c in limited[np.argsort(-customers.weight[limited], kind="stable")].tolist()
        for first, last in spans_of(off[:, c])
    ]
    return [one for one in found if one[2] > one[3] + ROUNDING_H]


def _shares_of_parts(run: Trajectory) -> dict[str, float | None]:
    """Share of the outage that each customer in several parts was served, by its identifier."""
    rows = run.customers
    dark = run.steps.loc[run.steps["outage"].astype(bool), "time"]
    rows = rows[rows["time"].isin(dark)]
    shares = {}
    for name, count in run.options.get("parts", {}).items():
        served = rows.loc[rows["id"].isin(part_names(name, count)), "served"]
        shares[name] = float(served.mean()) if len(served) else None
    return shares
