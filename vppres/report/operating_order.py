"""The operating order of a run: which customers are switched when, and what is off then."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from vppres.core.text import named
from vppres.day.series import off_kw
from vppres.day.trajectory import SWITCHING_ORDER, Trajectory
from vppres.kinds.customer.record import switched
from vppres.report.clock import Clock

ORDER_FILE = "operating_order.csv"
OPEN, CLOSE = "open", "close"
ORDERS_SHOWN = 12
NAMES_SHOWN = 24


def operating_order(run: Trajectory) -> pd.DataFrame:
    """Every switching of a customer, in order of time; the most important first.

    Returns
    -------
    DataFrame
        ``time``, ``action`` (``open``: off supply, ``close``: on supply again), ``customer``,
        ``bus`` and ``tier``, the customer's demand ``demand_kw`` in that step, and ``off_kw``, the
        demand of all customers that are off then. Before the first step all are on supply.
    """
    c = run.scenario.customers
    step, item = np.nonzero(switched(run))
    closes = run.by_step("customers", "served")[step, item]
    order = np.lexsort((-c.weight[item], closes, step))
    step, item, closes = step[order], item[order], closes[order]
    demand_kw = run.by_step("customers", "p_load_kw")
    written = _written(run)
    return pd.DataFrame(
        {
            "time": [written[t] for t in step],
            "action": np.where(closes, CLOSE, OPEN),
            "customer": c.id[item].astype(str),
            "bus": c.bus[item].astype(str),
            "tier": c.tier[item].astype(str),
            "demand_kw": demand_kw[step, item],
            "off_kw": off_kw(run)[step],
        }
    )


def order_lines(run: Trajectory) -> Iterator[str]:
    """The operating order in sentences: each operation of a switch, then customers by time."""
    clock = Clock.of(run)
    of_customers = dict(iter(operating_order(run).groupby("time")))
    for t, time in enumerate(_written(run)):
        when = clock.at(t)
        if SWITCHING_ORDER in run.steps:
            yield from (f"{when}: {each}." for each in run.steps[SWITCHING_ORDER][t].splitlines())
        if time not in of_customers:
            continue
        rows = of_customers[time]
        said = [
            f"{action} {named(list(names), NAMES_SHOWN)}"
            for action, names in rows.groupby("action", sort=True)["customer"]
        ]
        yield f"{when}: {'; '.join(said)}. Off then: {float(rows['off_kw'].iloc[0]):,.1f} kW."


def _written(run: Trajectory) -> list[str]:
    """Times of the steps as the order has them."""
    return list(run.steps["time"].dt.strftime("%Y-%m-%dT%H:%M:%SZ"))


def shown_orders(run: Trajectory) -> list[str]:
    """The operating order for a page or a terminal; of a long one the beginning."""
    lines = list(order_lines(run))
    more = len(lines) - ORDERS_SHOWN
    return lines[:ORDERS_SHOWN] + ([f"{more} more times in {ORDER_FILE}."] if more > 0 else [])


def off_sentence(run: Trajectory) -> str:
    """Customers off over time, in a sentence; empty if all are always on."""
    off = off_kw(run)
    if not off.any():
        return ""
    clock, t = Clock.of(run), int(off.argmax())
    without = off > 0.0
    hours = float(without.sum()) * run.scenario.grid.dt_h
    return (
        f"Off supply: {off[without].mean():,.1f} kW on average over {hours:g} h, at most "
        f"{off[t]:,.1f} kW at {clock.at(t)}."
    )
