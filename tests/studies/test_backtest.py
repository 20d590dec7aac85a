"""Scores against closed forms, and back-tests whose answer is known."""

from __future__ import annotations

import json
from math import erf, exp, pi, sqrt
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.command_line import call
from vppres.core.errors import InputError
from vppres.forecasts.references import Climatology, WeeklyNaive
from vppres.forecasts.scores import crps, energy_score, holds, interval, pit
from vppres.io.history import read_history
from vppres.scenario.history import History
from vppres.studies.backtest import Backtest, Plan, backtest, measured_in
from vppres.studies.backtest_page import backtest_findings, write_backtest

ROOT = Path(__file__).parents[2]
MONDAY = pd.Timestamp("2022-06-06", tz="UTC")


def noise(days: int, seed: int = 2) -> History:
    """Demand that is drawn anew every hour: nothing can be known but its spread."""
    rng = np.random.default_rng(seed)
    n = 24 * days
    return History(MONDAY, 60.0, rng.gamma(4.0, 1.0, (n, 2)), rng.uniform(0.0, 5.0, (n, 1)))


@pytest.mark.parametrize("came", [-1.0, 0.0, 0.7, 3.0])
def test_crps_of_a_normal_is_its_closed_form(came: float) -> None:
    # Gneiting and Raftery (2007), equation 21, for mean 0 and standard deviation 1.
    density = exp(-(came**2) / 2) / sqrt(2 * pi)
    distribution = 0.5 * (1 + erf(came / sqrt(2)))
    exact = came * (2 * distribution - 1) + 2 * density - 1 / sqrt(pi)
    drawn = np.random.default_rng(1).standard_normal(200_000)
    assert float(crps(drawn, np.array(came))) == pytest.approx(exact, abs=4e-3)


def test_scores_of_a_single_value_are_distances() -> None:
    assert crps(np.array([[2.0, 5.0]]), np.array([3.0, 3.0])).tolist() == [1.0, 2.0]
    assert energy_score(np.array([[3.0, 4.0]]), np.array([0.0, 0.0])) == 5.0


def test_crps_by_pairs() -> None:
    rng = np.random.default_rng(3)
    paths, came = rng.normal(size=(7, 4)), rng.normal(size=4)
    pairs = np.abs(paths[:, None] - paths).mean(axis=(0, 1))
    np.testing.assert_allclose(crps(paths, came), np.abs(paths - came).mean(axis=0) - pairs / 2)
    np.testing.assert_allclose(
        energy_score(paths[:, :1], came[:1]), crps(paths[:, 0], np.array(came[0]))
    )


def test_what_is_drawn_like_the_forecast_is_evenly_spread_in_it() -> None:
    drawn = np.random.default_rng(4).exponential(size=(20, 4000))
    count, _ = np.histogram(pit(drawn[:19], drawn[19]), bins=5, range=(0, 1))
    assert (np.abs(count / 4000 - 0.2) < 0.03).all()
    assert holds(interval(drawn[:19], 0.8), drawn[19]).mean() == pytest.approx(0.8, abs=0.02)


def test_references_by_hand() -> None:
    hours = np.arange(40.0 * 24)
    history = History(MONDAY, 60.0, hours[:, None], np.zeros((len(hours), 0)))
    day = Climatology(days=3).forecast(history, history.times[900], 30).load_kw[:, :, 0]
    assert day[:, 0].tolist() == [900 - 24, 900 - 48, 900 - 72]
    assert day[:, 24].tolist() == [900 - 24, 900 - 48, 900 - 72]
    # A week before it was 168 less, and the error of that rule always was 168.
    week = WeeklyNaive().forecast(history, history.times[900], 30)
    np.testing.assert_allclose(week.point()[0][:, 0], hours[900:930])
    np.testing.assert_allclose(np.ptp(week.load_kw, axis=0), 0.0)


