"""A day told phase by phase, from the tables of its explanation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import pandas as pd

from vppres.day.priority import ranks_of
from vppres.day.trajectory import Trajectory
from vppres.explain.reason import DRIVERS
from vppres.explain.words import hours, money
from vppres.report.clock import Clock
from vppres.scenario.priority import Ranks


@dataclass(frozen=True)
class Episode:
    """Consecutive steps of one phase: when, what happened, and each step's own sentence."""

    phase: str
    start: str
    end: str
    told: list[str]
    steps: list[tuple[str, str]]


@dataclass(frozen=True, eq=False)
class Tables:
    """The rows of a run that belong to some of its steps."""

    steps: pd.DataFrame
    customers: pd.DataFrame
    batteries: pd.DataFrame
    explanations: pd.DataFrame
    shadow_prices: pd.DataFrame
    dt_h: float
    ranks: Ranks | None

    @classmethod
    def of(
        cls,
        run: Trajectory,
        explanations: pd.DataFrame,
        shadow_prices: pd.DataFrame,
        times: list[pd.Timestamp],
    ) -> Tables:
        """The rows of these times."""
        tables = {
            "steps": run.steps,
            "customers": run.customers,
            "batteries": run.batteries,
            "explanations": explanations,
            "shadow_prices": shadow_prices,
        }
        rows = {name: table[table["time"].isin(times)] for name, table in tables.items()}
        ranks = ranks_of(run.scenario, run.options)
        return cls(**rows, dt_h=run.scenario.grid.dt_h, ranks=ranks)


def episodes(
    run: Trajectory, explanations: pd.DataFrame, shadow_prices: pd.DataFrame
) -> list[Episode]:
    """The day as consecutive phases, of a run and its tables of these names."""
    of_steps = explanations[explanations["item"] == "step"].to_dict("records")
    step = run.scenario.grid.step
    clock = Clock.of(run)
    found = []
    for phase, group in groupby(of_steps, key=itemgetter("phase")):
        rows = list(group)
        times = [row["time"] for row in rows]
        tables = Tables.of(run, explanations, shadow_prices, times)
        found.append(
            Episode(
                phase,
                clock.words(times[0]),
                clock.words(times[-1] + step),
                told(tables),
                [(clock.words(row["time"]), row["words"]) for row in rows],
            )
        )
    return found


def told(tables: Tables) -> list[str]:
    """Story of some steps: service, batteries, and the value of one more unit."""
    sentences = [_service(tables), _batteries(tables), *_worth(tables)]
    return [sentence for sentence in sentences if sentence]


def _service(tables: Tables) -> str:
    """Sentence on customers that were served, and reasons of the others."""
    served = tables.customers.groupby("time")["served"].sum()
    total = len(tables.customers) // max(len(served), 1)
    if served.min() == total:
        return f"All {total} customers were supplied."
    low = int(served.min())
    high = int(served.max())
    many = f"{low}" if low == high else f"{low} to {high}"
    out = tables.explanations[tables.explanations["action"] == "not_served"]
    why = ", ".join(
        f"{DRIVERS[str(driver)]} {count}" for driver, count in out["driver"].value_counts().items()
    )
    return f"{many} of {total} customers were supplied; reasons for the others, by step: {why}."


def _batteries(tables: Tables) -> str:
    """Energy that the fleet charged and discharged."""
    into = float(tables.batteries["charge_kw"].sum()) * tables.dt_h
    out = float(tables.batteries["discharge_kw"].sum()) * tables.dt_h
    parts = [
        f"{verb} {energy:,.0f} kWh"
        for verb, energy in (("charged", into), ("discharged", out))
        if energy >= 1.0
    ]
    return f"The batteries {' and '.join(parts)}." if parts else "The batteries were idle."


def _worth(tables: Tables) -> list[str]:
    """Value of one more unit, as ranges over the steps."""
    stored = _range(tables, "stored_energy", "weighted_h")
    sentences = []
    if stored:
        sentences.append(f"One more stored kWh would have added {stored}.")
    elif saved := _range(tables, "stored_energy", "gbp"):
        sentences.append(f"One more stored kWh would have saved {saved}.")
    for name, what in (
        ("energy_ceiling", "One more kWh of battery capacity"),
        ("reactive", "One more kvar"),
        ("battery_inverter", "One more kVA of a battery's inverter"),
        ("voltage_floor", "A voltage limit 0.001 pu lower"),
    ):
        if value := _range(tables, name, "weighted_h"):
            sentences.append(
                f"{what} would have added {value}{_where(tables.shadow_prices, name)}."
            )
    return sentences


def _range(tables: Tables, name: str, column: str) -> str:
    """Smallest to largest positive worth over the steps, of the best item of each; else empty."""
    prices = tables.shadow_prices
    best = prices[prices["constraint"] == name].groupby("time")[column].max()
    best = best[best > 0]
    if best.empty:
        return ""
    ends = float(best.min()), float(best.max())
    customers = tables.customers
    load_kw = customers["p_load_kw"].to_numpy(float).reshape(-1, customers["id"].nunique())
    low, high = (
        money(end) if column == "gbp" else hours(end, tables.ranks, load_kw) for end in ends
    )
    unit = " weighted customer hours"
    return low if low == high else f"{low.removesuffix(unit)} to {high}"


def _where(prices: pd.DataFrame, name: str) -> str:
    """The item at which a unit was worth most, of limits that belong to a place."""
    if name not in ("reactive", "voltage_floor"):
        return ""
    rows = prices[prices["constraint"] == name].sort_values("weighted_h", ascending=False)
    return f", most at bus {rows['item'].iloc[0]}"
