"""Alarms: raised, acknowledged, shelved and cleared, and what people are told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import (
    NOON,
    Running,
    decided,
    running,
)
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access, new_token
from vppres.service.alarms.conditions import KINDS, Situation, conditions, situation
from vppres.service.alarms.state import Alarms, Notice
from vppres.service.clock import SetClock, written
from vppres.service.http.app import make_app
from vppres.service.operation.runner import Runner
from vppres.service.storage.records import Condition, Reading, seconds
from vppres.service.storage.store import Store

HOUR = pd.Timedelta("1h")
MINUTE = pd.Timedelta("1min")
DARK = {"type": "outage", "start": written(NOON)}


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Running]:
    with running(tiny, tmp_path) as found:
        yield found


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    found = Store(tmp_path, "site")
    yield found
    found.close()


def listed(http: Caller, path: str = "/v1/alarms") -> list[tuple[str, str, str]]:
    """Kind, priority and state of each alarm."""
    return [(a["kind"], a["priority"], a["state"]) for a in http.get(path).json()["alarms"]]


def later(runner: Runner, minutes: float) -> None:
    """Let time go by, of which nobody is told anything."""
    assert isinstance(runner.clock, SetClock)
    runner.set_clock(runner.clock.now() + minutes * MINUTE)


# The life of an alarm, with conditions of any kind.


class Book:
    """Alarms with a clock, and the notices that came of them."""

    def __init__(self, store: Store) -> None:
        self.alarms = Alarms(store)
        self.notices: list[tuple[str, list[str]]] = []
        self.alarms.on_notice = self._hear
        self.now = NOON

    def _hear(self, notice: Notice) -> None:
        self.notices.append((notice.what, [one["text"] for one in notice.alarms]))

    def look(self, minutes: float, *conditions: Condition) -> list[str]:
        """The states of all alarms after some minutes with these conditions."""
        self.now += minutes * MINUTE
        self.alarms.look(conditions, self.now)
        return [one["state"] for one in self.alarms.listed(self.now)]


def off(*names: str, priority: str = "high", text: str = "off") -> Condition:
    return Condition("critical_off", "", priority, text, names)


def test_an_alarm_from_its_rise_to_its_end(store: Store) -> None:
    book = Book(store)
    silent = Condition("source_lost", "scada", "medium", "No data from scada.")
    assert book.look(0, silent) == book.look(4, silent) == []
    assert book.look(1, silent) == ["raised"]  # five minutes after it was seen first
    (one,) = book.alarms.listed(book.now)
    assert one["raised_at"] == written(NOON + 5 * MINUTE)
    assert one["advice"] == KINDS["source_lost"].advice
    book.alarms.acknowledge(one["id"], "ann", "on my way", book.now)
    assert book.look(1, silent) == ["acknowledged"]
    assert book.look(4) == book.look(4.9) == ["acknowledged"]  # not gone for long enough
    assert book.look(1) == []
    (past,) = book.alarms.listed(book.now, since=NOON)
    assert (past["state"], past["acknowledged_by"]) == ("closed", "ann")
    assert book.notices == [
        ("raised", ["No data from scada."]),
        ("cleared", ["No data from scada."]),
    ]
    assert (
        "ann",
        "alarm acknowledged",
        "1 source_lost scada on my way",
    ) in book.alarms.store.audit()


def test_the_log_says_when(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    Book(store).look(0, off("a", text="a is off."))
    assert caplog.messages == [f"{written(NOON)}: alarm raised: a is off."]


def test_what_nobody_acknowledged_stays_and_is_told_again(store: Store) -> None:
    book = Book(store)
    assert book.look(0, off("a")) == ["raised"]
    for _ in range(3):
        book.look(59, off("a"))
    assert [what for what, _ in book.notices] == ["raised", "reminder"]
    book.look(0)
    assert book.look(10) == ["cleared"]
    book.alarms.acknowledge(1, "ann", "", book.now)
    assert book.look(0) == []


def test_an_acknowledgement_lapses_when_it_gets_worse(store: Store) -> None:
    book = Book(store)

    def acknowledged(*conditions: Condition) -> list[str]:
        book.alarms.acknowledge(1, "ann", "", book.now)
        return book.look(1, *conditions)

    book.look(0, off("a", priority="medium"))
    assert acknowledged(off("a", priority="medium", text="other words")) == ["acknowledged"]
    assert acknowledged(off("a")) == ["raised"]
    assert acknowledged(off("a", "b")) == ["raised"]
    assert acknowledged(off("b")) == ["acknowledged"]  # fewer, and of both it was known
    assert [what for what, _ in book.notices] == ["raised"] * 3


def test_a_shelved_alarm_is_silent_up_to_its_end(store: Store) -> None:
    book = Book(store)
    book.look(0, off("a"))
    book.alarms.shelve(1, book.now + 3 * HOUR, "ann", "known", book.now)
    assert book.look(1, off("a")) == ["shelved"]
    book.look(1)
    book.look(20)
    book.look(1, off("a", "b"))
    assert [one["state"] for one in book.alarms.listed(book.now)] == ["shelved", "cleared"]
    assert [what for what, _ in book.notices] == ["raised"]
    assert "shelved" not in book.look(180, off("a", "b"))
    assert book.notices[-1][0] == "reminder"


def test_alarms_last_over_a_restart(store: Store) -> None:
    book = Book(store)
    book.look(0, off("a"))
    again = Alarms(store)
    again.look([off("a")], NOON + HOUR)
    assert [one["raised_at"] for one in again.listed(NOON + HOUR)] == [written(NOON)]
    again.look([], NOON + HOUR)
    again.look([], NOON + 2 * HOUR)
    assert [one["state"] for one in again.listed(NOON + 2 * HOUR)] == ["cleared"]


# What raises them in a service.


@pytest.mark.parametrize(
    ("hours", "priority"), [(1, "high"), (2, "medium"), (6, "medium"), (7, "")]
)
def test_a_critical_customer_that_will_be_off(tiny: Scenario, hours: int, priority: str) -> None:
    times = [written(NOON + hour * HOUR) for hour in range(1, 9)]
    served = {"hospital": [hour != hours for hour in range(1, 9)], "shop": [False] * 8}
    plan = {"status": "ok", "start": written(NOON), "setpoints": []}
    plan["ahead"] = {"times": times, "served": served}
    heard = [{"asset": "big", "quantity": "soc", "source": "scada", "state": "ok"}]
    now = Situation(NOON, tiny, plan, 3600.0, (), heard, {}, False, {})
    found = [(one.kind, one.priority, one.text, one.due) for one in conditions(now)]
    words = f"Planned: hospital of the first tier off supply at {NOON + hours * HOUR:%H:%M}."
    expected = [("critical_off", priority, words, NOON + hours * HOUR)] if priority else []
    assert found == expected
    over = replace(now, now=NOON + (hours + 0.5) * HOUR, ahead_s=-1.0)  # and was not decided
    assert f"at {NOON + hours * HOUR:%H:%M}" not in "".join(one.text for one in conditions(over))
    lost = replace(now, failing={"hospital": "rejected"})
    assert [one.kind for one in conditions(lost)] == ["setpoint_rejected"]
    alone = replace(now, unreached=["hooks.example"])
    kinds = [one.kind for one in conditions(alone) if one.subject == "hooks.example"]
    assert kinds == ["notices_undelivered"]


def test_fallbacks_that_last(live: Running, monkeypatch: pytest.MonkeyPatch) -> None:
    http, clock, runner = live
    decided(http, clock, NOON)
    assert runner.last
    runner.last = {**runner.last, "status": "fallback"}
    runner.last["solve"] = {"fallback": "previous_plan", "fallback_reason": "time limit"}
    runner.watch.check_alarms()
    later(runner, 29)
    assert listed(http) == []
    later(runner, 1)
    (found,) = http.get("/v1/alarms").json()["alarms"]
    assert found["text"] == "Steps are decided by a fallback (previous plan): time limit."


# Over HTTP.


def test_who_may_only_read_alarms_does_not_acknowledge_them(live: Running) -> None:
    http, clock, runner = live
    http.put("/v1/events/storm", DARK)
    decided(http, clock, NOON, soc=0.151)
    number = http.get("/v1/alarms").json()["alarms"][0]["id"]
    secret, token = new_token("panel:read")
    tight = Caller(make_app(runner, Access([token])))
    asked = {"authorization": f"Bearer {secret}"}
    assert tight.get("/v1/alarms", **asked).status == 200
    assert tight.post(f"/v1/alarms/{number}/acknowledge", **asked).status == 403


def test_a_day_of_lost_readings_is_told_in_a_few_notices(store: Store, tiny: Scenario) -> None:
    """Of 30% of the readings, a new one each hour: less than ten notices."""
    book = Book(store)
    random = np.random.default_rng(1)
    plan = {"status": "ok", "start": written(NOON), "setpoints": []}
    items = [("soc", "big"), ("soc", "small"), *(("load_kw", str(c)) for c in tiny.customers.id)]
    for quarter in range(96):
        now = NOON + quarter * 15 * MINUTE
        if quarter % 4 == 0:
            kept = [one for one in items if random.random() > 0.3]
            store.write_readings(
                [Reading(name, kind, seconds(now), "scada", 3600, 0.6) for kind, name in kept], now
            )
        book.alarms.look(conditions(situation(now, tiny, store, plan, 3600.0)), now)
    assert 0 < len(book.notices) < 10