@pytest.mark.nightly
def test_intervals_of_pure_noise_hold_as_often_as_they_say() -> None:
    result = backtest(noise(100), Plan(horizon_h=12, every_h=5))
    for quantity in ("load", "net"):
        for share in (0.5, 0.8, 0.9):
            held = float(np.nanmean(result.mean(f"held {share}", quantity)))
            assert held == pytest.approx(share, abs=0.035)
        assert float(result.mean("energy 12 0.8", quantity)) == pytest.approx(0.8, abs=0.09)
    # Nothing can be much better than the hour of the day, which is right here.
    assert -0.05 < result.ranges()["to_climatology"].iloc[0] < 0.17


def test_what_repeats_itself_has_no_error() -> None:
    hour = np.arange(60 * 24) % 24
    history = History(MONDAY, 60.0, 1.0 + hour[:, None], np.zeros((len(hour), 0)))
    result = backtest(history, Plan(horizon_h=24, every_h=24))
    assert result.quantities == ["load"]
    assert float(result.by_lead()["crps_kw"].max()) < 1e-9
    assert result.by_lead()["held_80%"].tolist() == [1.0] * 24


def test_no_error_is_relative_to_a_reference_without_one(tmp_path: Path) -> None:
    # Each forecast is issued at 07:00 UTC: there is no PV power up to 6 h ahead, and none is usual.
    hour = np.arange(60 * 24) % 24
    load_kw, pv_kw = (np.random.default_rng(5).gamma(4.0, 1.0, (len(hour), 1)) for _ in range(2))
    pv_kw[(hour < 13) | (hour > 20)] = 0.0
    nights = History(MONDAY, 60.0, load_kw, pv_kw)
    result = backtest(nights, Plan(horizon_h=24, every_h=24, first=MONDAY + pd.Timedelta("17D7h")))
    write_backtest(result, tmp_path / "out", "Nights")
    table = json.loads((tmp_path / "out" / "summary.json").read_text())["crps"]
    night, day = (row for row in table if row["quantity"] == "pv")
    assert night["crps_kw"] == 0.0
    assert night["to_climatology"] is night["to_weekly"] is None
    assert day["to_climatology"] == pytest.approx(day["crps_kw"] / climatology_kw(result) - 1.0)
    pv = backtest_findings(result)[1]
    assert "up to 24 h" in pv
    assert "up to 6 h" not in pv


def climatology_kw(result: Backtest) -> float:
    """Error of the usual PV power from 6 h to 24 h ahead."""
    table = result.by_lead()
    rows = (table["quantity"] == "pv") & (table["lead_h"] > 6)
    return float(table.loc[rows, "crps_climatology_kw"].mean())


@pytest.mark.filterwarnings("error")
def test_a_month_without_measurements_has_no_share() -> None:
    hour = np.arange(75 * 24)
    load_kw = np.random.default_rng(6).gamma(4.0, 1.0, (len(hour), 1))
    history = History(MONDAY, 60.0, load_kw, np.zeros((len(hour), 0)))
    july = history.times.strftime("%m") == "07"
    load_kw[july] = np.nan
    gone = History(MONDAY, 60.0, load_kw, np.zeros((len(hour), 0)))
    shares = backtest(gone, Plan(horizon_h=12, every_h=71)).by_month()["load"]
    assert shares.index[shares.isna()].tolist() == ["2022-07"]


def test_a_short_history_has_no_issue() -> None:
    with pytest.raises(InputError, match="there is no issue of a forecast between"):
        backtest(noise(10), Plan())


@pytest.mark.nightly
def test_page_and_tables(tmp_path: Path) -> None:
    result = backtest(noise(30), Plan(horizon_h=24, every_h=23))
    summary = write_backtest(result, tmp_path / "out", "Noise")
    page = (tmp_path / "out" / "backtest.html").read_text()
    assert "<h1>Noise</h1>" in page
    assert page.count("<figure") == 3 * 3
    assert 'src="http' not in page
    for words in backtest_findings(result):
        assert words in page
    table = pd.read_csv(tmp_path / "out" / "by_lead.csv")
    assert len(table) == 3 * 24
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == summary
    assert summary["issues"] == len(result.issues)


