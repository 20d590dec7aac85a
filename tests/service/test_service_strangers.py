"""Nobody without a right can stop the service: what anybody may send to it costs little."""

from __future__ import annotations

import http.client
import os
import resource
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.browser import listening
from tests.support.live_service import HERE, NOON, Live, running, site
from tests.support.strangers import address, attacks, lives, silent
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import StorageError
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock
from vppres.service.http import connections
from vppres.service.http.app import make_app
from vppres.service.http.client import Client
from vppres.service.http.connections import MOST_AT_ONCE, SILENT_S
from vppres.service.http.serve import opened
from vppres.service.http.started import Started, started
from vppres.service.operation.site import Service
from vppres.service.storage.transactions import TRIED_S

LOCKED_OUT_S = SILENT_S / 2
"""Whoever is locked out waits until a silent connection is closed, which takes twice as long."""
WITHIN_S = 1.0
MOST_MB = 1_000.0


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Started]:
    """A service in a process of its own, whose clock is set."""
    served = Service(site(tiny_scenario()), HERE, paced=True)
    with started(served, tmp_path_factory.mktemp("live")) as own:
        yield own


@pytest.mark.parametrize("many", [MOST_AT_ONCE, 3 * MOST_AT_ONCE])
def test_connections_that_ask_for_nothing_lock_nobody_out(own: Started, many: int) -> None:
    assert many + 100 < resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    with silent(own, many):
        assert max(lives(own) for _ in range(10)) < LOCKED_OUT_S
        with closing(Client(own.url)) as asked:
            assert asked.ask("GET", "/v1/plan").status == 200


@pytest.mark.daily
@pytest.mark.parametrize("body", [b" " * 9_000_000, b"[" * 2_000_000])
def test_who_sends_too_much_is_told(own: Started, body: bytes) -> None:
    """By a client that sends all of it before it looks for an answer."""
    with closing(http.client.HTTPConnection(*address(own), timeout=60)) as asked:
        asked.request("POST", "/v1/telemetry", body, {"content-type": "application/json"})
        assert asked.getresponse().status == 413


async def absent(_scope: Any, _receive: Any, send: Any) -> None:
    """An application that answers before the body is there, and has nothing."""
    await send(
        {"type": "http.response.start", "status": 404, "headers": [(b"content-length", b"0")]}
    )
    await send({"type": "http.response.body"})


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, int]]:
    """Host and port of a server whose connections may be silent for a second."""
    monkeypatch.setattr(connections, "SILENT_S", 1.0)
    with listening(absent, http=connections.Connection, lifespan="off") as address:
        yield "127.0.0.1", urlsplit(address).port or 0


def test_a_head_has_its_time(hasty: tuple[str, int]) -> None:
    """Byte after byte, or a body that nobody waits for: the connection is closed all the same."""
    trickling = socket.create_connection(hasty)
    answered = socket.create_connection(hasty)
    answered.send(b"POST /nowhere HTTP/1.1\r\nhost: localhost\r\ncontent-length: 100\r\n\r\n")
    begin = time.monotonic()
    ended = set()
    while len(ended) < 2 and time.monotonic() - begin < 60.0:
        for one in {trickling, answered} - ended:
            try:
                one.send(b"G")
            except OSError:
                ended.add(one)
        time.sleep(0.05)
    assert len(ended) == 2
    for one in ended:
        one.close()


def test_a_connection_that_is_answered_in_time_stays(hasty: tuple[str, int]) -> None:
    """Each answer begins the time anew: four times of 0.3 s are more than the second."""
    with closing(http.client.HTTPConnection(*hasty)) as asked:
        ports = set()
        for _ in range(5):
            asked.request("GET", "/")
            asked.getresponse().read()
            ports.add(asked.sock.getsockname()[1])
            time.sleep(0.3)
    assert len(ports) == 1


@pytest.mark.nightly
def test_mistakes_of_8_mb_and_13000_reads_stop_no_step(own: Started) -> None:
    day = site(tiny_scenario()).grid
    rows = pd.DataFrame(attacks(own, day.start, day.step))
    assert (rows["step"] == "ok").all() and rows["step_s"].max() < 10.0
    assert rows["livez_p95_s"].max() < WITHIN_S
    assert rows["peak_mb"].max() < MOST_MB


def test_who_asks_whether_it_is_ready_writes_nothing(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(tiny, tmp_path) as (http, _, runner):
        http.post("/v1/steps")
        writes: list[Any] = []
        monkeypatch.setattr(runner.store._database, "check", writes.append)
        assert [http.get("/readyz").status for _ in range(50)] == [200] * 50
        assert len(writes) == 0  # the step was written a moment ago
        runner.store._tried_at -= TRIED_S
        assert [http.get("/readyz").status for _ in range(50)] == [200] * 50
        assert len(writes) == 1


def test_whoever_is_denied_has_no_limit_of_its_own(
    own: Started, tiny: Scenario, tmp_path: Path
) -> None:
    """Whatever address a request says that it comes from."""
    _, token = new_token("panel:read")
    with opened(Service(site(tiny), HERE), tmp_path, SetClock(NOON)) as runner:
        http = Caller(make_app(runner, Access([token])))
        answers = [
            http.get("/v1/plan", authorization="Bearer x", x_forwarded_for=f"10.0.0.{i}")
            for i in range(40)
        ]
    assert [one.status for one in answers] == [401] * 30 + [429] * 10
    assert answers[-1].headers["retry-after"] == "1"
    assert answers[-1].headers["content-type"] == "application/problem+json"


def test_a_database_that_is_gone_is_noticed(live: Live, tmp_path: Path) -> None:
    """Nothing is acknowledged that is not kept."""
    http, _ = live
    event = {"type": "outage", "start": "2026-11-21T14:00:00Z"}
    assert http.put("/v1/events/storm", event).status == 201
    assert http.post("/v1/steps").status == 200 and http.get("/readyz").status == 200
    os.unlink(tmp_path / "state" / "service.db")
    answer = http.put("/v1/events/storm", event)
    assert answer.status == 503 and "was removed or replaced" in answer.json()["detail"]
    ready = http.get("/readyz")
    assert ready.status == 503 and not ready.json()["checks"]["database"]
    (tmp_path / "state" / "service.db").write_bytes(b"")
    assert http.put("/v1/events/storm", event).status == 503
    assert http.get("/v1/plan").status == 200


def test_a_table_that_breaks_is_said(tiny: Scenario, tmp_path: Path) -> None:
    with opened(Service(site(tiny), HERE), tmp_path, SetClock(NOON)) as runner:
        with pytest.raises(StorageError), runner.store._changes() as db:
            db.exec_driver_sql("SELECT nothing")
        assert not runner.store.ready()
        runner.store._tried_at -= TRIED_S
        assert runner.store.ready()
