"""OpenADR 3 events, as a VTN has them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.live_service import HERE, NOON, client, decided, running, said, site
from tests.support.sequences import Player, Row, has
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock
from vppres.service.operation.site import Service

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
SEND = "POST openadr/events"
PRICE = {"payloads": [{"type": "PRICE", "values": [0.01]}]}
PAIR = {"payloads": [{"type": kind, "values": []} for kind in ("ALERT_OTHER", "ALERT_BLACK_START")]}
KNOWN: dict[str, dict[str, Any]] = {
    "17.0.PRICE": {"price_gbp_per_kwh": [0.01], "version": 1},
    "17.0.IMPORT_CAPACITY_LIMIT": {"limit_kw": 180.0},
    "17.1.PRICE": {"start": "2026-11-21T13:00:00Z"},
    "17.1.ALERT_POSSIBLE_OUTAGE": {"type": "alert", "text": "ALERT_POSSIBLE_OUTAGE storm"},
}


def period(start: str, duration: str = "PT1H", drawn: str | None = None) -> dict[str, Any]:
    """When an interval is."""
    return {"start": start, "duration": duration, "randomizeStart": drawn}


def named(*names: str) -> Callable[[dict[str, Any]], bool]:
    """These events, and no others."""
    return lambda found: set(found) == set(names)


SEQUENCES: dict[str, list[Row]] = {
    "an event is taken as it stands": [
        ("12:00", SEND, EVENT, 201, {"ignored": ["GHG"], "events": named(*KNOWN)}),
        ("12:00", "GET events", None, 200, {"": lambda events: events.keys() == KNOWN.keys() and all(
            fields.items() <= events[name].items() for name, fields in KNOWN.items())}),
        # Cheap now and dear in an hour, with a limit: it charges as much as it may.
        ("12:00", "decide", 0.2, 200, {"expected.import_kw": pytest.approx(180.0, abs=3.0)}),
        ("12:00", SEND, EVENT, 201, {}),
        ("12:00", "GET events", None, 200, {"": lambda events: events["17.0.PRICE"]["version"] == 2}),
        ("15:00", SEND, {**EVENT, "id": "18"}, 422, {"problems.0.message": "lies wholly in the past"}),
    ],
    "a start that is to be drawn is named": [
        ("12:00", SEND, {"programID": "tariff", **where(period("2026-11-21T12:00:00Z", drawn=drawn))}, 201,
            {"ignored": ignored, "events": named("tariff.0.PRICE")})
        for drawn, ignored in (("PT10M", ["randomizeStart"]), ("PT0S", []), (None, []))
        for where in (lambda when: {"intervalPeriod": when, "intervals": [PRICE]},
                      lambda when: {"intervals": [PRICE | {"intervalPeriod": when}]})
    ] + [("12:00", "GET events", None, 200, {
        "": lambda events: events["tariff.0.PRICE"]["start"] == "2026-11-21T12:00:00Z"})],
    "what is none is refused by name": [
        ("12:00", SEND, {**EVENT, **change}, 422, {"text": has(words)})
        for change, words in (
            ({"intervalPeriod": {"start": "2026-11-21T12:00:00Z"}}, "intervalPeriod: is missing"),
            ({"intervalPeriod": period("noon")}, "is not a time"),
            ({"intervalPeriod": period("2026-11-21T12:00:00Z", "1")}, "no duration"),
            ({"payloadDescriptors": [{"payloadType": "PRICE", "currency": "EUR"}]}, "another than"),
            ({"intervals": [{"payloads": [{"type": "PRICE", "values": ["a"]}]}]}, "not one number"),
            ({"intervals": [{"payloads": [{"type": "PRICE", "values": [1e9]}]}]}, "price"),
            ({"intervals": [PAIR] * 1001}, "too many payloads"))
    ] + [("12:00", "GET events", None, 200, {"": {}})],
    "what is sent again replaces all that was said": [
        ("12:00", SEND, EVENT, 201, {}),
        ("12:00", SEND, {**EVENT, "id": "17.0"}, 201, {"events": lambda names: len(names) == 4}),
        ("12:00", SEND, {**EVENT, "intervals": EVENT["intervals"][:1]}, 201, {}),
        ("12:00", "GET events", None, 200, {"": named(*[*KNOWN][:2], *(f"17.0.{name[3:]}" for name in KNOWN))}),
    ],
    "names may be as long as OpenADR has them": [
        *(("12:00", SEND, {**EVENT, "id": 99 * "x" + tail}, 201, {}) for tail in "ab"),
        ("12:00", "GET events", None, 200, {"": lambda names: len(names) == 8 and max(map(len, names)) <= 100}),
    ],
}  # fmt: skip


@pytest.mark.parametrize("rows", SEQUENCES.values(), ids=list(SEQUENCES))
def test_a_sequence_of_messages(rows: list[Row], tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as service:
        Player(service).play(rows)


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


def test_a_message_is_one_transaction(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    many = [{"payloads": [{"type": "ALERT_OTHER", "values": [i]}]} for i in range(300)]
    with running(tiny, tmp_path) as (http, _, runner):
        before = runner.store.changes
        assert http.post("/v1/openadr/events", {**EVENT, "intervals": many}).status == 201
        assert runner.store.changes == before + 1
        assert len(runner.store.events()) == 300
