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
SEND, LIMIT = "POST openadr/events", "IMPORT_CAPACITY_LIMIT"
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


def event(
    *parts: dict[str, Any], start: str = "2026-11-21T12:00:00Z", **more: Any
) -> dict[str, Any]:
    """An event of intervals of an hour, unless they say otherwise."""
    return {"programID": "p", "intervalPeriod": period(start), "intervals": [*parts], **more}


def part(kind: str, *values: float, **own: str) -> dict[str, Any]:
    """An interval with one payload, and with a period if it has its own."""
    return {"payloads": [{"type": kind, "values": [*values]}], "intervalPeriod": own or None}


def unit(kind: str, units: str) -> dict[str, Any]:
    """The descriptor of a type."""
    return {"payloadDescriptors": [{"payloadType": kind, "units": units}]}


def fields(*expected: dict[str, Any]) -> Callable[[dict[str, Any]], bool]:
    """So many events, in the order of their names, with these fields."""
    return lambda found: (
        len(found) == len(expected)
        and all(
            one.items() <= found[name].items()
            for one, name in zip(
                expected, sorted(found, key=lambda name: int(name.split(".")[1])), strict=True
            )
        )
    )


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
            ({"intervals": [{"payloads": [{"type": "PRICE", "values": ["a"]}]}]}, "are not numbers"),
            ({"intervals": [{"payloads": [{"type": "PRICE", "values": [1e9]}]}]}, "price"),
            ({"intervals": [PAIR] * 1001}, "too many payloads"))
    ] + [("12:00", "GET events", None, 200, {"": {}})],
    "what is sent again replaces all that was said": [
        ("12:00", SEND, EVENT, 201, {}),
        ("12:00", SEND, {**EVENT, "id": "17.0"}, 201, {"events": lambda names: len(names) == 4}),
        ("12:00", SEND, {**EVENT, "intervals": EVENT["intervals"][:1]}, 201, {}),
        ("12:00", "GET events", None, 200, {"": named(*[*KNOWN][:2], *(f"17.0.{name[3:]}" for name in KNOWN))}),
    ],
    "durations are those of ISO 8601, and one has no end": [
        row for text, end in (("PT1.5H", "2026-11-21T13:30:00Z"), ("P1W", "2026-11-28T12:00:00Z"),
                              ("PT200M", "2026-11-21T15:20:00Z"), ("P9999Y", None))
        for row in (("12:00", SEND, event(part(LIMIT, 50.0, duration=text)), 201, {"ignored": []}),
                    ("12:00", "GET events", None, 200, {"": fields({"limit_kw": 50.0, "end": end})}))
    ] + [
        ("12:00", SEND, event(part(LIMIT, 50.0, duration=text)), 422, {"text": has("is no duration of up to a year")})
        for text in ("P1M", "P1Y", "PT0S", "-PT1H", "P367D", "1 day")
    ] + [("12:00", SEND, event(part(LIMIT, 9.0, duration="P9999Y"), part(LIMIT, 8.0)), 422, {"text": has("is missing")})],
    "the beginning of time is now, or the end of the interval before": [
        ("12:20", SEND, event(part(LIMIT, 9.0, duration="PT1H"), part(LIMIT, 8.0, start="0001-01-01T00:00:00"),
                              start="0001-01-01"), 201, {}),
        ("12:20", "GET events", None, 200, {"": fields(
            {"start": "2026-11-21T12:20:00Z", "end": "2026-11-21T13:20:00Z"}, {"start": "2026-11-21T13:20:00Z"})}),
        ("12:30", SEND, event(part(LIMIT, 9.0, start="0001-01-01T00:00:00Z")), 201, {}),
        ("12:30", "GET events", None, 200, {"": fields({"start": "2026-11-21T12:00:00Z"})}),
    ],
    "several prices share an interval, and a price has a unit": [
        ("12:00", SEND, event(part("PRICE", 0.1, 0.2, 0.6, duration="PT3H")), 201, {}),
        ("12:00", "GET events", None, 200, {"": fields(
            {"resolution": "PT3600S", "price_gbp_per_kwh": [0.1, 0.2, 0.6]})}),
        ("12:00", SEND, event(part("PRICE", 300.0), **unit("PRICE", "MWH")), 201, {}),
        ("12:00", "GET events", None, 200, {"": fields({"price_gbp_per_kwh": [0.3]})}),
        ("12:00", SEND, event(part("PRICE", 1.0), **unit("PRICE", "THERMS")), 422, {"text": has("of PRICE is none that is known")}),
        ("12:00", SEND, event(part(LIMIT, 1.0, 2.0)), 422, {"text": has("are not one number")}),
    ],
    "prices of half hours are those of their hour": [
        ("12:00", SEND, event(part("PRICE", 0.1, duration="PT30M"), part("PRICE", 0.5, duration="PT30M")), 201, {}),
        ("12:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.3)}),
    ],
    "the duration of an event cuts its intervals": [
        ("12:00", SEND, event(part(LIMIT, 9.0), part(LIMIT, 8.0), part(LIMIT, 7.0), duration="PT90M"), 201, {"ignored": []}),
        ("12:00", "GET events", None, 200, {"": fields(
            {"end": "2026-11-21T13:00:00Z"}, {"start": "2026-11-21T13:00:00Z", "end": "2026-11-21T13:30:00Z"})}),
    ],
    "or repeats them, those that are over left out": [
        # Every two hours since the first of the month.
        ("12:00", SEND, event(part("PRICE", 0.1), part("PRICE", 0.4), start="2026-11-01T00:00:00Z", duration=lasts), 201,
            {"ignored": ignored, "events": lambda names, many=many: len(names) == many})
        for lasts, ignored, many in (("P20DT17H", [], 5), ("P9999Y", ["duration"], 2000))
    ] + [
        # None is OpenADR's default.
        ("12:00", SEND, event(part(LIMIT, 9.0), duration="PT0S", programID="q"), 201, {"events": named("q.0." + LIMIT)}),
        ("12:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.1)}),
        ("13:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.4)}),
        ("14:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.1)}),
    ],
    "a priority is named, and every alert is one": [
        ("12:00", SEND, event(part("ALERT_WIND", duration="P9999Y"), priority=3), 201, {"ignored": ["priority"]}),
        ("12:00", "GET events", None, 200, {"": fields({"type": "alert", "end": None, "text": "ALERT_WIND"})}),
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
