"""Days of 23 and 25 hours, zone names, other steps and gaps, on cases done by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.support.refusals import refusal
from vppres.core.errors import Problem
from vppres.feeders.new.options import parse_outage
from vppres.feeders.series.clocks import days_later, grid_from, in_utc, local_midnight, time_of_day
from vppres.feeders.series.resample import OnGrid, on_grid
from vppres.scenario.timegrid import TimeGrid

LONDON = "Europe/London"


@pytest.mark.parametrize(
    ("day", "zone", "hours", "first", "last"),
    [
        # Clocks go forward at 1:00 UTC: the day ends an hour earlier in UTC.
        ("2025-03-30", LONDON, 23, "2025-03-30T00:00Z", "2025-03-30T23:00Z"),
        ("2025-10-26", LONDON, 25, "2025-10-25T23:00Z", "2025-10-27T00:00Z"),
        ("2025-07-01", LONDON, 24, "2025-06-30T23:00Z", "2025-07-01T23:00Z"),
        ("2025-03-09", "America/New_York", 23, "2025-03-09T05:00Z", "2025-03-10T04:00Z"),
        # Half an hour of daylight saving.
        ("2025-04-06", "Australia/Lord_Howe", 24.5, "2025-04-05T13:00Z", "2025-04-06T13:30Z"),
        # Clocks skip midnight itself.
        ("2018-11-04", "America/Sao_Paulo", 23, "2018-11-04T03:00Z", "2018-11-05T02:00Z"),
    ],
)
def test_length_of_a_local_day(day: str, zone: str, hours: float, first: str, last: str) -> None:
    start = local_midnight(day, zone)
    assert start == pd.Timestamp(first)
    assert days_later(start, 1, zone) == pd.Timestamp(last)
    grid = grid_from(start, 1, 30.0, zone)
    assert grid.n_steps == 2 * hours
    assert grid.end == pd.Timestamp(last)


def test_steps_that_do_not_fill_a_day() -> None:
    assert refusal(grid_from, local_midnight("2025-03-30", LONDON), 1, 240.0, LONDON) == (
        "options, step_minutes = 240.0: does not divide the 23 hours from "
        "2025-03-30T00:00:00+00:00. Give a step that divides an hour, for example 60, 30 or 15."
    )


@pytest.mark.parametrize(
    "start", [local_midnight("2025-03-30", LONDON), pd.Timestamp("2025-03-30", tz=LONDON)]
)
def test_times_on_the_clock_of_such_a_day(start: pd.Timestamp) -> None:
    """By a zone of the standard library, and by the one that pandas makes of a name."""
    first, last = parse_outage("12:00..24:00", start)
    assert first == pd.Timestamp("2025-03-30T11:00Z")  # 12:00 British Summer Time
    assert last == pd.Timestamp("2025-03-30T23:00Z")
    assert "the clocks skip or show twice on this day" in refusal(
        parse_outage, "01:30..12:00", start
    )
    assert time_of_day(start, 0, 30) == pd.Timestamp("2025-03-30T00:30Z")


@pytest.mark.parametrize(("hours", "day", "first"), [
    ((0, 1, 1, 2), "2025-10-26", "2025-10-25T23:00Z"),  # the long day is not shifted
    ((0, 2), "2025-03-30", "2025-03-30T00:00Z"),  # the short one has no gap
])  # fmt: skip
def test_times_of_the_clocks_are_hours_in_utc(hours: tuple[int, ...], day: str, first: str) -> None:
    times, problems = in_utc(pd.Index([f"{day}T{h:02d}:00" for h in hours]), LONDON, "a.csv")
    assert not problems
    assert times.tolist() == pd.date_range(first, periods=len(hours), freq="h").tolist()


@pytest.mark.parametrize(("texts", "zone", "message"), [
    (["2025-07-01T00:00", "2025-07-01T01:00"], None,
        "a.csv, time = 2025-07-01T00:00: has no time zone. Write the offset behind every time, "
        "or give --time-zone, for example Europe/London."),
    (["2025-03-30T00:00", "2025-03-30T01:00", "2025-03-30T01:30", "2025-03-30T02:00"], LONDON,
        "a.csv, row 3, time = 2025-03-30 01:00:00: is a time that the clocks of Europe/London "
        "skip, and 1 more. Write the times with their offset, or give the zone that they are in."),
    (["2025-10-26T00:00", "2025-10-26T01:00", "2025-10-26T02:00"], LONDON,
        "a.csv, row 3, time = 2025-10-26 01:00:00: is a time that the clocks of Europe/London "
        "show twice, and it is there once. Write the times with their offset, or give both hours."),
    (["2025-07-01T00:00Z", "noon", "1/7/25", "2025-07-01T03:00Z", "2025-07-01T04:00Z"], None,
        "a.csv, row 3, time = noon: is not an ISO 8601 time, and 1 more. Write it like "
        "2022-07-19T12:00:00Z."),
])  # fmt: skip
def test_times_that_cannot_be_read(texts: list[str], zone: str | None, message: str) -> None:
    times, problems = in_utc(pd.Index(texts), zone, "a.csv")
    assert (len(times), [str(p) for p in problems]) == (0, [message])


def series(values: list[float], start: str = "2025-01-01T00:00Z", minutes: int = 60) -> pd.Series:
    times = pd.date_range(start, periods=len(values), freq=f"{minutes}min")
    return pd.Series(values, times)


GRID = TimeGrid(pd.Timestamp("2025-01-01T00:00Z"), 60.0, 3)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (series([1, 2, 3]), [1, 2, 3]),
        # quarter hours average; (1+2+3+4)/4, ...
        (series([1, 2, 3, 4, 5, 5, 5, 5, 0, 0, 4, 4], minutes=15), [2.5, 5, 2]),
        # three hours repeat
        (series([6], minutes=180).reindex(pd.DatetimeIndex(["2025-01-01T00:00Z"])), None),
        (series([6, 9], minutes=180), [6, 6, 6]),
        # 40 minutes: 60 = 40 + 20, 20 + 40; (2*3 + 1*6)/3 = 4, ...
        (series([3, 6, 9, 0, 0], minutes=40), [4, 8, 0]),
        # begins half an hour before: halves of two hours
        (series([2, 4, 6, 8], "2024-12-31T23:30Z"), [3, 5, 7]),
    ],
)
def test_means_are_kept(given: pd.Series, expected: list[float] | None) -> None:
    found = on_grid(given, GRID, 120.0, "a.csv", "x")
    if expected is None:
        assert isinstance(found, Problem)
        return
    assert isinstance(found, OnGrid)
    assert found.values == pytest.approx(expected, abs=1e-12)


def test_energy_is_that_of_the_series() -> None:
    values = np.random.default_rng(3).random(7 * 24 * 12)
    given = series(values.tolist(), minutes=5)
    for minutes in (1, 7, 5, 15, 60, 180):
        grid = TimeGrid(pd.Timestamp("2025-01-02T00:00Z"), minutes, 1260 // minutes)
        found = on_grid(given, grid, 120.0, "a.csv", "x")
        assert isinstance(found, OnGrid)
        energy = found.values.sum() * minutes
        assert energy == pytest.approx(values[288 : 288 + 252].sum() * 5, rel=1e-12)


def test_gaps_lie_on_a_line_and_are_counted() -> None:
    absent = series([1.0, 9.0, 3.0, 4.0]).drop(pd.Timestamp("2025-01-01T01:00Z"))
    for given in (series([1.0, np.nan, 3.0]), absent):
        found = on_grid(given, GRID, 60.0, "a.csv", "x")
        assert isinstance(found, OnGrid)
        assert found.values.tolist() == [1.0, 2.0, 3.0]
        assert (found.filled, found.longest_gap_min) == (1, 60.0)


def test_lines_reach_beyond_the_days_that_are_chosen() -> None:
    given = series([0.0, np.nan, 2.0, 3.0, np.nan, 5.0])
    grid = TimeGrid(pd.Timestamp("2025-01-01T01:00Z"), 60.0, 4)
    found = on_grid(given, grid, 60.0, "a.csv", "x")
    assert isinstance(found, OnGrid)
    assert found.values.tolist() == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(("given", "message"), [
    (series([1.0, np.nan, np.nan, 4.0]),
        "a.csv, x: has a gap of 120 min at 2025-01-01T01:00:00Z, and 60 min are filled at most. "
        "Complete the series, choose other days, or allow longer gaps with --max-gap."),
    (series([1.0, 2.0]),
        "a.csv, x: covers 2025-01-01T00:00:00Z to 2025-01-01T02:00:00Z, and the scenario is "
        "2025-01-01T00:00:00Z to 2025-01-01T03:00:00Z. Choose days that it covers with --date or "
        "--start, and --days."),
    (series([1.0, 2.0, 3.0]).iloc[[0, 2, 1]],
        "a.csv, x = 2025-01-01T01:00:00Z: has times that are out of order. Sort the rows by time."),
    (series([1.0, 2.0, 3.0]).iloc[[0, 1, 1, 2]],
        "a.csv, x = 2025-01-01T01:00:00Z: has a time twice. Remove one of the two rows."),
])  # fmt: skip
def test_series_that_are_refused(given: pd.Series, message: str) -> None:
    assert str(on_grid(given, GRID, 60.0, "a.csv", "x")) == message


def test_hours_of_the_long_day_keep_their_energy() -> None:
    """25 half-hourly hours of London, local times without offset, on hourly steps."""
    clock = pd.date_range("2025-10-25T23:00Z", periods=50, freq="30min").tz_convert(LONDON)
    texts = pd.Index([t.strftime("%Y-%m-%d %H:%M") for t in clock])
    times, problems = in_utc(texts, LONDON, "a.csv")
    assert not problems
    grid = grid_from(local_midnight("2025-10-26", LONDON), 1, 60.0, LONDON)
    values = np.arange(50.0)
    found = on_grid(pd.Series(values, times), grid, 60.0, "a.csv", "x")
    assert isinstance(found, OnGrid)
    assert found.values.tolist() == (2 * np.arange(25) + 0.5).tolist()
