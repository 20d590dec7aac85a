"""The feeder of the homes and the study of what forecasts cost on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data.homes.build import HELD_OUT, homes
from experiments.studies.homes import FORECASTERS, Run, day_of, write_report
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io.python_door import check_scenario


def test_a_day_of_the_homes() -> None:
    day = homes(HELD_OUT, 24, (12, 15))
    check_scenario(day)
    assert (len(day.customers), len(day.pv), day.network.n_buses) == (17, 17, 19)
    assert np.flatnonzero(day.outage).tolist() == [12, 13, 14]
    assert day.history.end == day.grid.start
    assert day.history.n_steps == 100 * 24


def test_the_report_holds_the_differences(tmp_path: Path) -> None:
    days = [
        [
            Run(seed, name, 0.9 - 0.01 * i, 10.0 + i, 1.0, 5.0, 0, 1.0)
            for i, name in enumerate(FORECASTERS)
        ]
        for seed in range(3)
    ]
    text = write_report(days, 60.0, tmp_path).read_text()
    assert "0.0100 [0.0100, 0.0100]" in text
    assert "2.00 [2.00, 2.00]" in text
    assert (tmp_path / "homes.svg").is_file()


def test_a_zero_below_zero_in_a_dispatch_of_known_modes_is_no_fault() -> None:
    run = run_day(day_of(3), RunOptions(horizon_h=6.0))
    assert run.steps["fallback"].tolist() == ["none"] * len(run.steps)
