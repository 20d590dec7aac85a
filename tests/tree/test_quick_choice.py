"""Which tests run follows from measured durations, and the lists of offenders name them all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import durations
from tests.support.durations import (
    COLLECTED,
    GROWN_S,
    LONG_S,
    QUICK_CASE_S,
    UNMARKED,
    USUAL_S,
    function_of,
    is_random,
    quick_choice,
    read_durations,
    too_long,
    unmeasured_choice,
    usual_choice,
    write_durations,
)
from tests.support.offenders import assert_for_all

GROWING = f"""
from itertools import count
from tests.support import durations
import pytest

def pytest_addoption(parser):
    for name in ("quick", "nightly", "measure"):
        parser.addoption(f"--{{name}}", action="store_true")

def pytest_configure(config):
    config.addinivalue_line("markers", "daily: by day")
    durations.processor_s = count(step={1.1 * GROWN_S}).__next__
    config.pluginmanager.register(durations.Durations(config))
"""


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
    seconds = {"windows": 0.4 * USUAL_S, "page": 1.1 * LONG_S}
    random = [name == "windows" for name in names]
    assert usual_choice(names, seconds, random) == [True, True, True, True, False, True]


def test_every_long_test_says_when_it_runs(request: pytest.FixtureRequest) -> None:
    found = too_long(request.config.stash[UNMARKED], read_durations())
    assert found == [], "make them shorter, or mark them nightly (or daily, if they are worth it)"
    assert too_long({"day", "page"}, {"day": 1.1 * LONG_S, "page": LONG_S}) == ["day"]


def test_a_test_that_has_grown_fails(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makeconftest(GROWING)
    pytester.makepyfile(
        """
        import pytest

        def test_grown(): pass

        @pytest.mark.daily
        def test_long(): pass
        """
    )
    found = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    found.assert_outcomes(passed=2, errors=1)
    found.stdout.fnmatch_lines(["*s of CPU time: make it shorter, or mark it nightly*"])


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