@pytest.mark.nightly
def test_the_command(tmp_path: Path) -> None:
    history = noise(30)
    times = history.times.strftime("%Y-%m-%dT%H:%MZ")
    for name, values in (("load_kw", history.load_kw), ("pv_kw", history.pv_kw)):
        frame = pd.DataFrame(values, columns=[f"i{i}" for i in range(values.shape[1])])
        frame.insert(0, "time", times)
        frame.to_csv(tmp_path / f"{name}.csv", index=False)
    out = tmp_path / "out"
    done = call("backtest", str(tmp_path), "--every", "71", "--horizon", "12", "--out", str(out))
    assert done.exit_code == 0, done.output
    assert "Load: error (CRPS)" in done.output
    assert (out / "backtest.html").is_file()
    mine = tmp_path / "mine.csv"
    rows = [f"{time},load,1,8,20" for time in times]
    mine.write_text("\n".join(["time,series,q10,q50,q90", *rows]) + "\n")
    own = call(
        "backtest", str(tmp_path), "--every", "47", "--horizon", "6", "--forecasts", str(mine),
        "--out", str(out), "--json",
    )  # fmt: skip
    assert own.exit_code == 0, own.output
    assert json.loads(own.stdout)["summary"]["forecaster"] == "mine"
    log = tmp_path / "outages.csv"
    log.write_text("start,end\n2022-06-10T12:00Z,2022-06-10T15:00Z\n")
    said = tmp_path / "warnings.csv"
    said.write_text(
        "issued_at,outage,onset_likely,probability\n"
        "2022-06-10T06:00Z,a,2022-06-10T12:00Z,0.1\n2022-06-12T06:00Z,b,2022-06-12T12:00Z,0.9\n"
    )
    warned = call(
        "backtest", str(tmp_path), "--every", "47", "--horizon", "6", "--warnings", str(said),
        "--outages", str(log), "--out", str(out),
    )  # fmt: skip
    assert warned.exit_code == 0, warned.output
    assert "of 2 announced outages 1 came, and 0 outages came unannounced" in warned.output
    page = (out / "backtest.html").read_text()
    assert "<h2>Outage warnings</h2>" in page
    # Said .1 and .9, came 1 and 0: off by .81 each, where one half each time is off by .25.
    assert "Brier score 0.810" in page
    assert json.loads((out / "summary.json").read_text())["warnings"]["brier_of_share"] == 0.25
    alone = call("backtest", str(tmp_path), "--warnings", str(said), "--out", str(out))
    assert alone.exit_code == 2
    assert "options, outages: is missing" in alone.output
    wrong = call("backtest", str(tmp_path), "--from", "soon", "--out", str(out))
    assert wrong.exit_code == 2
    assert "from or to = soon: is not a time" in wrong.output


def test_a_scenario_without_enough_days_says_so() -> None:
    history = measured_in("uk-heatwave-2022")
    assert history.n_steps == 24
    with pytest.raises(InputError, match="Give at least 14 days of history"):
        backtest(history)


@pytest.mark.nightly
def test_the_homes_held_out_months() -> None:
    """The issue's bars, on every second day: docs/forecasts.md has all hours."""
    homes = read_history(ROOT / "data" / "homes", zone="Etc/GMT+8")
    result = backtest(homes, Plan(every_h=47, first=pd.Timestamp("2017-04-01T07:00", tz="UTC")))
    ranges = result.ranges().set_index(["quantity", "until_h"])["to_climatology"]
    assert ranges["load", 6] < -0.1
    assert ranges["pv", 6] < -0.1
    assert ranges["load", 48] < 0.0
