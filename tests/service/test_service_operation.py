"""What devices answer, what an operator orders, and steps that nobody waits for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np
import pandas as pd

from tests.support.browser import listening
from tests.support.live_service import (
    HERE,
    NOON,
    said,
    serving,
    site,
)
from vppres.scenario.scenario import Scenario
from vppres.service.access import Access
from vppres.service.clock import SetClock
from vppres.service.http.app import make_app
from vppres.service.http.client import Client
from vppres.service.operation.site import Service

HOUR = pd.Timedelta("1h")


def test_names_need_no_encoding_by_hand(tiny: Scenario, tmp_path: Path) -> None:
    """The identifier of a set-point is written in an address as it is, or encoded once more."""
    odd = "Küche 2/50% #1?"
    named = replace(tiny, batteries=replace(tiny.batteries, id=np.array([odd, "small"], object)))
    with serving(Service(site(named), HERE), tmp_path, SetClock(NOON)) as (http, runner):
        point = said(runner.step(), "batteries")[odd]
        assert point["id"].isascii() and not set(point["id"]) & set(" #?")
        with listening(make_app(runner, Access())) as address:
            client = Client(address)
            for name in (point["id"], quote(point["id"], safe=""), quote(unquote(point["id"]))):
                answer = client.ask("POST", f"/v1/setpoints/{name}/status", {"status": "started"})
                assert answer.status == 200 and answer.body["id"] == point["id"], name
            client.close()
        assert runner.store.acks([point["id"]])[point["id"]]["status"] == "started"
        storm = {"type": "outage", "start": "2026-11-21T13:00:00Z"}
        assert http.put("/v1/events/north/storm 1", storm).status == 201
        assert http.put("/v1/events/north%2Fstorm%201", storm).status == 200
        assert [*http.get("/v1/events").json()] == ["north/storm 1"]
        assert len(http.get("/v1/events/north/storm%201/versions").json()) == 2
        assert http.delete("/v1/events/north/storm%201").status == 200
