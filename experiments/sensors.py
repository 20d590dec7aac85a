"""Sensors that lie, one or two at a time: ``python -m experiments.sensors``.

Each day runs twice: with the readings of its bad sensors, and with those readings missing while all
others are true. A customer of the first tier that is off in the first run alone was shed for a lie.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import typer

from vppres.contract.observation import Observation
from vppres.core.arrays import Flags, Floats
from vppres.day.assembly import make_controller
from vppres.day.faults import FaultInjector, FaultPlan
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.day.trajectory import Trajectory
from vppres.feeders import import_network
from vppres.feeders.new.options import NewScenarioOptions
from vppres.feeders.new.scenario import new_scenario
from vppres.io.find import load_scenario
from vppres.live.ranges import RANGES, ranges_of
from vppres.scenario.scenario import Scenario

Kind = Literal["watts", "spike", "frozen", "drift", "percent", "swapped", "silent"]
HOURS = (8, 18)
"""First hour of a day, and the first after it: the outage begins at noon."""

HORIZON_H = 4.0
FEEDERS = ("uk-heatwave-2022", "case69", "cigre-mv")
BATTERY_H = 0.25
"""kWh of batteries per kW of peak load: too little for all customers of the first tier."""

DRIFT_PER_STEP = 0.02
LIMIT_TOLERANCE_PU = 1e-4
LIMIT_TOLERANCE_KW = 1.0


@dataclass(frozen=True)
class Lie:
    """What a sensor does from a step on.

    Parameters
    ----------
    quantity : {"soc", "load", "pv"}
        What it measures.
    kind : str
        In W; 100 times too much in every third step; standing still; drifting; in percent; those
        of two devices exchanged; silent.
    items : tuple of int
        Positions of the devices.
    start : int
        First step.
    """

    quantity: Literal["soc", "load", "pv"]
    kind: Kind
    items: tuple[int, ...]
    start: int

    def said(self, true: Floats, first: Floats, t: int) -> Floats:
        """Readings of a quantity at step ``t``; ``first`` are those at the lie's first step."""
        rows = list(self.items)
        values = true.copy()
        since = t - self.start
        if self.kind == "swapped":
            values[rows] = true[rows[::-1]]
        elif self.kind == "spike":
            values[rows] = true[rows] * (100.0 if since % 3 == 0 else 1.0)
        elif self.kind == "frozen":
            values[rows] = first[rows]
        elif self.kind == "drift":
            values[rows] = true[rows] + DRIFT_PER_STEP * since
        elif self.kind == "silent":
            values[rows] = np.nan
        else:
            values[rows] = true[rows] * {"watts": 1000.0, "percent": 100.0}[self.kind]
        return values


class Liars(FaultInjector):
    """Puts lies in the place of readings; what no device can have is missing, as at every door."""

    def __init__(self, lies: Sequence[Lie], scenario: Scenario, silent: bool) -> None:
        super().__init__(FaultPlan(), scenario)
        self.lies = [replace(lie, kind="silent") for lie in lies] if silent else lies
        self._first: dict[Lie, Floats] = {}
        own = ranges_of(scenario)
        ids = {"soc": scenario.batteries.id, "load": scenario.customers.id, "pv": scenario.pv.id}
        self._highest = {
            name: np.array(
                [own.get((_name(name), str(i)), RANGES[_name(name)]).highest for i in ids[name]]
            )
            for name in ids
        }

    def observe(self, true: Observation) -> Observation:
        """What the controller gets to see of an observation."""
        seen = super().observe(true)
        for lie in self.lies:
            if true.t0 >= lie.start:
                now = _readings(seen, lie.quantity)
                values = lie.said(now, self._first.setdefault(lie, now), true.t0)
                most = self._highest[lie.quantity]
                seen = _with(seen, lie.quantity, np.where(values > most, np.nan, values))
        return seen


def _name(quantity: str) -> str:
    return quantity if quantity == "soc" else f"{quantity}_kw"


def _readings(seen: Observation, quantity: str) -> Floats:
    return seen.soc if quantity == "soc" else getattr(seen.forecast, f"{quantity}_kw")[0]


def _with(seen: Observation, quantity: str, values: Floats) -> Observation:
    if quantity == "soc":
        return replace(seen, soc=values)
    rows = np.array(getattr(seen.forecast, f"{quantity}_kw"))
    rows[0] = values
    changed: dict[str, Any] = {f"{quantity}_kw": rows}
    return replace(seen, forecast=replace(seen.forecast, **changed))


@cache
def feeder_day(name: str) -> Scenario:
    """A packaged day, or one on a network of pandapower, around noon."""
    if name == FEEDERS[0]:
        day = load_scenario(name)
    else:
        options = NewScenarioOptions(
            draw_tiers=True, pv="sized", add_batteries=True, battery_kwh_per_peak_kw=BATTERY_H
        )
        day = new_scenario(import_network(name), options)
    return day.between(*HOURS)


