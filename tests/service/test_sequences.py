"""Sequences of requests: clock, request, body, status, parts of the answer."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import NOON, Live, heard, readings
from tests.support.sequences import Row, above, below, has, play, some_not

DAY = "2026-11-21T"
STORM = {"type": "outage", "start": f"{DAY}14:20:00+01:00"}
AT_ONE = {"type": "outage", "start": f"{DAY}13:00:00Z"}
CHEAP = {
    "type": "price",
    "start": f"{DAY}12:00:00Z",
    "resolution": "PT1H",
    "price_gbp_per_kwh": [0.01, 5.0, 5.0],
}
LIMIT = {"type": "import_limit", "start": f"{DAY}12:00:00Z", "limit_kw": 180.0}
QUANTILES = {"p10": [70.0, 80.0], "p50": [75.0, 90.0], "p90": [80.0, 100.0]}
FORECAST = {"issued_at": f"{DAY}11:00:00Z", "start": f"{DAY}13:00:00Z", "resolution": "PT1H"}
MANUAL: dict[str, Any] = {"mode": "manual", "until": f"{DAY}13:30:00Z"}
BIG = {"kind": "batteries", "asset": "big"}
SHOP = {"kind": "customers", "asset": "shop"}
PAST: dict[str, dict[str, Any]] = {
    "storm": {"type": "outage", "start": f"{DAY}09:00:00Z", "end": f"{DAY}12:13:00Z"},
    "cable": {"type": "import_limit", "start": f"{DAY}09:00Z", "end": f"{DAY}10:00Z", "limit_kw": 5.0},
    "tariff": {"type": "price", "start": f"{DAY}09:00:00Z", "resolution": "PT1H", "price_gbp_per_kwh": [0.1, 0.2]},
}  # fmt: skip
OVER = {"problems.0.message": "lies wholly in the past"}
HELD = {"mode": "hold", "until": f"{DAY}18:00:00Z"}
MIXED = {"series": heard(NOON)["series"] + readings(NOON, "soc", {"bigg": 0.5, "small": 1.5})}

SEQUENCES: dict[str, list[Row]] = {
    "an outage is an event that begins, may end and may be withdrawn": [
        ("12:00", "PUT events/storm", STORM, 201, {"headers.etag": '"1"'}),
        ("12:00", "GET events", None, 200, {"": {"storm": {
            "version": 1, "source": "operator", "end": None, "type": "outage", "start": f"{DAY}13:20:00Z"}}}),
        ("12:00", "decide", 0.2, 200, {"setpoints.big.p_kw": above(40.0)}),  # it begins in an hour
        ("13:00", "decide", 0.2, 200, {"setpoints.*.served": some_not, "expected.import_kw": below(5.0)}),
        ("13:00", 'PUT events/storm if-match="1"', {**STORM, "end": f"{DAY}14:00:00Z"}, 200, {"version": 2}),
        ("13:00", 'PUT events/storm if-match="1"', STORM, 412, {}),
        ("14:00", "decide", 0.2, 200, {"setpoints.*.served": all}),
        ("14:00", "DELETE events/storm", None, 200, {"": {"version": 3}}),
        ("14:00", "DELETE events/storm", None, 404, {}),
        ("14:00", "GET events", None, 200, {"": {}}),
    ],
    "limits, prices and forecasts reach the plan": [
        ("12:00", "PUT events/tariff", CHEAP, 201, {}),
        ("12:00", "PUT events/cable", LIMIT, 201, {}),
        ("12:00", "PUT forecasts/load_kw", {**FORECAST, "assets": {"shop": QUANTILES}}, 200, {}),
        ("12:00", "decide", 0.2, 200, {"expected.import_kw": pytest.approx(180.0, abs=3.0)}),
        ("12:00", "PUT forecasts/load_kw", {**FORECAST, "assets": {"shop": {**QUANTILES, "p90": [80.0, 1.0]}}}, 422,
            {"detail": has("cross")}),
        ("12:00", "PUT forecasts/load_kw", {**FORECAST, "assets": {"shp": QUANTILES}, "resolution": "PT30M"}, 422,
            {"problems.*.cure": ["Did you mean shop?", "Steps last 60 min."]}),
    ],
    "telemetry is kept once and refused by name": [
        ("12:00", "POST telemetry", heard(NOON), 200, {"": {"accepted": 2, "duplicates": 0, "refused": []}}),
        ("12:00", "POST telemetry", heard(NOON), 200, {"accepted": 0, "duplicates": 2}),
        ("12:00", "POST telemetry", MIXED, 200, {
            "refused.*.field": ["asset", "soc of small"],
            "refused.*.cure": ["Did you mean big?", "Give a share, for example 0.5."]}),
        ("12:00", "POST telemetry", heard(NOON + pd.Timedelta("1D")), 422,
            {"problems.0.message": "lies in the future"}),
    ],
    "off gives defaults until it is over": [
        ("12:00", "PUT mode", {"mode": "off", "until": f"{DAY}13:30:00Z", "reason": "work on the line"}, 200,
            {"mode": "off"}),
        ("12:00", "decide", 0.5, 200, {
            "status": "off", "solve": None, "setpoints.big.p_kw": 0.0, "setpoints.small.p_kw": 0.0,
            "setpoints.*.served": all, "setpoints.big.reason": "default: work on the line"}),
        ("13:00", "decide", 0.5, 200, {"status": "off"}),
        ("14:00", "decide", 0.5, 200, {"status": "ok"}),
    ],
    "what is held still passes the gate": [  # the battery that was charged is full by now
        ("12:00", "PUT events/storm", AT_ONE, 201, {}),
        ("12:00", "decide", 0.3, 200, {"setpoints.big.p_kw": above(20.0)}),
        ("12:00", "PUT mode", HELD, 200, {}),
        ("13:00", "decide", 0.84, 200, {
            "setpoints.big.p_kw": 0.0, "setpoints.big.reason": "default: energy above its upper limit"}),
    ],
    "an operator orders some and the others stay": [
        ("12:00", "decide", 0.5, 200, {"setpoints.homes.served": True}),
        ("12:00", "PUT mode", {**MANUAL, "setpoints": []}, 422, {}),
        ("12:00", "PUT mode", {**MANUAL, "setpoints": [{**SHOP, "p_kw": 5.0}]}, 422, {}),
        ("12:00", "PUT mode", {**MANUAL, "setpoints": [{**BIG, "p_kw": 1.0, "served": True}]}, 422, {}),
        ("12:00", "PUT mode", {**MANUAL, "setpoints": [{**BIG, "asset": "bigg", "p_kw": 1.0}]}, 422,
            {"problems.0.cure": "Did you mean big?"}),
        ("12:00", "PUT mode", {**MANUAL, "setpoints": [
            {**BIG, "p_kw": -12.5}, {**BIG, "asset": "small", "p_kw": 30.0}, {**SHOP, "served": False}]}, 200, {}),
        ("13:00", "decide", 0.5, 200, {
            "status": "manual", "setpoints.big.p_kw": -12.5, "setpoints.shop.served": False,
            "setpoints.small.reason": "default: energy above its upper limit", "setpoints.homes.served": True}),
        ("14:00", "decide", 0.5, 200, {"status": "ok"}),
    ],
    "set-points beyond a rating and unknown assets are refused": [
        ("12:00", "decide", 0.85, 200, {}),
        ("12:13", "PUT mode", {**MANUAL, "until": f"{DAY}14:00:00Z", "setpoints": [
            {**BIG, "p_kw": -51.0}, {**BIG, "asset": "small", "p_kw": 30.0, "q_kvar": 20.0},
            {"kind": "pv", "asset": "roof", "p_kw": 29.0}]}, 422, {
            "problems.*.field": ["p_kw of big", "kVA of small"],
            "problems.*.message": ["is beyond its rating of 50 kW", "is beyond its rating of 35 kVA"]}),
        ("12:13", "GET mode", None, 200, {"mode": "auto"}),
        ("12:13", "GET setpoints?asset=bigg", None, 404, {"detail": has("Did you mean big?")}),
        ("12:13", "GET explanations?asset=bigg", None, 404, {"detail": has("Did you mean big?")}),
    ],
    "what is wholly past is not announced, but an event that is known may be ended so": [
        ("12:00", "decide", 0.85, 200, {}),
        *(("12:13", f"PUT events/{name}", past, 422, OVER) for name, past in PAST.items()),
        ("12:13", "GET events", None, 200, {"": {}}),
        *(row for name, past in PAST.items() for row in (
            ("12:13", f"PUT events/{name}", {"type": "outage", "start": past["start"]}, 201, {}),
            ("12:13", f"PUT events/{name}", past, 200, {}))),
    ],
    "an announced end ends an outage of which no reading comes any more": [
        ("12:00", "decide", 0.85, 200, {}),
        ("12:13", "PUT events/storm", {"type": "outage", "start": f"{DAY}12:05:00Z", "end": f"{DAY}13:00:00Z"}, 201, {}),
        ("12:13", "POST telemetry", {"series": readings(NOON.replace(minute=13), "grid_on", {"grid": 0.0})}, 200, {}),
        ("13:00", "decide", 0.5, 200, {"grid.available": False}),  # its reading holds for an hour
        ("14:00", "decide", 0.5, 200, {"grid.available": True}),
    ],
    "health and metrics say whether there is a plan": [
        ("12:00", "GET /livez", None, 200, {}),
        ("12:00", "GET plan", None, 200, {"": {"status": "none"}}),
        ("12:00", "GET /readyz", None, 503, {"checks.plan": False}),
        ("12:00", "decide", 0.5, 200, {}),
        ("12:00", "GET /readyz", None, 200, {}),
        ("12:00", "GET plan", None, 200, {"status": "ok"}),
        ("12:00", "GET plan if-none-match={etag}", None, 304, {}),
        ("13:30", "GET plan if-none-match={etag}", None, 200, {"status": "stale"}),
        ("13:30", "GET /readyz", None, 503, {}),
        ("13:30", "GET /metrics", None, 200, {"text": lambda text: all(line in text for line in (
            'vppres_steps_total{outcome="ok"} 1.0', 'vppres_telemetry_age_seconds{source="scada"} 5400.0',
            "vppres_plan_ahead_seconds -1800.0", "vppres_step_duration_seconds_count 1.0"))}),
    ],
}  # fmt: skip


@pytest.mark.parametrize("rows", SEQUENCES.values(), ids=list(SEQUENCES))
def test_a_sequence_of_requests(rows: list[Row], live: Live) -> None:
    play(*live, rows)
