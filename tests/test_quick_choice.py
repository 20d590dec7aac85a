"""The quick choice follows from measured durations, and the lists of offenders name them all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import durations
from tests.support.durations import (
    QUICK_S,
    function_of,
    quick_choice,
    read_durations,
    write_durations,
)
from tests.support.offenders import assert_for_all


def test_first_cases_are_taken_as_long_as_they_fit() -> None:
    names = ["windows", "windows", "day", "windows", "windows", "never measured"]
    seconds = {"windows": 0.4 * QUICK_S, "day": 1.1 * QUICK_S}
    assert quick_choice(names, seconds) == [True, True, False, False, False, True]


def test_cases_of_a_function_share_its_name() -> None:
    assert function_of("tests/test_x.py::test_y[a-[1]]") == "tests/test_x.py::test_y"
    assert function_of("vppres/x.py::vppres.x.f") == "vppres/x.py::vppres.x.f"


def test_short_tests_are_not_listed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(durations, "FILE", tmp_path / "durations.csv")
    assert read_durations() == {}
    write_durations({"b": 2.0, "a": 0.5, "short": 0.01})
    assert read_durations() == {"a": 0.5, "b": 2.0}


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
