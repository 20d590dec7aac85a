"""OpenADR 3 events, as a VTN has them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import HERE, NOON, Live, client, decided, running, said, site
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.runner import Service

EVENT: dict[str, Any] = {
    "id": "17",
    "createdDateTime": "2026-11-21T08:00:00Z",
    "objectType": "EVENT",
    "programID": "resilience",
    "eventName": "storm",
    "priority": 0,
    "targets": [{"type": "GROUP", "values": ["feeder-12"]}],
    "payloadDescriptors": [
        {"objectType": "EVENT_PAYLOAD_DESCRIPTOR", "payloadType": "PRICE",
         "units": "KWH", "currency": "GBP"},
        {"payloadType": "IMPORT_CAPACITY_LIMIT", "units": "MW"},
    ],
    "intervalPeriod": {"start": "2026-11-21T12:00:00Z", "duration": "PT1H",
                       "randomizeStart": "PT0S"},
    "intervals": [
        {"id": 0, "payloads": [{"type": "PRICE", "values": [0.01]},
                               {"type": "IMPORT_CAPACITY_LIMIT", "values": [0.18]}]},
        {"id": 1, "payloads": [{"type": "PRICE", "values": [5.0]}, {"type": "GHG", "values": [9]},
                               {"type": "ALERT_POSSIBLE_OUTAGE", "values": ["storm"]}]},
    ],
}  # fmt: skip


def test_an_event_is_taken_as_it_stands(live: Live) -> None:
    http, clock = live
    answer = http.post("/v1/openadr/events", EVENT)
    assert (answer.status, answer.json()["ignored"]) == (201, ["GHG"])
    known = http.get("/v1/events").json()
    assert set(known) == set(answer.json()["events"])
    assert known["17.0.PRICE"]["price_gbp_per_kwh"] == [0.01]
    assert known["17.1.PRICE"]["start"] == "2026-11-21T13:00:00Z"
    assert known["17.0.IMPORT_CAPACITY_LIMIT"]["limit_kw"] == 180.0
    alert = known["17.1.ALERT_POSSIBLE_OUTAGE"]
    assert (alert["type"], alert["text"]) == ("alert", "ALERT_POSSIBLE_OUTAGE storm")
    plan = decided(http, clock, NOON, soc=0.2)
    # Cheap now and dear in an hour, with a limit: it charges as much as it may.
    assert plan["expected"]["import_kw"] == pytest.approx(180.0, abs=3.0)
    assert http.post("/v1/openadr/events", EVENT).status == 201
    assert http.get("/v1/events").json()["17.0.PRICE"]["version"] == 2
    clock.set(NOON + pd.Timedelta("3h"))
    late = http.post("/v1/openadr/events", {**EVENT, "id": "18"})
    assert (late.status, late.json()["problems"][0]["message"]) == (
        422,
        "lies wholly in the past",
    )


@pytest.mark.parametrize(
    ("drawn", "ignored"), [("PT10M", ["randomizeStart"]), ("PT0S", []), (None, [])]
)
def test_a_start_that_is_to_be_drawn_is_named(
    live: Live, drawn: str | None, ignored: list[str]
) -> None:
    http, _ = live
    period = {"start": "2026-11-21T12:00:00Z", "duration": "PT1H", "randomizeStart": drawn}
    price = {"payloads": [{"type": "PRICE", "values": [0.01]}]}
    for where in ({"intervalPeriod": period, "intervals": [price]},
                  {"intervals": [price | {"intervalPeriod": period}]}):  # fmt: skip
        answer = http.post("/v1/openadr/events", {"programID": "tariff", **where})
        assert (answer.status, answer.json()["ignored"]) == (201, ignored)
        assert http.get("/v1/events").json()["tariff.0.PRICE"]["start"] == period["start"]


def test_a_possible_outage_is_believed_where_beliefs_are_planned_with(
    tiny: Scenario, tmp_path: Path
) -> None:
    clock = SetClock(NOON)
    with client(Service(site(tiny), replace(HERE, outages="belief")), tmp_path, clock) as http:
        http.post("/v1/openadr/events", EVENT)
        plan = decided(http, clock, NOON, soc=0.2)
        assert plan["outage_probability"][0] == 0.0
        assert plan["outage_probability"][1] == pytest.approx(0.5, abs=0.001)
        assert sum(one["p_kw"] for one in said(plan, "batteries").values()) > 20.0


def test_what_is_none_is_refused_by_name(live: Live) -> None:
    http, _ = live
    for change, words in (
        ({"intervalPeriod": {"start": "2026-11-21T12:00:00Z"}}, "intervalPeriod: is missing"),
        ({"intervalPeriod": {"start": "noon", "duration": "PT1H"}}, "is not a time"),
        ({"intervalPeriod": {"start": "2026-11-21T12:00:00Z", "duration": "1"}}, "no duration"),
        ({"payloadDescriptors": [{"payloadType": "PRICE", "currency": "EUR"}]}, "another than"),
        ({"intervals": [{"payloads": [{"type": "PRICE", "values": ["a"]}]}]}, "not one number"),
        ({"intervals": [{"payloads": [{"type": "PRICE", "values": [1e9]}]}]}, "price"),
        (
            {"intervalPeriod": {"start": "2026-11-21T12:10:00Z", "duration": "PT1H"}},
            "beginning",
        ),
    ):
        answer = http.post("/v1/openadr/events", {**EVENT, **change})
        assert answer.status == 422, (change, answer)
        assert words in answer.content.decode(), answer.json()
    assert http.get("/v1/events").json() == {}


def test_what_is_sent_again_replaces_all_that_was_said(live: Live) -> None:
    http, _ = live
    http.post("/v1/openadr/events", EVENT)
    http.post("/v1/openadr/events", {**EVENT, "id": "17.0"})
    before = set(http.get("/v1/events").json())
    again = {**EVENT, "intervals": EVENT["intervals"][:1]}
    assert http.post("/v1/openadr/events", again).status == 201
    gone = before - set(http.get("/v1/events").json())
    assert gone == {"17.1.PRICE", "17.1.ALERT_POSSIBLE_OUTAGE"}


def test_names_may_be_as_long_as_openadr_has_them(live: Live) -> None:
    http, _ = live
    for tail in "ab":
        name = 99 * "x" + tail
        assert http.post("/v1/openadr/events", {**EVENT, "id": name}).status == 201
    names = list(http.get("/v1/events").json())
    assert len(names) == 8 and max(map(len, names)) <= 100


def test_a_message_is_one_transaction(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = [{"payloads": [{"type": "ALERT_OTHER", "values": [i]}]} for i in range(300)]
    with running(tiny, tmp_path) as (http, _, runner):
        before = runner.store.changes
        assert http.post("/v1/openadr/events", {**EVENT, "intervals": many}).status == 201
        assert runner.store.changes == before + 1
        assert len(runner.store.events()) == 300


def test_more_than_can_be_kept_at_once_is_refused(tiny: Scenario, tmp_path: Path) -> None:
    kinds = ("ALERT_OTHER", "ALERT_BLACK_START")
    part = {"payloads": [{"type": kind, "values": []} for kind in kinds]}
    with client(Service(site(tiny), HERE), tmp_path, SetClock(NOON)) as http:
        answer = http.post("/v1/openadr/events", {**EVENT, "intervals": [part] * 1001})
        assert answer.status == 422 and "too many payloads" in answer.json()["detail"]
