"""OpenADR 3 events of unusual size; the others are in ``sequences/openadr.txt``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.support.live_service import NOON, running
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written

EVENT: dict[str, Any] = {
    "id": "17",
    "programID": "resilience",
    "intervalPeriod": {"start": written(NOON), "duration": "PT1H"},
}


def alerts(*kinds: str) -> dict[str, Any]:
    """An interval with alerts."""
    return {"payloads": [{"type": f"ALERT_{kind}", "values": [i]} for i, kind in enumerate(kinds)]}


def test_what_has_too_many_payloads_is_refused(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as (http, *_):
        many = {**EVENT, "intervals": [alerts("OTHER", "BLACK_START")] * 1001}
        answer = http.post("/v1/openadr/events", many)
        assert answer.status == 422 and "too many payloads" in answer.content.decode()
        assert http.get("/v1/events").json() == {}


def test_names_may_be_as_long_as_openadr_has_them(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as (http, *_):
        for tail in "ab":
            long = {**EVENT, "id": 99 * "x" + tail, "intervals": [alerts(*["OTHER"])] * 4}
            assert http.post("/v1/openadr/events", long).status == 201
        names = http.get("/v1/events").json()
        assert len(names) == 8 and max(map(len, names)) <= 100


def test_a_message_is_one_transaction(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as (http, _, runner):
        before = runner.store.changes
        many = {**EVENT, "intervals": [alerts("OTHER")] * 300}
        assert http.post("/v1/openadr/events", many).status == 201
        assert runner.store.changes == before + 1
        assert len(runner.store.events()) == 300
