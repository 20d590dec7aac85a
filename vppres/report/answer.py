"""The answer that a report opens with: who kept supply in the outage, who did not and when."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from vppres.core.arrays import Flags, spans_of
from vppres.core.text import counted
from vppres.day.series import outage_spans
from vppres.day.trajectory import Trajectory
from vppres.report.clock import Clock

NAMES_SHOWN, SPANS_SHOWN = 3, 3
MWH_FROM_KWH = 1000.0


def answer(run: Trajectory, summary: Mapping[str, Any]) -> str:
    """Supply of the first tier in the outages, and the energy that was not supplied in all."""
    return f"{_first_tier(run)} {_missing(float(summary['energy_not_supplied_kwh']))}"


def _first_tier(run: Trajectory) -> str:
    """Which customers of the first tier kept supply; of all customers where there is no outage."""
    customers = run.scenario.customers
    outage = run.steps["outage"].to_numpy(bool)
    tier = next((t for t in run.scenario.tiers if (customers.tier == t).any()), "")
    of_tier = customers.tier == tier if outage.any() else np.ones(len(customers), dtype=bool)
    word = f"{tier} customer" if outage.any() else "customer"
    counts = outage if outage.any() else np.ones(len(outage), dtype=bool)
    off = ~run.by_step("customers", "served").astype(bool)[:, of_tier] & counts[:, None]
    names = customers.id[of_tier]
    if not len(names):
        return "There are no customers."
    lost = np.flatnonzero(off.any(axis=0))
    while_ = _how_long(run) if outage.any() else "at all times"
    kept = len(names) - len(lost)
    if not len(lost):
        all_ = f"All {counted(len(names), word)}" if len(names) > 1 else f"The only {word}"
        return f"{all_} kept supply {while_}."
    # Those that were off for longest are the ones to know.
    worst = lost[np.argsort(-off[:, lost].sum(axis=0), kind="stable")]
    told = [f"{names[c]} was off {_when(run, off[:, c])}" for c in worst[:NAMES_SHOWN]]
    more = len(worst) - NAMES_SHOWN
    rest = [f"{more} more {'was' if more == 1 else 'were'} off in part of it"] if more > 0 else []
    many = f"{kept or 'None'} of {counted(len(names), word)} kept"
    if len(names) == 1:
        many = f"The only {word} did not keep"
    return f"{many} supply {while_}; {', '.join([*told, *rest])}."


def _how_long(run: Trajectory) -> str:
    """The length of the outage, or of all of them."""
    spans = outage_spans(run)
    hours = f"{sum(last - first for first, last in spans) * run.scenario.grid.dt_h:g} h"
    return f"for all {hours}" if len(spans) == 1 else f"for all {hours} of {len(spans)} outages"


def _when(run: Trajectory, off: Flags) -> str:
    """The stretches in which a customer was off; of many how long in all."""
    clock, spans = Clock.of(run), spans_of(off)
    if len(spans) > SPANS_SHOWN:
        hours = float(off.sum()) * run.scenario.grid.dt_h
        return f"for {hours:g} h in {len(spans)} stretches"
    return " and ".join(clock.span(a, b, dated=not clock.one_day) for a, b in spans)


def _missing(kwh: float) -> str:
    """Energy that was not supplied."""
    if kwh < 0.05:
        return "All demand was supplied."
    if kwh < MWH_FROM_KWH:
        return f"{kwh:,.1f} kWh not supplied."
    return f"{kwh / MWH_FROM_KWH:,.1f} MWh not supplied."
