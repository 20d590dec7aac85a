from __future__ import annotations

from dataclasses import asdict, fields, replace

import numpy as np
import pandas as pd
import pytest

from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.contract.forecast import Forecast, Forecaster, ForecastErrors
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid

RANDOM = ForecastErrors(load_bias=0.1, load_alpha_per_h=0.02, pv_bias=-0.05, pv_alpha_per_h=0.03)
DAY = range(0, 6)


def arrays(forecast: Forecast) -> list[np.ndarray]:
    own = [getattr(forecast, f.name) for f in fields(Forecast) if f.name not in ("export", "out")]
    return [*own, forecast.out.lines, forecast.out.buses]


def assert_equal(one: Forecast, other: Forecast) -> None:
    assert one.export is None and other.export is None
    for pair in zip(arrays(one), arrays(other), strict=True):
        np.testing.assert_array_equal(*pair)


@pytest.fixture(scope="module")
def sample() -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of load and PV over 1500 seeds, shape (n, T, items).

    PV ratings are so high that no draw meets the upper clamp.
    """
    day = tiny_scenario()
    day = replace(day, pv=replace(day.pv, p_max_kw=[1e4, 1e4]))
    forecasts = [Forecaster(day, RANDOM, seed).at(0, DAY) for seed in range(1500)]
    return (
        np.array([f.load_kw / day.load_kw - 1 for f in forecasts]),
        np.array([f.pv_kw / day.pv_kw - 1 for f in forecasts]),
    )


def test_without_errors_the_forecast_is_the_truth(tiny: Scenario) -> None:
    truth = Forecast(
        tiny.load_kw,
        tiny.pv_kw,
        tiny.price_gbp_per_kwh,
        tiny.grid_limit_kw,
        tiny.temperature_c,
        out=tiny.out_of_service(DAY),
    )
    assert_equal(Forecaster(tiny, ForecastErrors(), seed=3).at(0, DAY), truth)


@pytest.mark.parametrize("t0", range(6))
def test_first_step_is_exact_and_the_next_is_not(tiny: Scenario, t0: int) -> None:
    forecast = Forecaster(tiny, RANDOM, seed=3).at(t0, range(t0, 6))
    np.testing.assert_array_equal(forecast.load_kw[0], tiny.load_kw[t0])
    np.testing.assert_array_equal(forecast.pv_kw[0], tiny.pv_kw[t0])
    assert (forecast.load_kw[1:] != tiny.load_kw[t0 + 1 :]).all()


def test_price_grid_and_temperature_are_known(tiny: Scenario) -> None:
    forecast = Forecaster(tiny, RANDOM, seed=3).at(2, range(2, 5))
    assert forecast.price_gbp_per_kwh.tolist() == tiny.price_gbp_per_kwh[2:5].tolist()
    assert forecast.grid_limit_kw.tolist() == [np.inf, 0.0, 0.0]
    assert forecast.temperature_c.tolist() == [32.0, 34.0, 34.5]


def test_bias_holds_in_full_from_the_next_step(tiny: Scenario) -> None:
    forecast = Forecaster(tiny, ForecastErrors(load_bias=-0.2, pv_bias=-0.1), seed=3).at(1, DAY[1:])
    assert forecast.load_kw[1:] == pytest.approx(0.8 * tiny.load_kw[2:])
    assert forecast.pv_kw[1:] == pytest.approx(0.9 * tiny.pv_kw[2:])


def test_mean_and_deviation_of_the_errors(sample: tuple[np.ndarray, np.ndarray]) -> None:
    load, pv = sample
    for error, bias, alpha in [(load, 0.1, 0.02), (pv, -0.05, 0.03)]:
        sigma = alpha * np.arange(1, 6)[:, np.newaxis]
        n = len(error)
        # Four standard errors of the mean, and of the deviation (sigma / sqrt(2 n)).
        assert (np.abs(error[:, 1:].mean(axis=0) - bias) < 4 * sigma / np.sqrt(n)).all()
        assert (np.abs(error[:, 1:].std(axis=0) - sigma) < 4 * sigma / np.sqrt(2 * n)).all()


def test_errors_of_items_steps_and_kinds_are_independent(
    sample: tuple[np.ndarray, np.ndarray],
) -> None:
    load, pv = sample
    columns = np.concatenate(
        [load[:, 1:].reshape(len(load), -1), pv[:, 1:].reshape(len(pv), -1)], axis=1
    )
    correlation = np.corrcoef(columns, rowvar=False) - np.eye(columns.shape[1])
    # 300 pairs: the largest of them stays below 4.5 standard errors.
    assert np.abs(correlation).max() < 4.5 / np.sqrt(len(load))


def test_deviation_grows_with_hours_not_with_steps(tiny: Scenario) -> None:
    quarter_hours = replace(tiny, grid=TimeGrid(pd.Timestamp("2022-07-19T10:00:00Z"), 15.0, 6))
    errors = ForecastErrors(load_alpha_per_h=0.02)
    hourly = Forecaster(tiny, errors, seed=3).at(0, DAY).load_kw / tiny.load_kw - 1
    quarterly = Forecaster(quarter_hours, errors, seed=3).at(0, DAY).load_kw / tiny.load_kw - 1
    assert quarterly == pytest.approx(hourly / 4, abs=1e-12)


def test_load_is_not_negative_and_pv_stays_within_its_rating(tiny: Scenario) -> None:
    wild = ForecastErrors(load_alpha_per_h=1.0, pv_alpha_per_h=1.0)
    days = [Forecaster(tiny, wild, seed).at(0, DAY) for seed in range(20)]
    load, pv = np.array([d.load_kw for d in days]), np.array([d.pv_kw for d in days])
    assert load.min() == 0.0
    assert load.max() > 2 * tiny.load_kw.max()
    assert pv.min() == 0.0
    assert pv.max(axis=(0, 1)).tolist() == [30.0, 20.0]


def test_forecast_does_not_depend_on_the_length_of_the_window(tiny: Scenario) -> None:
    forecaster = Forecaster(tiny, RANDOM, seed=3)
    long, short = forecaster.at(1, range(1, 6)), forecaster.at(1, range(1, 3))
    part = forecaster.at(1, range(3, 6))
    np.testing.assert_array_equal(short.load_kw, long.load_kw[:2])
    np.testing.assert_array_equal(short.pv_kw, long.pv_kw[:2])
    np.testing.assert_array_equal(part.load_kw, long.load_kw[2:])


def test_forecast_does_not_depend_on_what_was_asked_before(tiny: Scenario) -> None:
    used = Forecaster(tiny, RANDOM, seed=3)
    used.at(0, DAY)
    used.at(4, range(4, 6))
    assert_equal(used.at(2, range(2, 6)), Forecaster(tiny, RANDOM, seed=3).at(2, range(2, 6)))


def test_every_cycle_and_every_seed_draws_afresh(tiny: Scenario) -> None:
    random = ForecastErrors(load_alpha_per_h=0.02)
    at_0 = Forecaster(tiny, random, seed=3).at(0, DAY).load_kw[5] / tiny.load_kw[5] - 1
    at_1 = Forecaster(tiny, random, seed=3).at(1, DAY[1:]).load_kw[4] / tiny.load_kw[5] - 1
    other = Forecaster(tiny, random, seed=4).at(0, DAY).load_kw[5] / tiny.load_kw[5] - 1
    assert (np.abs(at_0 / 5 - at_1 / 4) > 1e-6).all()
    assert (np.abs(at_0 - other) > 1e-6).all()


def test_a_seeded_forecast_keeps_its_value(tiny: Scenario) -> None:
    # A change here changes every recorded run: the key of the streams is part of the interface.
    forecast = Forecaster(tiny, RANDOM, seed=2022).at(0, DAY)
    assert forecast.load_kw[2] == pytest.approx(
        [73.40242082633061, 47.33405999210562, 50.59024663287279], rel=1e-12
    )
    assert forecast.pv_kw[2] == pytest.approx([27.622670338050234, 18.465977980237895], rel=1e-12)


def test_errors_do_not_reach_the_scenario(tiny: Scenario) -> None:
    before = tiny.load_kw.copy()
    forecast = Forecaster(tiny, RANDOM, seed=3).at(0, DAY)
    np.testing.assert_array_equal(tiny.load_kw, before)
    assert forecast.export is None
    for values in arrays(forecast):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0


def test_without_pv_the_forecast_has_no_column(tiny: Scenario) -> None:
    none = replace(
        tiny,
        pv=replace(tiny.pv, id=[], customer=[], p_max_kw=[], s_max_kva=[]),
        pv_kw=np.zeros((6, 0)),
    )
    assert Forecaster(none, RANDOM, seed=3).at(0, DAY).pv_kw.shape == (6, 0)


@pytest.mark.parametrize(("t0", "steps", "step"), [(2, range(1, 4), 1), (2, range(2, 7), 6)])
def test_steps_outside_the_day_or_in_the_past_are_refused(
    tiny: Scenario, t0: int, steps: range, step: int
) -> None:
    assert refusal(Forecaster(tiny, RANDOM, seed=3).at, t0, steps) == (
        f"forecast, step = {step}: lies outside 2 .. 5. Ask for steps "
        "from the current one to the last of the day."
    )


def test_wrong_errors_are_all_named() -> None:
    assert refusal(
        ForecastErrors, load_bias=-1.5, load_alpha_per_h=-0.1, pv_bias=np.nan
    ).splitlines() == [
        "options, errors.load_bias = -1.5: must be a number not below -1. Give a share, for "
        "example 0.05.",
        "options, errors.load_alpha_per_h = -0.1: must be a number not below 0. Give a share, for "
        "example 0.05.",
        "options, errors.pv_bias = nan: must be a number not below -1. Give a share, for example "
        "0.05.",
    ]


def test_negative_seed_is_refused(tiny: Scenario) -> None:
    assert refusal(Forecaster, tiny, RANDOM, seed=-1) == (
        "options, seed = -1: must not be negative. Give a whole number from zero."
    )


def test_no_error_is_the_default() -> None:
    assert set(asdict(ForecastErrors()).values()) == {0.0}
