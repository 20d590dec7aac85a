"""Which tests run follows from measured durations, and the lists of offenders name them all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import durations
from tests.support.durations import (
    COLLECTED,
    LONG_S,
    QUICK_CASE_S,
    USUAL_S,
    function_of,
    is_random,
    quick_choice,
    read_durations,
    unmeasured_choice,
    usual_choice,
    write_durations,
)
from tests.support.offenders import assert_for_all


def test_every_test_is_measured(request: pytest.FixtureRequest) -> None:
    unmeasured = request.config.stash[COLLECTED] - set(read_durations())
    assert sorted(unmeasured) == [], "run `make durations` and commit tests/durations.csv"


def test_quick_runs_take_the_first_case_of_short_functions_that_were_measured() -> None:
    names = ["windows", "windows", "day", "windows", "never measured"]
    seconds = {"windows": QUICK_CASE_S, "day": 1.1 * QUICK_CASE_S}
    assert quick_choice(names, [[]] * 5, seconds) == [True, False, False, False, False]


def test_quick_runs_count_the_fixtures_that_a_case_shares() -> None:
    seconds = {"a": 0.0, "b": 0.6 * QUICK_CASE_S, "run": QUICK_CASE_S, "folder": 0.1 * QUICK_CASE_S}
    fixtures = [["run"], ["run"], ["folder"], ["never measured"]]
    assert quick_choice(["a", "b", "b", "a"], fixtures, seconds) == [True, False, False, False]
    assert quick_choice(["b"], [["folder"]], seconds) == [True]


def test_new_functions_are_measured_and_one_function_on_a_new_fixture() -> None:
    names = ["old", "new", "new", "on it", "on it", "on it too"]
    fixtures = [[], [], [], ["run"], ["run"], ["run"]]
    chosen = [False, True, True, True, True, False]
    assert unmeasured_choice(names, fixtures, {"old": 0, "on it": 0, "on it too": 0}) == chosen


def test_usual_runs_take_the_first_random_cases_that_fit_and_one_at_least() -> None:
    names = ["windows", "windows", "page", "page", "windows", "never measured"]
    seconds = {"windows": 0.4 * USUAL_S, "page": 0.9 * LONG_S}
    random = [name == "windows" for name in names]
    chosen = [True, True, True, True, False, True]
    assert usual_choice(names, seconds, random, [False] * len(names)) == chosen


def test_usual_runs_leave_long_functions_for_the_night_unless_they_are_daily() -> None:
    names = ["day", "published", "published"]
    seconds = dict.fromkeys(names, 1.1 * LONG_S)
    daily = [name == "published" for name in names]
    assert usual_choice(names, seconds, [False] * 3, daily) == [False, True, True]


@pytest.mark.parametrize(("seed", "case"), [(0, "a-[1]")])
def test_cases_are_random_by_their_seed(
    seed: int, case: str, request: pytest.FixtureRequest
) -> None:
    assert is_random(request.node)
    assert function_of(request.node.nodeid).endswith("::test_cases_are_random_by_their_seed")


def test_durations_are_written_by_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    assert not is_random(request.node)
    monkeypatch.setattr(durations, "FILE", tmp_path / "durations.csv")
    assert read_durations() == {}
    write_durations({"b": 2.0, "a": 0.5, "short": 0.01})
    assert read_durations() == {"a": 0.5, "b": 2.0, "short": 0.01}


def test_every_offender_is_named() -> None:
    def check(value: int) -> None:
        assert value < 3, "too large"
        _ = 1 / value

    assert_for_all({"one": 1, "two": 2}, check)
    with pytest.raises(pytest.fail.Exception) as failed:
        assert_for_all({"zero": 0, "one": 1, "four": 4}, check)
    text = str(failed.value)
    assert text.startswith("2 of 3 cases:\nzero: ZeroDivisionError: division by zero\nfour: Asse")
    assert "too large" in text and "one:" not in text
