"""Faults of lines in live control: reported, changed, repaired, and the same as simulated days."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from tests.support.faulted import faulted_day
from vppres import Controller, Measurement, RunOptions, run_day
from vppres.live.set_points import SetPoints
from vppres.scenario.scenario import Scenario

PAPER = RunOptions(mode="paper", horizon_h=3.0, isolate=False)
NOON, HOUR = pd.Timestamp("2022-07-19T12:00Z"), pd.Timedelta(hours=1)


def stepped(day: Scenario, controller: Controller, t: int, soc: np.ndarray) -> SetPoints:
    """The decision on a step of a day."""
    names = day.batteries.id
    return controller.step(Measurement(day.grid.times[t], dict(zip(names, soc, strict=True))))


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
