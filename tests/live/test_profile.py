"""A scenario's days by the clock on the wall: any day of any year, of 23 and of 25 hours too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.support.long_days import repeated
from tests.support.same_steps import same
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.live.profile import ClockProfile
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

CLOCK = np.arange(48) / 2.0
"""A price that is the hour on the clock, in steps of half an hour."""


def london(tiny: Scenario, days: int = 1) -> Scenario:
    """Half-hours from local midnight in summer; the price is the hour on the clock."""
    start = pd.Timestamp("2025-06-30T23:00Z")  # a Monday's end: 1 July is a Tuesday
    day = repeated(tiny, 48 * days)
    grid = TimeGrid(start, 30.0, 48 * days, "Europe/London")
    price = np.tile(CLOCK, days) + 100.0 * np.repeat(np.arange(days), 48)
    return replace(day, grid=grid, price_gbp_per_kwh=price)


@pytest.mark.parametrize(
    ("date", "hours", "skipped_or_twice"),
    [("2026-03-29", 23, []), ("2026-10-25", 25, [1.0, 1.5]), ("2026-07-19", 24, None)],
)
def test_tariffs_follow_the_clock(
    tiny: Scenario, date: str, hours: int, skipped_or_twice: list[float] | None
) -> None:
    profile = ClockProfile.of(london(tiny))
    midnight = pd.Timestamp(date, tz="Europe/London").tz_convert("UTC")
    price = profile.steps(midnight, 2 * hours + 2).price_gbp_per_kwh
    if skipped_or_twice is None:
        expected = list(CLOCK)
    elif skipped_or_twice:  # 01:00 and 01:30 come twice
        expected = [0.0, 0.5, 1.0, 1.5, 1.0, 1.5, *CLOCK[4:]]
    else:  # 00:30 is followed by 02:00
        expected = [0.0, 0.5, *CLOCK[4:]]
    assert price.tolist() == [*expected, 0.0, 0.5]  # and the next day begins at midnight


def test_weekdays_differ_where_there_is_a_week(tiny: Scenario) -> None:
    profile = ClockProfile.of(london(tiny, days=14))
    noon = pd.Timestamp("2026-11-22T12:00", tz="Europe/London")  # a Sunday: days 5 and 12
    assert profile.steps(noon, 1).price_gbp_per_kwh.tolist() == [12.0 + (500.0 + 1200.0) / 2]
    monday = profile.steps(noon + pd.Timedelta("12h"), 1)  # days 6 and 13
    assert monday.price_gbp_per_kwh.tolist() == [(600.0 + 1300.0) / 2]


def test_outages_do_not_repeat_and_limits_do(tiny: Scenario) -> None:
    limit = np.where(np.arange(48) % 12 < 2, 0.0, 300.0 + np.arange(48))
    day = replace(london(tiny), grid_limit_kw=limit)
    again = ClockProfile.of(day).steps(day.grid.start, 48)
    assert not again.outage.any()
    assert again.grid_limit_kw[0] == 302.0 and again.grid_limit_kw[47] == 347.0
    # All the rest is what the scenario says, to the bit.
    for name in ("load_kw", "pv_kw", "price_gbp_per_kwh", "temperature_c"):
        assert (getattr(again, name) == getattr(day, name)).all()


def test_steps_begin_when_they_begin(tiny: Scenario) -> None:
    profile = ClockProfile.of(london(tiny))
    now = pd.Timestamp("2026-11-21T20:47:11Z")
    assert profile.scenario.grid.begun(now) == pd.Timestamp("2026-11-21T20:30Z")
    before = pd.Timestamp("2020-01-01T00:15Z")
    assert profile.scenario.grid.begun(before) == pd.Timestamp("2020-01-01T00:00Z")
    with pytest.raises(InputError, match=r"T20:47:11.00:00: is not the beginning"):
        profile.steps(now, 2)
    with pytest.raises(InputError, match=r"hours = 3.0: does not fill a day"):
        ClockProfile.of(replace(tiny, grid=replace(tiny.grid, step_minutes=30.0)))


def test_a_controller_rolls_over_a_day_of_25_hours(tiny: Scenario) -> None:
    """Fed from the profile as time goes, it decides as one that knew both days."""
    profile = ClockProfile.of(london(tiny))
    midnight = pd.Timestamp("2026-10-24T23:00Z")  # local midnight before the change of clocks
    options = RunOptions(horizon_h=1.0, isolate=False)
    whole = Controller.of(profile.steps(midnight, 60), options)
    rolling = Controller.of(profile.steps(midnight, 6), options)
    for step, time in enumerate(whole.times[:8]):
        if rolling.scenario.grid.end < time + pd.Timedelta("2h"):
            rolling.extend(profile.steps(rolling.scenario.grid.end, 3))
        now = Measurement(time, {"big": 0.4, "small": 0.5})
        assert same(rolling.step(now), whole.step(now)), step
