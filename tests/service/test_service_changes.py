"""Who changes what: two at once, who asked for a step, and how many steps there were."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Answer, Caller
from tests.support.live_service import NOON, Running, running
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access, new_token
from vppres.service.http.app import make_app
from vppres.service.operation.runner import Runner

HOUR = pd.Timedelta("1h")
OUTAGE = {"type": "outage", "start": "2026-11-21T15:00:00Z", "end": "2026-11-21T16:00:00Z"}
HOLD = {"mode": "hold", "until": "2026-11-21T18:00:00Z", "reason": "a look"}


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Running]:
    with running(tiny, tmp_path) as found:
        yield found


def meanwhile(
    runner: Runner, monkeypatch: pytest.MonkeyPatch, change: Callable[[], Answer]
) -> list[int]:
    """Let somebody else's change go before the next transaction; the status of its answer."""
    transaction = runner.store._changes
    found: list[int] = []

    @contextmanager
    def late(*args: Any, **kwargs: Any) -> Iterator[Any]:
        monkeypatch.setattr(runner.store, "_changes", transaction)
        found.append(change().status)
        with transaction(*args, **kwargs) as db:
            yield db

    monkeypatch.setattr(runner.store, "_changes", late)
    return found


def test_of_two_that_replace_the_same_event_one_does(
    live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have read its first version; the second one writes before the first one does."""
    http, _, runner = live
    tag = http.put("/v1/events/storm", OUTAGE).headers["etag"]
    longer = {**OUTAGE, "end": "2026-11-21T20:00:00Z"}
    other = meanwhile(
        runner, monkeypatch, lambda: http.put("/v1/events/storm", longer, if_match=tag)
    )
    answer = http.put("/v1/events/storm", {**OUTAGE, "end": None}, if_match=tag)
    assert (other, answer.status) == ([200], 412)
    assert answer.json()["detail"] == "The event has another version than 1."
    assert http.get("/v1/events/storm").json()["end"] == "2026-11-21T20:00:00Z"
    assert len(runner.store.events_ever()["storm"]) == 2
    # To withdraw it is a change like any other.
    other = meanwhile(runner, monkeypatch, lambda: http.delete("/v1/events/storm"))
    assert http.delete("/v1/events/storm").status == 412 and other == [200]
    assert http.delete("/v1/events/storm").status == 404
    assert http.put("/v1/events/storm", OUTAGE, if_match='"3"').status == 412
    assert http.put("/v1/events/storm", OUTAGE, if_match="*").status == 412
    assert http.put("/v1/events/storm", OUTAGE).status == 201


def test_of_two_operators_the_second_sees_what_the_first_did(
    live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    http, _, runner = live
    tag = http.get("/v1/mode").headers["etag"]
    other = meanwhile(
        runner, monkeypatch, lambda: http.put("/v1/mode", {"mode": "off"}, if_match=tag)
    )
    assert http.put("/v1/mode", HOLD, if_match=tag).status == 412 and other == [200]
    seen = http.get("/v1/mode")
    assert seen.json()["mode"] == "off"
    put = http.put("/v1/mode", HOLD, if_match=seen.headers["etag"])
    assert put.status == 200 and put.headers["etag"] == http.get("/v1/mode").headers["etag"]


def test_who_asked_for_a_step_is_written_down_once(live: Running) -> None:
    _, clock, runner = live
    secret, token = new_token("control-room:operator,read,telemetry")
    http = Caller(make_app(runner, Access([token])))
    bearer = {"authorization": f"Bearer {secret}"}
    for _ in range(2):
        assert http.post("/v1/steps", **bearer).status == 200
    http.post("/v1/steps", **bearer, prefer="respond-async")
    clock.set(NOON + HOUR)
    runner.step()  # as the clock does
    steps = [row for row in runner.store.audit() if row[1] == "step"]
    assert steps == [("control-room", "step", "p-2026-11-21T12:00:00Z ok")]
