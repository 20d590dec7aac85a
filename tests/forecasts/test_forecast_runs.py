"""Forecasters in runs, live controllers and scenario folders."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.refusals import refusal
from vppres.contract.forecast import Forecaster, ForecastErrors
from vppres.core.errors import InputError
from vppres.day.forecasting import OWN_SERIES, MeasuredForecasts, forecasts_of
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.explain.windows import Windows
from vppres.forecasts.seasonal import Seasonal
from vppres.io.digest import scenario_digest
from vppres.io.history import read_history
from vppres.io.scenario_folder import read_scenario
from vppres.io.scenario_writer import write_scenario
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.scenario.history import History
from vppres.scenario.parts import split_sheddable
from vppres.scenario.scenario import Scenario

SEASONAL = RunOptions(forecaster="seasonal", horizon_h=2)


def remembered(day: Scenario, days: int = 20) -> Scenario:
    """The day, six hours, and the same hours' mean demand of the days before with some noise."""
    rng = np.random.default_rng(7)
    hours = days * 24 + day.grid.start.hour
    load = day.load_kw.mean(axis=0) * rng.uniform(0.8, 1.2, (hours, 1))
    sun = np.maximum(np.sin((np.arange(hours) % 24 - 6.0) * np.pi / 12.0), 0.0)[:, None]
    pv = (
        np.broadcast_to(day.pv.p_max_kw, (hours, len(day.pv)))
        * sun
        * rng.uniform(0.5, 1, (hours, 1))
    )
    start = day.grid.start - pd.Timedelta(hours=hours)
    return replace(day, history=History(start, 60.0, load, pv, day.grid.zone))


def test_a_forecast_in_a_run_is_exact_now_and_knows_nothing_later(tiny: Scenario) -> None:
    day = remembered(tiny)
    t0 = 2
    seen = MeasuredForecasts(day, Seasonal()).at(t0, range(t0, 6))
    np.testing.assert_array_equal(seen.load_kw[0], day.load_kw[t0])
    np.testing.assert_array_equal(seen.pv_kw[0], day.pv_kw[t0])
    load, pv = day.load_kw.copy(), day.pv_kw.copy()
    load[t0 + 1 :] *= 7.0
    pv[t0 + 1 :] = 0.0
    other = MeasuredForecasts(replace(day, load_kw=load, pv_kw=pv), Seasonal()).at(t0, range(t0, 6))
    np.testing.assert_array_equal(seen.load_kw, other.load_kw)
    np.testing.assert_array_equal(seen.pv_kw, other.pv_kw)
    assert (seen.pv_kw <= day.pv.p_max_kw).all()
    assert not np.array_equal(seen.load_kw[1:], day.load_kw[t0 + 1 :])


def test_a_run_says_what_its_forecasts_rested_on(tiny: Scenario) -> None:
    run = run_day(remembered(tiny), SEASONAL)
    assert run.steps["forecast_basis"].tolist()[:-1] == ["model"] * 5
    window = Windows(run).seen(1)
    seen = Day(remembered(tiny), SEASONAL).forecaster.at(1, range(1, 4))
    np.testing.assert_array_equal(window.load_kw, seen.load_kw)


def test_without_history_the_scenarios_series_are_the_forecast(tiny: Scenario) -> None:
    forecasts = forecasts_of(tiny, SEASONAL, ForecastErrors())
    assert isinstance(forecasts, MeasuredForecasts)
    np.testing.assert_array_equal(forecasts.at(1, range(1, 6)).load_kw, tiny.load_kw[1:])
    assert forecasts.bases == {1: OWN_SERIES}


def test_the_papers_forecasts_are_the_default(tiny: Scenario) -> None:
    assert isinstance(forecasts_of(tiny, RunOptions(), ForecastErrors()), Forecaster)
    assert "forecast_basis" not in run_day(tiny, RunOptions(horizon_h=0)).steps


def test_perfect_control_has_perfect_forecasts(tiny: Scenario) -> None:
    perfect = RunOptions(controller="perfect", forecaster="seasonal")
    assert isinstance(forecasts_of(tiny, perfect, ForecastErrors()), Forecaster)


def test_errors_of_the_paper_are_no_others(tiny: Scenario) -> None:
    biased = replace(SEASONAL, errors=ForecastErrors(load_bias=0.1))
    with pytest.raises(InputError, match="makes its own errors, so that none can be given"):
        Day(tiny, biased)


def test_a_live_controller_learns_from_what_it_measures(tiny: Scenario) -> None:
    day = remembered(tiny)
    controller = Controller.of(day, replace(SEASONAL, isolate=False))
    soc = dict(zip(day.batteries.id, day.batteries.soc_initial, strict=True))
    for t in range(3):
        load = dict(zip(day.customers.id, 2.0 * day.load_kw[t], strict=True))
        controller.step(Measurement(day.grid.times[t], soc=soc, load_kw=load))
    history = controller._past.history
    np.testing.assert_allclose(history.load_kw[-3:], 2.0 * day.load_kw[:3])
    assert history.end == day.grid.times[3]


def test_a_folder_keeps_its_history(tiny: Scenario, tmp_path: Path) -> None:
    day = remembered(tiny)
    load = day.history.load_kw.copy()
    load[5, 1] = np.nan
    day = replace(day, history=replace(day.history, load_kw=load))
    write_scenario(day, tmp_path / "day")
    again = read_scenario(tmp_path / "day")
    np.testing.assert_array_equal(again.history.load_kw, day.history.load_kw)
    np.testing.assert_array_equal(again.history.pv_kw, day.history.pv_kw)
    assert again.history.start == day.history.start
    assert scenario_digest(again) == scenario_digest(day) != scenario_digest(tiny)


