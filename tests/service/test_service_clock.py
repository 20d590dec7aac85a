"""A clock that jumps ahead and back, and a state of which the last part is lost."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import HERE, NOON, heard, site
from vppres.core.errors import InputError
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service

HOUR = pd.Timedelta("1h")


class Wall:
    """A clock on the wall that somebody sets."""

    def __init__(self, time: pd.Timestamp) -> None:
        self.time = time

    def now(self) -> pd.Timestamp:
        return self.time


@contextmanager
def running(tiny: Scenario, folder: Path, clock: Wall) -> Iterator[tuple[Runner, Caller]]:
    with opened(Service(site(tiny), HERE), folder, clock) as runner:
        yield runner, Caller(make_app(runner, Access()))


def decided(runner: Runner, http: Caller) -> dict[str, Any]:
    """What the loop does when it wakes up."""
    http.post("/v1/telemetry", heard(runner.begun(runner.clock.now())))
    return runner.step()


JUMPS = [("60D", False), ("2h", True)]
MORE_JUMPS = [("2h", False), ("60D", True), ("3650D", True)]


@pytest.mark.parametrize(
    ("jump", "restarted"),
    [*JUMPS, *(pytest.param(*jump, marks=pytest.mark.nightly) for jump in MORE_JUMPS)],
)
def test_a_clock_that_jumped_ahead_and_came_back_stops_nothing(
    jump: str, restarted: bool, tiny: Scenario, tmp_path: Path
) -> None:
    clock = Wall(NOON)
    ahead = NOON + pd.Timedelta(jump)
    with running(tiny, tmp_path, clock) as (runner, http):
        assert decided(runner, http)["status"] == "ok"
        clock.time = ahead
        for _ in range(4):  # more than there are states kept
            assert decided(runner, http)["status"] == "ok"
            clock.time += HOUR
        clock.time = NOON + HOUR
        assert http.get("/readyz").status == 503
        assert http.get("/v1/plan").json()["status"] == "stale"
        if not restarted:
            decides_again(runner, http, clock)
    if restarted:
        with running(tiny, tmp_path, clock) as (runner, http):
            decides_again(runner, http, clock)


def decides_again(runner: Runner, http: Caller, clock: Wall) -> None:
    for later in (1, 2, 3):
        clock.time = NOON + later * HOUR
        assert decided(runner, http)["status"] == "ok"
        assert http.get("/readyz").status == 200
        (shown,) = http.get("/v1/setpoints?asset=big").json()["setpoints"]
        assert shown["active"]
    plans = runner.store.plans(NOON)
    assert [plan["status"] for plan in plans] == ["ok"] * 4
    said = [detail for actor, _, detail in runner.store.audit() if actor == "clock"]
    assert len(said) == 1 and "the clock was set back to" in said[0]


def test_what_was_decided_early_is_decided_again(tiny: Scenario, tmp_path: Path) -> None:
    """An hour ahead, and back within the step: the next step rests on readings of its own."""
    clock = Wall(NOON)
    with running(tiny, tmp_path, clock) as (runner, http):
        decided(runner, http)
        clock.time = NOON + pd.Timedelta("90min")
        early = decided(runner, http)
        clock.time = NOON + pd.Timedelta("45min")
        assert decided(runner, http)["start"] == "2026-11-21T12:00:00Z"
        assert http.get("/readyz").status == 200
        clock.time = NOON + HOUR
        again = decided(runner, http)
        assert again["id"] == early["id"] and again["generated_at"] < early["generated_at"]


def test_a_clock_that_is_set_by_a_second_changes_nothing(tiny: Scenario, tmp_path: Path) -> None:
    clock = Wall(NOON + pd.Timedelta("1s"))
    with running(tiny, tmp_path, clock) as (runner, http):
        first = decided(runner, http)
        clock.time = NOON
        assert decided(runner, http) == first
        assert http.get("/readyz").status == 200


@pytest.mark.nightly
def test_a_stop_of_days_is_missed_and_one_of_weeks_a_clock(tiny: Scenario, tmp_path: Path) -> None:
    clock = Wall(NOON)
    with running(tiny, tmp_path, clock) as (runner, http):
        decided(runner, http)
        clock.time = NOON + pd.Timedelta("3D")
        decided(runner, http)
        assert runner.outcomes["missed"] == 71
        clock.time = NOON + pd.Timedelta("300D")
        assert decided(runner, http)["status"] == "ok"
        assert runner.outcomes["missed"] == 71
        # Nor is anything too old of a sudden.
        assert runner.store.step(NOON)


def test_a_state_that_is_cut_gives_way_to_the_one_before(
    tiny: Scenario, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    clock = Wall(NOON)

    with running(tiny, tmp_path, clock) as (runner, http):
        for later in range(3):
            clock.time = NOON + later * HOUR
            decided(runner, http)
    cut(tmp_path, last=2)
    clock.time = NOON + 3 * HOUR
    with caplog.at_level(logging.ERROR), running(tiny, tmp_path, clock) as (runner, http):
        assert decided(runner, http)["status"] == "ok"
    assert sum("is cut: the one before" in record.message for record in caplog.records) == 2
    cut(tmp_path, last=4)
    with pytest.raises(InputError, match="has no whole state of the controller"):
        begun(tiny, tmp_path)


@pytest.mark.parametrize("content", [b"garbage", b"SQLite format 3\x00" + b"x" * 5000])
def test_garbage_for_a_database_is_a_bad_input(
    content: bytes, tiny: Scenario, tmp_path: Path
) -> None:
    (tmp_path / "service.db").write_bytes(content * 100)
    for _ in range(2):  # the lock is given back
        with pytest.raises(InputError, match=r"service\.db: is no database of a service"):
            begun(tiny, tmp_path)


def begun(tiny: Scenario, folder: Path) -> None:
    """A service that begins and ends."""
    with opened(Service(site(tiny), HERE), folder, Wall(NOON + 4 * HOUR)):
        pass


def cut(folder: Path, last: int) -> None:
    """Halve the last states that are stored."""
    with closing(sqlite3.connect(folder / "service.db")) as db, db:
        times = db.execute("SELECT time FROM controller_state ORDER BY time DESC").fetchall()
        db.executemany(
            "UPDATE controller_state SET state = substr(state, 1, length(state) / 2) WHERE time = ?",
            times[:last],
        )
