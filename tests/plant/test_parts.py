"""Steps in which lines are out, part by part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.faulted import faulted_day
from vppres.contract.decision import Decision
from vppres.core.arrays import Floats
from vppres.day.assembly import make_controller
from vppres.day.options import RunOptions
from vppres.day.simulate import Day
from vppres.plant.collapse import realise
from vppres.plant.island import Settled
from vppres.plant.parts import PlantInParts
from vppres.scenario.faults import OutOfService, parts_by_bus
from vppres.scenario.scenario import Scenario

PAPER = RunOptions(mode="paper", horizon_h=2.0, isolate=False)


def first_decision(day: Scenario) -> tuple[Day, Decision]:
    run = Day(day, PAPER)
    controller = make_controller(day, PAPER)
    return run, controller.decide(run.observe(controller, 0))


def settled(day: Scenario, seed: int, nothing_out: bool = False) -> tuple[OutOfService, Settled]:
    """The first step, decided without knowing of any fault, with two random lines out."""
    run, decision = first_decision(replace(day, faults=()))
    rng = np.random.default_rng(seed)
    net = day.network
    lines = np.zeros((1, net.n_lines), dtype=bool)
    if not nothing_out:
        lines[0, rng.choice(net.n_lines, size=2, replace=False)] = True
    out = OutOfService(lines, np.zeros((1, net.n_buses), dtype=bool))
    every = np.ones(len(day.batteries), dtype=bool)
    return out, PlantInParts(run.plant).settle(0, decision, run.state, out, False, every)


def sums(day: Scenario, out: OutOfService, values: Floats) -> Floats:
    return np.bincount(parts_by_bus(day.network, out.lines)[0], values, day.network.n_buses)


@pytest.mark.parametrize("seed", range(30))
def test_each_island_part_balances_with_its_losses(seed: int) -> None:
    day = faulted_day(seed)
    out, done = settled(day, seed)
    given_kw = sums(day, out, done.p_injection_kw)
    lost_kw = np.zeros(day.network.n_buses)
    lost_kw[1:] = done.ac.p_from_kw - done.ac.p_to_kw
    lost_kw = sums(day, out, lost_kw)
    assert np.abs(given_kw - lost_kw)[1:].max() < 1e-5
    assert done.ac.p_slack_kw == pytest.approx(lost_kw[0] - given_kw[0], abs=1e-5)
    assert not np.abs(done.ac.p_from_kw[out.lines[0]]).any()
    # Who is off has a reason, or was shed in a part that is lit.
    dark = done.off != ""
    assert not done.served[dark].any()
    at = [day.network.bus_index[bus] for bus in day.customers.bus]
    np.testing.assert_array_equal(np.isnan(done.ac.v_pu[at]), dark)
    for reason in set(done.off[dark]):
        assert reason.startswith("no battery forms the grid behind line ")


def test_one_part_is_the_whole_feeder() -> None:
    day = faulted_day(1)
    _, done = settled(day, 1, nothing_out=True)
    run, decision = first_decision(replace(day, faults=()))
    whole = realise(run.plant, run.ac, 0, decision, run.state)
    for name in ("served", "charge_kw", "discharge_kw", "soc_end", "p_injection_kw"):
        np.testing.assert_array_equal(getattr(done, name), getattr(whole, name))
    np.testing.assert_array_equal(done.ac.v_pu, whole.ac.v_pu)
    assert done.ac.p_slack_kw == whole.ac.p_slack_kw