def test_steps_before_a_part_of_a_day_join_its_history(tiny: Scenario) -> None:
    part = remembered(tiny).between(2, 4)
    assert part.history.end == part.grid.start
    np.testing.assert_array_equal(part.history.load_kw[-2:], tiny.load_kw[:2])


def test_parts_of_customers_share_their_history(tiny: Scenario) -> None:
    day = remembered(tiny)
    split = split_sheddable(replace(day, customers=replace(day.customers, shed_steps=[1, 2, 1])))
    np.testing.assert_allclose(split.history.load_kw[:, 1:3], day.history.load_kw[:, [1, 1]] / 2)


def history_file(folder: Path, text: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "load_kw.csv").write_text(text)
    return folder


def test_a_history_may_have_gaps(tmp_path: Path) -> None:
    rows = "time,a\n2022-01-01T00:00Z,1\n2022-01-01T01:00Z,\n2022-01-01T02:00Z,3\n2022-01-01T05:00Z,6\n"
    history = read_history(history_file(tmp_path / "h", rows))
    np.testing.assert_array_equal(history.load_kw[:, 0], [1, np.nan, 3, np.nan, np.nan, 6])
    assert history.pv_kw.shape == (6, 0)


@pytest.mark.parametrize(("rows", "message"), [
    ("2022-01-01T00:00Z,1\n2022-01-01T00:00Z,2",
        "load_kw.csv, row 3, time = 2022-01-01T00:00:00Z: is given twice. Remove one"),
    ("2022-01-01T00:00Z,-1", "load_kw.csv, row 2, a = -1: must be at least 0"),
    ("2022-01-01T00:00Z,cold", "load_kw.csv, row 2, a = cold: is not a number"),
    ("2022-01-01T00:00,1", "load_kw.csv, row 2, time = 2022-01-01T00:00: has no time zone"),
    ("2022-01-01T00:00Z,1\n2022-01-01T01:00Z,1\n2022-01-01T02:00Z,1\n2022-01-01T02:20Z,1",
        "row 5, time = 2022-01-01T02:20:00Z: is not the beginning of a step. Give steps of 60 min"),
    ("", "load_kw.csv: has no row"),
])  # fmt: skip
def test_mistakes_in_a_history_are_named(tmp_path: Path, rows: str, message: str) -> None:
    assert message in refusal(read_history, history_file(tmp_path / "h", f"time,a\n{rows}\n"))


def test_no_history_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file or folder"):
        read_history(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="has no measured demand"):
        read_history(tmp_path / "empty")


QUANTILES = """issued_at,time,series,q10,q50,q90
2022-07-19T10:00Z,2022-07-19T11:00Z,load,100,150,200
2022-07-19T10:00Z,2022-07-19T11:00Z,roof,5,6,7
2022-07-19T12:00Z,2022-07-19T13:00Z,load,90,90,90
"""


def quantile_file(folder: Path, text: str = QUANTILES) -> Path:
    file = folder / "mine.csv"
    file.write_text(text)
    return file


def test_forecasts_of_ones_own_are_used_as_soon_as_they_are_out(
    tiny: Scenario, tmp_path: Path
) -> None:
    mine = RunOptions(forecaster="file", forecast_file=str(quantile_file(tmp_path)), horizon_h=3)
    forecasts = Day(tiny, mine).forecaster
    now = forecasts.at(0, range(0, 4))
    # Ten o'clock: the total is shared out like what was measured, the first step alone.
    np.testing.assert_allclose(now.load_kw[1], 150.0 * tiny.load_kw[0] / tiny.load_kw[0].sum())
    np.testing.assert_allclose(now.pv_kw[1], [6.0, tiny.pv_kw[1, 1]])
    # What the file does not cover is the scenario's own.
    np.testing.assert_array_equal(now.load_kw[[0, 2, 3]], tiny.load_kw[[0, 2, 3]])
    np.testing.assert_array_equal(forecasts.at(1, range(1, 4)).load_kw[2], tiny.load_kw[3])
    assert forecasts.at(2, range(2, 4)).load_kw[1].sum() == pytest.approx(90.0)
    assert run_day(tiny, mine).steps["forecast_basis"].iloc[0] == "model"


@pytest.mark.parametrize(("text", "message"), [
    (QUANTILES.replace("roof", "rof"), "row 3, series = rof: is neither load nor pv nor"),
    (QUANTILES.replace("5,6,7", "5,9,7"), "row 3, quantiles: falls from a lower quantile"),
    (QUANTILES.replace("q10,q50,q90", "a,b,c"), "has no column of a quantile"),
    (QUANTILES.replace("T10:00Z,2022", "T10:00,2022"), "issued_at = 2022-07-19T10:00: has no"),
])  # fmt: skip
def test_mistakes_in_forecasts_are_named(
    tiny: Scenario, tmp_path: Path, text: str, message: str
) -> None:
    options = RunOptions(forecaster="file", forecast_file=str(quantile_file(tmp_path, text)))
    assert message in refusal(Day, tiny, options)


def test_a_file_of_forecasts_must_be_given(tiny: Scenario) -> None:
    with pytest.raises(InputError, match="needs a file of quantiles"):
        Day(tiny, RunOptions(forecaster="file"))
