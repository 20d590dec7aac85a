"""Sequences of requests, each with its answer: ``tests/service/sequences/*.txt``."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.sequences import Absent, Checks, Sequence, at, cases, play, read


@pytest.mark.parametrize("sequence", cases())
def test_a_sequence_of_requests(
    sequence: Sequence, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    play(sequence, tmp_path, caplog)


@pytest.mark.parametrize("row", [
    "12:00 GET plan -> 404",
    "12:00 GET plan -> status: ok",
    "12:00 GET plan -> nothing: null",
    "12:00 GET plan -> $unknown: !absent",
    "12:00 GET plan -> status: !has-not non",
    "12:00 GET plan -> setpoints: !every {kind: batteries}",
    "12:00 hear {soc: {bigg: 0.5, small: 0.5}}",
    "12:00 hear {soc: {big: 0.5}} -> accepted: !above 1",
    "12:00 POST setpoints/$big/status {status: rejected}",
    "noon GET plan",
])  # fmt: skip
def test_what_does_not_hold_fails(
    row: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(AssertionError):
        play(Sequence("wrong", {}, (row,)), tmp_path, caplog)


POINTS = [{"asset": "big", "p_kw": -3.0, "on": True}, {"asset": "shop", "on": False, "why": "none"}]


@pytest.mark.parametrize(("path", "good", "bad"), [
    ("big.p_kw", "-3", "3"),
    ("*.on", "[true, false]", "[true]"),
    ("*.p_kw", "[!below -2]", "[!above -3]"),
    (".", "!one {asset: shop, on: false}", "!one {asset: shop, on: true}"),
    (".", "!where {on: true, asset: !names [big]}", "!where {on: true, asset: !names [shop]}"),
    ("shop.p_kw", "!absent ", "null"),
    ("shop.why", "!begins no", "!begins on"),
    ("1", "!part {why: none}", "{why: none}"),
    ("*.asset", "!all [!count 2, !first [big]]", "!all [!count 2, !first [shop]]"),
    ("big.p_kw", "!near {of: -3.1, within: 0.2}", "!near -3.1"),
    ("0", "{asset: big, p_kw: !above -4, on: true}", "{asset: big, p_kw: !above -4}"),
])  # fmt: skip
def test_parts_and_checks(path: str, good: str, bad: str) -> None:
    checks, found = Checks({}), at(POINTS, path)
    assert checks.matches(read(f"[{good}]"), [found])
    assert not checks.matches(read(f"[{bad}]"), [found])
    assert found is Absent or not checks.matches(read("[!absent ]"), [found])


def test_off_is_a_word_and_a_time_a_moment() -> None:
    told = read("{mode: off, on: [yes, 1e3, true, null], at: 12:10, late: 25:00, said: '12:10'}")
    assert told == {"mode": "off", "on": ["yes", 1000.0, True, None], "at": "2026-11-21T12:10:00Z",
                    "late": "2026-11-22T01:00:00Z", "said": "12:10"}  # fmt: skip
