"""Fallbacks with flexible power: sets go on, vehicles charge, and both give way to service."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.sets import gensets
from tests.support.small_windows import DARK, OPEN, battery, two_buses
from tests.support.vans import van
from vppres import RunOptions
from vppres.contract.decision import Decision
from vppres.contract.observation import Observation
from vppres.control.guard.guard import GuardedController
from vppres.control.guard.options import GuardOptions
from vppres.control.mpc import MPCController
from vppres.day.recorder import StepRecord
from vppres.day.simulate import Day
from vppres.kinds.gensets import Refuels
from vppres.model.site import Site
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario
from vppres.solve.ladder import WindowSolver


def played(day: Scenario, failing: range, horizon_h: float = 0.0) -> list[StepRecord]:
    """A day in which the solver dies in some steps, with plans that end with their step."""

    class Mortal(MPCController):
        def decide(self, observation: Observation) -> Decision:
            if observation.t0 in failing:
                raise RuntimeError("gone")
            return super().decide(observation)

    def controller_of(site: Site) -> Mortal:
        return Mortal(WindowSolver(site), day.grid, horizon_h)

    guard = GuardedController(controller_of, WindowSolver, Site.of(day), GuardOptions(day.tiers))
    run = Day(day, RunOptions(mode="paper"))
    for t in range(day.grid.n_steps):
        run.step(guard, t)
    return list(run.recorder.records)


def powered(limits_kw: list[float], load_kw: list[float] | None = None, **more: Any) -> Scenario:
    loads = load_kw or [50.0] * len(limits_kw)
    day = two_buses([[kw] for kw in loads], [1.0], limits_kw, r_ohm=1e-6)
    return replace(day, gensets=gensets(**more))


def given_kw(records: list[StepRecord]) -> list[float]:
    return [float(np.round(one.kinds["gensets"]["p_kw"][0], 6)) for one in records]


def test_a_set_goes_on_by_rule_as_long_as_it_has_fuel() -> None:
    """80 l are enough for 3 h at 50 kW, which burns 20.715 l, and 50 kW from 17.9 l are not."""
    records = played(powered([DARK] * 5, fuel_level_litres=80.0), range(1, 5))
    assert [one.steps["fallback"] for one in records] == ["none"] + ["rule"] * 4
    assert given_kw(records) == [50.0] * 3 + [0.0] * 2
    assert [bool(one.customers["served"][0]) for one in records] == [True] * 3 + [False] * 2


@pytest.mark.parametrize(
    ("load_kw", "set_kw"),
    [
        (80.0, 80.0),  # it follows
        (20.0, 0.0),  # less than its least power, and nobody takes the rest
    ],
)
def test_a_set_follows_the_demand_or_stops(load_kw: float, set_kw: float) -> None:
    records = played(powered([DARK] * 2, [50.0, load_kw]), range(1, 2))
    assert given_kw(records) == [50.0, set_kw]
    assert bool(records[1].customers["served"][0]) == (set_kw > 0.0)


def test_a_battery_takes_what_a_set_gives_beyond_the_demand() -> None:
    day = replace(powered([DARK] * 2, [50.0, 20.0]), batteries=battery())
    records = played(day, range(1, 2))
    assert given_kw(records)[1] == given_kw(records)[0] > 0.0
    assert records[1].batteries["charge_kw"][0] == pytest.approx(given_kw(records)[1] - 20.0)


def test_a_set_that_is_off_is_not_started_by_rule() -> None:
    assert given_kw(played(powered([OPEN, DARK]), range(1, 2))) == [0.0, 0.0]


@pytest.mark.parametrize("only_in_outage", [True, False])
def test_a_set_for_outages_stops_by_rule_when_the_grid_is_back(only_in_outage: bool) -> None:
    records = played(powered([DARK, OPEN], only_in_outage=np.array([only_in_outage])), range(1, 2))
    assert records[1].steps["fallback"] == "rule"
    assert (given_kw(records)[1] == 0.0) == only_in_outage
    assert records[1].customers["served"][0]


@pytest.mark.parametrize(
    ("limits_kw", "charging_kw"),
    [(OPEN, 7.4), (DARK, 0.0), (50.0, 0.0)],  # 50 kW are the demand: it comes first
)
def test_vehicles_charge_by_rule_while_there_is_grid(limits_kw: float, charging_kw: float) -> None:
    day = two_buses([[50.0]] * 2, [1.0], [limits_kw] * 2, r_ohm=1e-6)
    charger, vehicle = van(day.grid.start, day.grid.end)
    day = replace(day, chargers=replace(charger, bus=[2]), sessions=vehicle)
    row = played(day, range(2))[1].kinds["chargers"]
    assert row["p_kw"][0] == pytest.approx(charging_kw)


def test_the_previous_plan_runs_what_it_planned() -> None:
    day = powered([DARK] * 3)
    charger, vehicle = van(day.grid.start, day.grid.end)
    day = replace(day, chargers=replace(charger, bus=[2]), sessions=vehicle)
    plan, failed = (played(day, failing, horizon_h=2.0) for failing in (range(0), range(1, 3)))
    assert [one.steps["fallback"] for one in failed] == ["none"] + ["previous_plan"] * 2
    assert given_kw(failed) == pytest.approx(given_kw(plan), abs=1e-3)
    assert given_kw(failed)[1] > 50.0  # it charges the van too


@pytest.mark.parametrize("failing", [range(0), range(5)])
def test_the_largest_set_that_can_run_holds_a_part(failing: range) -> None:
    """Without a solver too: the larger one gets fuel for a step only when the smaller has none."""
    day = powered(
        [OPEN] * 5,
        count=2,
        p_max_kw=np.array([80.0, 100.0]),
        fuel_level_litres=np.array([45.0, 0.0]),
        grid_forming=True,
    )
    times, dt = day.grid.times, day.grid.step
    refuels = Refuels(["g1"], [times[3]], [100.0])
    inductive = replace(day.customers, power_factor=np.full(1, 0.9))
    fault = LineFault(times[1], times[3] + dt, line=day.network.to_bus[0])
    day = replace(day, customers=inductive, faults=(fault,), refuels=refuels)
    records = played(day, failing, horizon_h=2.0)
    assert {one.steps["fallback"] for one in records} == {"rule" if failing else "none"}
    assert all(one.customers["served"].all() for one in records)
    assert given_kw(records) == [0.0, 50.0, 50.0, 0.0, 0.0]
    given_kvar = np.round([one.kinds["gensets"]["q_kvar"] for one in records], 1)
    assert given_kvar.argmax(axis=1).tolist() == [0, 0, 0, 1, 0]
