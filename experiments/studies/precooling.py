"""What pre-cooling is worth: the heat-wave day with homes whose thermostats are held, or not.

``python -m experiments.studies.precooling`` writes the table of ``docs/cooling.md``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import typer

from benchmarks.frame.pages import markdown_table, put_into
from vppres import RunOptions, load_scenario
from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation
from vppres.day.assembly import make_controller
from vppres.day.simulate import Day
from vppres.day.trajectory import Trajectory
from vppres.kinds.cooling import ThermalLoads
from vppres.kinds.cooling.physics import Climate
from vppres.scenario.scenario import Scenario

PAGE = Path(__file__).parents[2] / "docs" / "cooling.md"
BEGIN, END = "<!-- precooling -->", "<!-- end -->"
HOMES = 20
LAMBDA_GRID = 1e-7
"""Price of energy at which the comfort of so many homes is dearer."""


def heat_wave(name: str, seed: int) -> Scenario:
    """A packaged day with homes behind customers that are drawn; those of its own if it has any."""
    day: Scenario = load_scenario(name)
    if len(day.thermal_loads):
        return day
    rng = np.random.default_rng(seed)
    owners = np.sort(rng.choice(len(day.customers.id), HOMES, replace=False))
    same = {"heats": False, "p_max_kw": 2.0, "cop": 3.5, "cop_at_c": 35.0, "cop_per_c": -0.06}
    band = {"t_min_c": 20.0, "t_max_c": 26.0, "t_initial_c": 24.0, "around_c": np.nan}
    loads = ThermalLoads(
        id=np.array([f"home{i:02d}" for i in range(HOMES)], dtype=object),
        customer=day.customers.id[owners],
        r_c_per_kw=rng.uniform(4.0, 7.0, HOMES),
        c_kwh_per_c=rng.uniform(5.0, 10.0, HOMES),
        gain_kw=rng.uniform(0.3, 0.7, HOMES),
        **{name: np.full(HOMES, value) for name, value in {**same, **band}.items()},
    )
    cheap = replace(day.objective, lambda_grid=LAMBDA_GRID)
    return replace(day, thermal_loads=loads, objective=cheap)


class HeldThermostats:
    """The same controller, whose thermostats stay at the top of the band until the grid is lost.

    Parameters
    ----------
    inner : Decider
        The controller.
    day : Day
        The day that it runs.
    """

    def __init__(self, inner: Decider, day: Day) -> None:
        self.inner = inner
        self.day = day

    def horizon_steps(self, t0: int) -> range:
        """Steps for which the controller wants a forecast."""
        return self.inner.horizon_steps(t0)

    def decide(self, observation: Observation) -> Decision:
        """The controller's decision, without power that cools below the band's top."""
        decision = self.inner.decide(observation)
        t, plan = observation.t0, decision.dispatch
        if "thermal_loads" not in plan.taken_kw or self.day.scenario.outage[: t + 1].any():
            return decision
        loads = self.day.scenario.thermal_loads
        climate = self.day.plant.of(Climate)
        held_kw = climate.thermostat_kw(t, loads.held_c, plan.served[decision.row])
        kept_kw = plan.taken_kw["thermal_loads"].copy()
        kept_kw[decision.row] = np.minimum(kept_kw[decision.row], held_kw)
        return replace(decision, dispatch=plan.acting("thermal_loads", kept_kw))


def run(scenario: Scenario, held: bool) -> Trajectory:
    """The day, with thermostats held until the outage or not."""
    options = RunOptions(isolate=False)
    day = Day(scenario, options)
    controller = make_controller(scenario, options)
    return day.run(HeldThermostats(controller, day) if held else controller)


def of_rooms(found: Trajectory) -> pd.DataFrame:
    """Hours and K h above the band in outages, by room."""
    rows = found.thermal_loads
    assert rows is not None
    day = found.scenario
    dark = dict(zip(day.grid.times, day.outage, strict=True))
    rows = rows[rows["time"].map(dark)]
    over_c = np.maximum(rows["t_end_c"] - rows["t_max_c"], 0.0)
    return (
        rows.assign(hours=(over_c > 1e-6) * day.grid.dt_h, k_h=over_c * day.grid.dt_h)
        .groupby(["tier", "thermal_load"])
        .agg(hours=("hours", "sum"), k_h=("k_h", "sum"))
        .reset_index()
    )


def compared(name: str, seeds: Iterable[int]) -> list[tuple[str, ...]]:
    """A row for each tier: rooms, and means of a room without pre-cooling and with it."""
    both = {
        held: pd.concat(of_rooms(run(heat_wave(name, seed), held)) for seed in seeds)
        for held in (True, False)
    }
    rows = []
    for tier in load_scenario(name).tiers:
        means = {held: each[each["tier"] == tier] for held, each in both.items()}
        if not len(means[True]):
            continue
        cells = [
            f"{means[held][column].mean():.{digits}f}"
            for column, digits in (("hours", 2), ("k_h", 2))
            for held in (True, False)
        ]
        rows.append((tier, str(len(means[True])), *cells))
    return rows


def main(days: int = 5) -> None:
    """Write the table into the documentation; homes of the heat-wave day are drawn so often."""
    heads = ("hours above the band", "K h above it")
    sides = [f"{head}, {side}" for head in heads for side in ("held", "pre-cooled")]
    table = markdown_table(("tier", "rooms", *sides), compared("uk-heatwave-2022", range(days)))
    put_into(PAGE, table, BEGIN, END)
    typer.echo(table)


if __name__ == "__main__":
    typer.run(main)
