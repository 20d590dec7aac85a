"""Faults of lines in live control: reported, changed, repaired, and the same as simulated days."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.support.faulted import faulted_day
from tests.support.three_phases import three_phases
from vppres import Controller, Measurement, RunOptions, run_day
from vppres.core.errors import InputError
from vppres.live.set_points import SetPoints
from vppres.scenario.faults import LineFault
from vppres.scenario.scenario import Scenario

PAPER = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
NOON, HOUR = pd.Timestamp("2022-07-19T12:00Z"), pd.Timedelta(hours=1)


def stepped(day: Scenario, controller: Controller, t: int, soc: np.ndarray) -> SetPoints:
    """The decision on a step of a day."""
    names = day.batteries.id
    return controller.step(Measurement(day.grid.times[t], dict(zip(names, soc, strict=True))))


@pytest.mark.daily
@pytest.mark.parametrize("seed", range(4))
def test_a_controller_decides_as_the_simulated_day(seed: int) -> None:
    day = faulted_day(seed)
    run = run_day(day, PAPER)
    controller = Controller.of(day, PAPER)
    soc = run.by_step("batteries", "soc_start")
    for t in range(day.grid.n_steps):
        points = stepped(day, controller, t, soc[t])
        assert " and ".join(points.lines_out) == run.steps["lines_out"][t]
        assert points.customers["served"].tolist() == run.by_step("customers", "served")[t].tolist()
        why = run.by_step("customers", "off_by_fault")[t]
        assert points.customers["off_by_fault"].tolist() == why.tolist()
        controller = Controller.of(day, PAPER, state=json.loads(controller.saved()))


def test_a_fault_is_reported_to_a_controller_of_your_own(tiny: Scenario) -> None:
    named = replace(tiny.batteries, grid_forming=[True, False])
    day = replace(tiny, batteries=named, grid_limit_kw=np.full(tiny.grid.n_steps, np.inf))
    controller = Controller.of(day, RunOptions(mode="paper", horizon_h=0.0, isolate=False))
    soc = day.batteries.soc_initial
    assert stepped(day, controller, 0, soc).customers["served"].all()
    with pytest.raises(
        InputError, match="faults, row 0, line = 44: is not a bus behind the grid's"
    ):
        controller.report(LineFault(NOON, NOON + HOUR, line=44))
    begin = day.grid.times[1]
    controller.report(LineFault(begin, begin + 2 * HOUR, line=4))
    points = stepped(day, controller, 1, soc)
    assert points.lines_out == ("line 2-4",)
    assert points.customers["served"].tolist() == [True, True, False]
    reason = "no battery forms the grid behind line 2-4, which is out"
    assert points.customers["off_by_fault"].tolist() == ["", "", reason]
    controller.report(replacing=True)  # repaired early
    points = stepped(day, controller, 2, soc)
    assert points.lines_out == ()
    assert points.customers["served"].all()


def test_a_fault_of_a_phased_feeder_is_reported_too(tiny: Scenario) -> None:
    named = replace(tiny.batteries, grid_forming=[True, False])
    day = replace(tiny, batteries=named, grid_limit_kw=np.full(tiny.grid.n_steps, np.inf))
    options = RunOptions(mode="physical", horizon_h=0.0, isolate=False)
    controller = Controller.of(three_phases(day), options)
    begin = day.grid.times[1]
    controller.report(LineFault(begin, begin + HOUR, line=4))
    points = stepped(day, controller, 1, day.batteries.soc_initial)
    assert points.lines_out == ("line 2-4",)
    assert points.customers["served"].tolist() == [True, True, False]
    assert points.by_phase is not None
    assert "4" not in points.by_phase.nodes.index.get_level_values("bus")
