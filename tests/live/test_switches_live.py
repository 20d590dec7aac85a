"""Switches that others move: live plans are of the feeder as its switches are read."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.support.switched import switched_day
from tests.support.switching_service import switched
from tests.support.three_phases import three_phases
from tests.support.tiny_day import tiny_scenario
from vppres import Controller, Measurement, RunOptions, run_day
from vppres.core.errors import InputError
from vppres.day.configured import configurations_of
from vppres.live.set_points import SetPoints
from vppres.scenario.configuration import Branches
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario

PAPER = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
HOUR = pd.Timedelta(hours=1)


def out_of_2_3() -> Scenario:
    """The tiny feeder with grid, a tie from 3 to 4, and line 2-3 out from the second step on."""
    day = switched()
    begin = day.grid.times[1]
    fault = LineFault(begin, begin + 5 * HOUR, line=3)
    return replace(day, grid_limit_kw=np.full(day.grid.n_steps, np.inf), faults=(fault,))


def stepped(day: Scenario, controller: Controller, t: int, **read: object) -> SetPoints:
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    return controller.step(Measurement(day.grid.times[t], soc, **read))


@pytest.mark.parametrize(
    "mode", ["paper", "physical", pytest.param("by phase", marks=pytest.mark.daily)]
)
def test_a_tie_that_is_read_as_closed_supplies_what_a_fault_cut_off(mode: str) -> None:
    day = out_of_2_3()
    if mode == "by phase":
        day, mode = three_phases(day), "physical"
    options = replace(PAPER, mode=mode)
    controller = Controller.of(day, options)
    assert stepped(day, controller, 0).switches_open == ("t",)
    cut = stepped(day, controller, 1)
    assert cut.customers["served"].tolist() == [True, False, True]
    assert np.isnan(cut.buses["v_ac_pu"][3])
    points = stepped(day, controller, 1, closed={"t": True, "s": False})
    assert points.switches_open == ("s",)
    assert points.customers["served"].all()
    assert points.solve["fallback"] == "none"
    # The shop hangs at the end of the tie, behind bus 4.
    v_pu = points.buses["v_ac_pu"]
    assert v_pu[3] < v_pu[4] < v_pu[2]
    # A switch that is not read again stays where it was, also after a restart.
    saved = json.loads(json.dumps(controller.state()))
    for again in (controller, Controller.of(day, options, state=saved)):
        later = stepped(day, again, 2)
        assert later.switches_open == ("s",) and later.customers["served"].all()
    # Decided again after it has opened.
    assert not stepped(day, controller, 2, closed={"t": False}).customers["served"]["shop"]


@pytest.mark.daily
@pytest.mark.parametrize("seed", [1, 2, 4, 5, 7, 9, 11, 13, 15, 16, 17, 18])
def test_a_controller_decides_as_the_day_in_which_the_switches_move(seed: int) -> None:
    """With what the simulated day switched as readings, each step is planned as it was there."""
    check_decided_as_there(switched_day(seed), PAPER)


@pytest.mark.daily
@pytest.mark.parametrize("seed", [2, 5])
def test_a_controller_decides_by_phase_as_the_day_in_which_the_switches_move(seed: int) -> None:
    day = switched_day(seed)
    wide = replace(day.batteries, s_max_kva=np.full(len(day.batteries), 600.0))
    day = three_phases(replace(day, batteries=wide))
    check_decided_as_there(day, replace(PAPER, mode="physical"))


def check_decided_as_there(day: Scenario, options: RunOptions) -> None:
    """A live controller's customers and voltages, step by step, against those of the day."""
    run = run_day(day, replace(options, move_switches=True))
    closed = configurations_of(run)
    if closed is None or run.steps["switching_ahead"].any():
        pytest.skip("no switch moves, or a plan counts on one that moves later")
    branches, live = Branches.of(day), Controller.of(day, options)
    soc = run.by_step("batteries", "soc_start")
    for t, now in enumerate(closed):
        held = dict(zip(day.batteries.id, soc[t], strict=True))
        points = live.step(Measurement(day.grid.times[t], held, closed=branches.states(now)))
        served = run.by_step("customers", "served")[t]
        assert points.customers["served"].tolist() == served.tolist()
        v_pu = run.by_step("buses", "v_ac_pu")[t]
        np.testing.assert_allclose(points.buses["v_ac_pu"], v_pu, atol=1e-9)
        live = Controller.of(day, options, state=json.loads(live.saved()))


def test_a_switch_that_closes_a_loop_is_named_and_left_open_in_the_plan() -> None:
    day = switched()
    controller = Controller.of(day, PAPER)
    stepped(day, controller, 0)
    points = stepped(day, controller, 1, closed={"t": True})
    assert points.switches_open == ("t",)
    assert points.solve["estimated"] == "t closes a loop, and is open in the plan"
    # Once the loop is opened, the tie is where the supply comes from.
    points = stepped(day, controller, 2, closed={"t": True, "s": False})
    assert points.switches_open == ("s",) and points.solve["estimated"] == ""


def test_states_of_switches_are_refused_with_all_that_is_wrong() -> None:
    controller = Controller.of(switched(), PAPER)
    at = switched().grid.times[0]
    with pytest.raises(InputError, match=r"closed of t.* is neither true nor false") as refused:
        controller.step(Measurement(at, closed={"t": 2, "u": True}))
    assert "closed = u: is not in the scenario" in str(refused.value)


def test_where_no_switch_moves_a_site_with_switches_is_planned_as_one_without() -> None:
    site = switched()
    plain = replace(site, switches=tiny_scenario().switches)
    one, other = Controller.of(site, PAPER), Controller.of(plain, PAPER)
    for t in range(3):
        ours, theirs = stepped(site, one, t), stepped(plain, other, t)
        pd.testing.assert_frame_equal(ours.batteries, theirs.batteries)
        pd.testing.assert_frame_equal(ours.buses, theirs.buses)


@pytest.mark.parametrize("by_phase", [False, pytest.param(True, marks=pytest.mark.daily)])
def test_what_a_switch_would_serve_is_proposed_and_gone_once_it_is_closed(by_phase: bool) -> None:
    day = three_phases(out_of_2_3()) if by_phase else out_of_2_3()
    options = replace(PAPER, mode="physical" if by_phase else "paper", move_switches=True)
    controller = Controller.of(day, options)
    waits = stepped(day, controller, 0).proposal  # the fault of the next step is known
    assert (waits.closed, waits.operations) == ({}, "closed t, opened s")
    proposed = stepped(day, controller, 1).proposal
    assert proposed.closed == {"t": True, "s": False}
    assert proposed.why == "closing t serves 1 customer until 05:00"
    opened, closed = proposed.order
    assert opened.startswith("open s: it has carried nothing since the fault")
    assert closed.startswith("close t: it supplies customer shop")
    saved = json.loads(json.dumps(controller.state()))
    again = Controller.of(day, options, state=saved)
    done = stepped(day, again, 2, closed={"t": True})
    assert done.customers["served"].all()
    assert (done.proposal.operations, done.proposal.why) == ("", "all customers are served")
    # A service may be started again with the option, or without it.
    plain = replace(options, move_switches=False)
    assert stepped(day, Controller.of(day, plain, state=saved), 2).proposal.why == ""
