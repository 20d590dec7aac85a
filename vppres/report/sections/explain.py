"""Decisions, binding limits and shadow prices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd

from vppres.day.trajectory import Trajectory
from vppres.explain.reason import DRIVERS
from vppres.explain.words import figure, money
from vppres.kinds.customer import reasons as customer
from vppres.kinds.table import parts
from vppres.report.clock import Clock
from vppres.report.plots.figures import worth_of_energy
from vppres.report.sections.base import Run, figure_of
from vppres.report.sections.narrative import episodes

Row = dict[str, Any]

WORTH_TEXT = (
    "Value of one more stored kWh at the start of each step: service (above) if it limits supply, "
    "otherwise money (below)."
)
"""What the figure of the worth shows."""

MOST_NAMED = 3
"""Items of a limit that are named one by one."""

LIMITS = {
    "energy_floor": "lower SoC limit",
    "energy_ceiling": "upper SoC limit",
    "battery_charging": "charging power",
    "battery_discharging": "discharging power",
    "battery_inverter": "battery inverter",
    "pv_inverter": "PV inverter",
    "voltage_floor": "lowest voltage at bus",
    "voltage_ceiling": "highest voltage at bus",
    "line_rating": "rating of line",
    "grid": "grid limit",
}
ACTIONS = {
    **customer.ACTIONS,
    "charge": "battery charged",
    "discharge": "battery discharged",
    "curtail": "PV system curtailed",
    **{name: words for of in parts("words").values() for name, words in of.ACTIONS.items()},
}


def explain_of(run: Run) -> dict[str, Any] | None:
    """The day in words, what bound in each step, reasons counted; None without an explanation.

    :func:`vppres.explain.day.explain_day` makes the tables that are shown here.
    """
    trajectory = run.trajectory
    explanations = trajectory.explanations
    prices = trajectory.shadow_prices
    if explanations is None or prices is None:
        return None
    clock = Clock.of(trajectory)
    rows = explanations[explanations["item"] == "customer"]
    return {
        "episodes": episodes(trajectory, explanations, prices),
        "steps": _steps(trajectory, prices, _counts(run)),
        "reasons": _reasons(explanations),
        "people": [
            {"time": clock.words(row["time"]), "id": row["id"], "words": row["words"]}
            for row in rows.to_dict("records")
        ],
        "figure": figure_of(worth_of_energy(trajectory), WORTH_TEXT),
    }


def _counts(run: Run) -> dict[str, int]:
    """How many items each family of limits has."""
    s = run.trajectory.scenario
    return {
        name: len(s.pv) if name.startswith("pv") else len(s.batteries)
        for name in LIMITS
        if name.startswith(("energy", "battery", "pv"))
    }


def _steps(run: Trajectory, prices: pd.DataFrame, counts: dict[str, int]) -> list[Row]:
    """One row for each step: limits that bound, and what one more unit was worth."""
    clock = Clock.of(run)
    rows = []
    of_step: dict[Any, dict[str, pd.DataFrame]] = {}
    for (time, name), found in prices.groupby(["time", "constraint"]):
        of_step.setdefault(time, {})[str(name)] = found
    for step in run.steps[["time", "phase", "outage"]].to_dict("records"):
        now = of_step.get(step["time"], {})
        rows.append(
            {
                "time": clock.words(step["time"]),
                "phase": step["phase"],
                "outage": bool(step["outage"]),
                "limits": _limits(now, counts),
                "kwh": _worth(now, "stored_energy"),
                "kw": _worth(now, "active"),
                "kvar": _worth(now, "reactive"),
            }
        )
    return rows


def _limits(prices: Mapping[str, pd.DataFrame], counts: dict[str, int]) -> str:
    """The limits that bound in a step, each with its items."""
    texts = []
    for name, words in LIMITS.items():
        if name not in prices:
            continue
        items = prices[name]["item"].tolist()
        if name == "grid":
            texts.append(words)
        elif len(items) == counts.get(name):
            texts.append(f"{words} (all)")
        else:
            named = ", ".join(items) if len(items) <= MOST_NAMED else f"{len(items)} of them"
            texts.append(f"{words} ({named})" if name in counts else f"{words} {named}")
    return "; ".join(texts)


def _worth(prices: Mapping[str, pd.DataFrame], name: str) -> str:
    """The largest worth of a unit: in weighted customer hours, otherwise in GBP."""
    if name not in prices:
        return ""
    rows = prices[name]
    where = "" if name == "stored_energy" else f", bus {rows['item'].iloc[0]}"
    if (rows["weighted_h"] != 0).any() and rows["weighted_h"].notna().any():
        return f"{figure(float(rows['weighted_h'].max()))} h{where}"
    gbp = rows["gbp"].dropna()
    return f"{money(float(gbp.max()))}{where}" if len(gbp) and gbp.max() > 0 else ""


def _reasons(explanations: pd.DataFrame) -> list[Row]:
    """How often each reason drove each kind of action."""
    actions = explanations[explanations["item"] != "step"]
    groups = actions.groupby(["action", "driver", "binding"])["words"]
    rows = [
        {
            "action": ACTIONS[str(action)],
            "driver": DRIVERS[str(driver)],
            "binding": DRIVERS.get(str(binding), ""),
            "count": len(words),
            "example": words.iloc[0],
        }
        for (action, driver, binding), words in groups
    ]
    return sorted(rows, key=lambda row: (row["action"], -int(row["count"])))
