"""How long customers were off at a time, and beyond what they may be, from the record of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, Floats, spans_of
from vppres.core.text import iso, named
from vppres.day.trajectory import Trajectory

NAMES_SHOWN = 5
"""Customers named in one sentence."""

ROUNDING_H = 1e-9
"""By how much sums of steps may miss a whole number of them, in h."""


@dataclass(frozen=True)
class TooLong:
    """A customer that was off for longer than it may be at a time.

    Parameters
    ----------
    customer : int
        Its position.
    t : int
        The first step of this time off.
    off_h, limit_h : float
        How long it was off, and how long it may be, in h.
    """

    customer: int
    t: int
    off_h: float
    limit_h: float


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


def too_long(run: Trajectory) -> list[TooLong]:
    """Times off beyond what customers may be off at a time, the most important customer first."""
    customers = run.scenario.customers
    limits = customers.longest_off_h
    limited = np.flatnonzero(np.isfinite(limits))
    if not len(limited):
        return []
    dt_h = run.scenario.grid.dt_h
    off = ~run.by_step("customers", "served")
    found = [
        TooLong(c, first, (last - first) * dt_h, float(limits[c]))
        for c in limited[np.argsort(-customers.weight[limited], kind="stable")].tolist()
        for first, last in spans_of(off[:, c])
    ]
    return [one for one in found if one.off_h > one.limit_h + ROUNDING_H]


def time_off_figures(run: Trajectory) -> dict[str, Any]:
    """Figures of ``summary.json`` on longest times off; none where no customer has one.

    Returns
    -------
    dict
        ``off_too_long``: customer, first step, hours off and limit of each time off beyond it.
    """
    if not np.isfinite(run.scenario.customers.longest_off_h).any():
        return {}
    times = run.scenario.grid.times
    rows = [
        {
            "customer": str(run.scenario.customers.id[one.customer]),
            "from": iso(times[one.t]),
            "off_h": one.off_h,
            "limit_h": one.limit_h,
        }
        for one in too_long(run)
    ]
    return {"off_too_long": rows}


def time_off_words(run: Trajectory) -> list[str]:
    """Which customers were off for longer than they may be, in a sentence; empty if none was."""
    found = too_long(run)
    if not found:
        return []
    c = run.scenario.customers
    names = [
        f"{c.id[one.customer]} ({c.tier[one.customer]}) {one.off_h:g} h of {one.limit_h:g} h"
        for one in found
    ]
    return [f"Off beyond the longest time off: {named(names, NAMES_SHOWN)}."]
