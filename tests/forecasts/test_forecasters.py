"""Forecasters: what they know, what they rest on, and clocks that change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vppres.core.errors import InputError
from vppres.forecasts.interface import LoadAndPV, middle, quantiles
from vppres.forecasts.seasonal import Seasonal
from vppres.forecasts.window import LastErrors, not_negative
from vppres.scenario.history import History

MIDNIGHT = pd.Timestamp("2022-03-01", tz="UTC")
MONDAY = pd.Timestamp("2022-06-06", tz="UTC")


def sun(hours: np.ndarray) -> np.ndarray:
    """A clear day from 6 to 18 h UTC, 1 at noon."""
    return np.maximum(np.sin((hours % 24.0 - 6.0) * np.pi / 12.0), 0.0)


def homes(
    days: float, step_minutes: float = 60.0, zone: str = "Europe/London", seed: int = 1
) -> History:
    """Three homes with evening peaks on their clocks, and two roofs under clouds."""
    rng = np.random.default_rng(seed)
    n = round(days * 1440 / step_minutes)
    times = pd.date_range(MIDNIGHT, periods=n, freq=pd.Timedelta(minutes=step_minutes))
    local = times.tz_convert(zone)
    hour = (local.hour + local.minute / 60.0).to_numpy(float)
    level = 1.0 + np.exp(-((hour - 19.0) ** 2) / 8.0)
    load = level[:, None] * rng.gamma(4.0, 0.25, (n, 3))
    utc = (times.hour + times.minute / 60.0).to_numpy(float)
    cloud = np.repeat(rng.uniform(0.2, 1.0, (int(days) + 1, 1)), round(1440 / step_minutes), axis=0)
    pv = sun(utc)[:, None] * cloud[:n] * [3.0, 5.0]
    return History(MIDNIGHT, step_minutes, load, pv, zone)


def assert_same(one: LoadAndPV, other: LoadAndPV) -> None:
    assert one.basis == other.basis
    np.testing.assert_array_equal(one.load_kw, other.load_kw)
    np.testing.assert_array_equal(one.pv_kw, other.pv_kw)


@settings(max_examples=25)
@given(
    issued=st.integers(0, 45 * 24 - 1),
    steps=st.integers(1, 60),
    quarters=st.booleans(),
    garbage=st.sampled_from([np.nan, 0.0, 1e6]),
)
def test_a_forecast_knows_nothing_from_its_issue_on(
    issued: int, steps: int, quarters: bool, garbage: float
) -> None:
    history = homes(45 if not quarters else 12, 15.0 if quarters else 60.0)
    issued_at = history.times[issued]
    load, pv = history.load_kw.copy(), history.pv_kw.copy()
    load[issued:] = pv[issued:] = garbage
    changed = replace(history, load_kw=load, pv_kw=pv)
    whole = Seasonal().forecast(history, issued_at, steps)
    assert_same(whole, Seasonal().forecast(changed, issued_at, steps))
    assert_same(whole, Seasonal().forecast(history.before(issued_at), issued_at, steps))


def test_what_is_older_than_the_memory_changes_nothing() -> None:
    history = homes(110)
    issued_at = history.times[-24]
    kept = history.before(issued_at).last_days(Seasonal().memory_days + 1)
    assert_same(
        Seasonal().forecast(history, issued_at, 24),
        Seasonal().forecast(kept, issued_at, 24),
    )


@pytest.mark.parametrize("step_minutes", [15.0, 60.0])
@pytest.mark.parametrize("change", ["2022-03-27T00:00Z", "2022-10-30T00:00Z"])
def test_homes_live_by_clocks_that_change(step_minutes: float, change: str) -> None:
    # Demand that follows the clock and nothing else is known exactly, two days over the change.
    start = pd.Timestamp(change) - pd.Timedelta(days=50)
    n = round(53 * 1440 / step_minutes)
    times = pd.date_range(start, periods=n, freq=pd.Timedelta(minutes=step_minutes))
    clock = times.tz_convert("Europe/London")
    load = (1.0 + clock.hour + clock.minute / 60.0).to_numpy(float)[:, None]
    history = History(start, step_minutes, load, np.zeros((n, 0)), "Europe/London")
    first = history.row_of(pd.Timestamp(change) - pd.Timedelta(hours=7))
    steps = round(48 * 60 / step_minutes)
    found = Seasonal().forecast(history, times[first], steps)
    point, _ = found.point()
    wrong = np.abs(point - load[first : first + steps])[:, 0]
    # The hour that is left out, or comes twice, has errors in it that go on for a few hours.
    assert np.median(wrong) < 1e-6
    assert (wrong < 0.7).all()


def test_a_week_that_repeats_itself_is_known() -> None:
    day = np.arange(70 * 24) // 24 % 7
    hour = np.arange(70 * 24) % 24
    load = np.column_stack([1.0 + hour * (1 + (day >= 5)), 2.0 + hour % 3])
    history = History(MONDAY, 60.0, load, np.zeros((len(load), 0)))
    weekly = Seasonal(days=0)
    found = weekly.forecast(history, history.times[60 * 24], 48)
    assert found.basis == "model"
    np.testing.assert_allclose(
        quantiles(found.load_kw, [0.1, 0.9]), np.stack([load[1440:1488]] * 2)
    )


def test_last_errors_die_out_by_hand() -> None:
    # A flat load of 10 kW that has been 14 kW for two hours: 4 kW of which .8 an hour is left,
    # and of the day's mean error of 2 / 24 * 4 kW the share .6 comes in as that goes.
    n = 60 * 24
    load = np.full((n, 1), 10.0)
    load[-2:] = 14.0
    history = History(MONDAY, 60.0, load, np.zeros((n, 0)))
    # Nothing of the kind was seen on the days before: what is supposed holds in full.
    point, _ = Seasonal().forecast(history, history.end, 3).point()
    day_error = 4.0 * 2 / 24
    expected = [
        10.0 + 4.0 * 0.8**lead + 0.6 * 0.98**lead * day_error * (1 - 0.8**lead)
        for lead in (1, 2, 3)
    ]
    np.testing.assert_allclose(point[:, 0], expected)


def test_a_clear_sky_is_followed_and_a_cloud_goes_on() -> None:
    hours = np.arange(60 * 24.0)
    pv = 8.0 * sun(hours)[:, None]
    pv[-14:] *= 0.5  # from 10:00 on, and it is midnight now
    noon = 59 * 24 + 12
    history = History(MONDAY, 60.0, np.ones((len(pv), 1)), pv)
    _, found = (
        Seasonal(pv_errors=LastErrors(2.0, 0.8, 0.0, 1.0))
        .forecast(history, history.times[noon], 3)
        .point()
    )
    # Two hours at half the clear sky: the index is lower by .5 times .8 an hour.
    clear = 8.0 * sun(hours[noon : noon + 3])
    expected = clear * (1.0 - 0.5 * 0.8 ** np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found[:, 0], expected, rtol=1e-9)


@pytest.mark.parametrize(("hours", "basis", "paths"), [
    (0, "nothing", 1),
    (5, "recent values", 1),
    (24, "past days", 1),
    (7 * 24, "past days", 7),
    (10 * 24, "model", 9),
    (100 * 24, "model", 42),
])  # fmt: skip
def test_less_history_is_a_lesser_forecast(hours: int, basis: str, paths: int) -> None:
    history = homes(101).rows(0, hours)
    found = Seasonal().forecast(history, history.end, 24)
    assert (found.basis, len(found.load_kw)) == (basis, paths)
    assert np.isfinite(found.load_kw).all() == (hours > 0)
    if hours == 5:
        np.testing.assert_allclose(found.load_kw[0, 7], history.load_kw.mean(axis=0))
    if hours == 24:
        np.testing.assert_array_equal(found.load_kw[0], history.load_kw)


def test_gaps_and_dead_meters_take_nothing_from_the_others() -> None:
    history = homes(80)
    load = history.load_kw.copy()
    load[:, 1] = np.nan
    load[300:400] = np.nan
    load[-30:] = np.nan
    found = Seasonal().forecast(replace(history, load_kw=load), history.end, 30)
    assert found.basis == "model"
    assert np.isnan(found.load_kw[:, :, 1]).all()
    assert np.isfinite(found.load_kw[:, :, [0, 2]]).all()
    assert np.isfinite(found.pv_kw).all()


def test_a_history_that_ended_long_ago_is_still_used() -> None:
    history = homes(60)
    found = Seasonal().forecast(history, history.end + pd.Timedelta(days=20), 24)
    assert found.basis == "model"
    assert 0.5 < found.point()[0].sum() / history.load_kw[-24:].sum() < 2.0


def test_a_step_that_no_day_is_made_of_is_refused() -> None:
    history = History(MONDAY, 7.0, np.ones((500, 1)), np.ones((500, 0)))
    with pytest.raises(InputError, match="a day is no whole number of these steps"):
        Seasonal().forecast(history, history.end, 4)


def test_a_time_between_two_steps_is_refused() -> None:
    history = homes(20)
    with pytest.raises(InputError, match="is not the beginning of a step of the history"):
        Seasonal().forecast(history, history.end + pd.Timedelta(minutes=7), 4)


def test_quantiles_hold_new_values_as_often_as_they_say() -> None:
    # 19 past errors and a new one, all alike: between the 2nd and the 18th lie 16 of 20.
    rng = np.random.default_rng(5)
    drawn = rng.exponential(size=(20, 20_000))
    low, high = quantiles(drawn[:19], [0.1, 0.9])
    assert np.mean((low <= drawn[19]) & (drawn[19] <= high)) == pytest.approx(0.8, abs=0.01)


def test_what_one_item_is_lifted_by_the_others_give() -> None:
    paths = np.array([[[-1.0, 3.0, 2.0]], [[-5.0, 1.0, 1.0]]])
    np.testing.assert_allclose(not_negative(paths), [[[0.0, 2.4, 1.6]], [[0.0, 0.0, 0.0]]])


def test_the_middle_is_the_median_of_the_total() -> None:
    paths = np.array([[[0.0, 1.0]], [[0.0, 2.0]], [[9.0, 3.0]]])
    # Means 3 and 2; totals 1, 2 and 12, of which the median is 2.
    np.testing.assert_allclose(middle(paths), [[1.2, 0.8]])


def test_quarter_hours_of_hours_and_back() -> None:
    history = homes(3)
    fine = history.in_steps_of(15.0)
    assert fine.n_steps == 4 * history.n_steps
    np.testing.assert_allclose(fine.in_steps_of(60.0).load_kw, history.load_kw)
    late = fine.rows(1, fine.n_steps).in_steps_of(60.0)
    assert late.start == history.start + history.step
    np.testing.assert_allclose(late.pv_kw, history.pv_kw[1:])