def lies_of(day: Scenario, seed: int) -> list[Lie]:
    """The kind by the seed, the devices drawn; every third day has a second bad sensor."""
    rng = np.random.default_rng([seed, 40])
    kinds: tuple[tuple[str, Kind], ...] = (
        ("load", "watts"),
        ("load", "spike"),
        ("load", "frozen"),
        ("soc", "frozen"),
        ("soc", "drift"),
        ("soc", "percent"),
        ("soc", "swapped"),
        ("soc", "silent"),
        ("pv", "watts"),
        ("load", "swapped"),
    )
    first = kinds[seed % len(kinds)]
    second = [kinds[int(rng.integers(len(kinds)))]] if seed % 3 == 2 else []
    return [_drawn(day, rng, *kind) for kind in (first, *second)]


def _drawn(day: Scenario, rng: np.random.Generator, quantity: Any, kind: Kind) -> Lie:
    """Of demand, a customer of the first tier; of the others, any two where two are needed."""
    critical = np.flatnonzero(day.customers.tier == day.tiers[0])
    many = {"soc": len(day.batteries), "pv": len(day.pv), "load": len(day.customers)}[quantity]
    one = int(rng.choice(critical)) if quantity == "load" else int(rng.integers(many))
    items = (one, int((one + rng.integers(1, many)) % many)) if kind == "swapped" else (one,)
    return Lie(quantity, kind, items, int(rng.integers(1, 5)))


def played(day: Scenario, lies: Sequence[Lie], silent: bool) -> Trajectory:
    """The day with the readings as they lie, or with those readings missing."""
    options = RunOptions(horizon_h=HORIZON_H).on(day)
    injector = Liars(lies, day, silent)
    return Day(day, options, injector).run(make_controller(day, options, injector))


def first_tier(run: Trajectory) -> Flags:
    """Who of the first tier is served, (T, C1)."""
    rows = run.customers[run.customers["tier"] == run.scenario.tiers[0]]
    return rows["served"].to_numpy(bool).reshape(len(run.steps), -1)


def beyond_limits(run: Trajectory) -> Flags:
    """Steps with an AC voltage or an import beyond its limit, (T,)."""
    net = run.scenario.network
    low = run.steps["v_min_ac_pu"] < net.v_min_ac_pu - LIMIT_TOLERANCE_PU
    high = run.steps["v_max_ac_pu"] > net.v_max_ac_pu + LIMIT_TOLERANCE_PU
    limit_kw = np.where(run.scenario.outage, np.inf, run.scenario.grid_limit_kw)
    over = run.steps["p_grid_kw"] > limit_kw + LIMIT_TOLERANCE_KW
    return np.asarray(low | high | over)


def row_of(feeder: str, seed: int) -> dict[str, object]:
    """What the lies of a seed did on a feeder."""
    day = feeder_day(feeder)
    lies = lies_of(day, seed)
    lied, missing = (played(day, lies, silent) for silent in (False, True))
    shed = first_tier(missing) & ~first_tier(lied)
    return {
        "feeder": feeder,
        "seed": seed,
        "lies": ", ".join(f"{lie.quantity} {lie.kind} {lie.items}" for lie in lies),
        "off": int((~first_tier(lied)).sum()),
        "off_for_a_lie": int(shed.sum()),
        "steps": np.flatnonzero(shed.any(axis=1)).tolist(),
        "beyond_limits": int((beyond_limits(lied) & ~beyond_limits(missing)).sum()),
        "shed_kw": float(lied.steps.get("shed_kw", pd.Series(0.0)).sum()),
        "named": int((lied.steps["estimated"] != "").sum()),
    }


def main(
    days: Annotated[int, typer.Option(help="Days of each feeder.")] = 10,
    first: Annotated[int, typer.Option(help="Seed of the first one.")] = 0,
    feeder: Annotated[list[str] | None, typer.Option(help="One feeder; may be repeated.")] = None,
) -> None:
    """Count the customers of the first tier that a bad sensor puts off supply."""
    names = feeder or list(FEEDERS)
    seeds = range(first, first + days)
    rows = []
    for name, seed in itertools.product(names, seeds):
        rows.append(row_of(name, seed))
        typer.echo(", ".join(f"{key} {value}" for key, value in rows[-1].items()))
    table = pd.DataFrame(rows)
    for_a_lie = int((table["off_for_a_lie"] > 0).sum())
    beyond = int((table["beyond_limits"] > 0).sum())
    typer.echo(
        f"{len(table)} days: {for_a_lie} shed a customer of the first tier for a lie, {beyond} "
        "break a limit of the grid."
    )


if __name__ == "__main__":
    typer.run(main)
