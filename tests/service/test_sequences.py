"""Sequences of requests: clock, request, body, status, parts of the answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import NOON, heard, readings, running
from tests.support.sequences import Player, Row, above, below, has, one, some_not
from vppres.live.ranges import RANGES
from vppres.scenario.scenario import Scenario

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
AT_NOON = {**FORECAST, "start": f"{DAY}12:00:00Z"}
MOST_KW = RANGES["load_kw"].highest
MANUAL: dict[str, Any] = {"mode": "manual", "until": f"{DAY}13:30:00Z"}
BIG = {"kind": "batteries", "asset": "big"}
SHOP = {"kind": "customers", "asset": "shop"}
PAST: dict[str, dict[str, Any]] = {
    "storm": {"type": "outage", "start": f"{DAY}09:00:00Z", "end": f"{DAY}12:13:00Z"},
    "cable": {"type": "import_limit", "start": f"{DAY}09:00Z", "end": f"{DAY}10:00Z", "limit_kw": 5.0},
    "tariff": {"type": "price", "start": f"{DAY}09:00:00Z", "resolution": "PT1H", "price_gbp_per_kwh": [0.1, 0.2]},
}  # fmt: skip
OVER = {"problems.0.message": "lies wholly in the past"}
LOST, BACK = ({"grid_on": {"grid": on}} for on in (0.0, 1.0))
DARK = {"type": "outage", "start": f"{DAY}12:00:00Z"}
NO_PV = {"pv_kw": {"roof": 0.0, "field": 0.0}}
OFF = "hospital of the first tier off supply"
LATE = f"{OFF}, and the state of charge of big, small is late."
WHY_LOST = "grid lost at 2026-11-21T12:13:00Z (scada)"
OUT = has("battery big is out")
ALONE = ("grid_on = 0 of scada at 2026-11-21T12:13:00Z stands alone: send grid_on again within 10 s, and "
         "import_kw since then")  # fmt: skip
HELD = {"mode": "hold", "until": f"{DAY}18:00:00Z"}
NO_PLAN = "There is no plan for the present step:"
NOT_KNOWN = "devices keep their last state, and how long the island lasts is not known."
BY_SCADA = "The grid is lost, by scada. No outage is announced for now."
FLOW = {**readings(NOON, "import_kw", {"grid": 80.0})[0], "resolution": "PT30S"}
DECIDED: list[Row] = [("12:00", "decide", 0.85, 200, {})]
MIXED = {"series": heard(NOON)["series"] + readings(NOON, "soc", {"bigg": 0.5, "small": 1.5})}


SHORT: dict[str, Any] = {"type": "outage", "start": f"{DAY}12:05:00Z", "end": f"{DAY}12:20:00Z"}
CERTAIN = {
    "type": "outage_belief",
    "probability": 1.0,
    "onset": {"start": f"{DAY}12:00:00Z", "resolution": "PT10M", "probabilities": [1.0]},
    "duration": {"family": "until", "until": SHORT["end"]},
}


def IGNORED(words: list[str]) -> bool:
    """Of the grid it is said why its reading is not believed, and no more."""
    told = [each for each in words if "grid_on" in each]
    return told == ["grid_on = 0 of scada is contradicted by an import of 80 kW"]


def IN(words: list[str]) -> bool:
    """The large battery is planned with."""
    return "battery big is out" not in words


def begins(words: list[str], how: str) -> bool:
    """Whether any of some words begins so."""
    return any(each.startswith(how) for each in words)


def spoken(time: str, soc: float, lasts: str = "PT1H") -> dict[str, Any]:
    """Telemetry of both batteries at a time."""
    now = pd.Timestamp(f"{DAY}{time}Z")
    return {"series": readings(now, "soc", {"big": soc, "small": soc}, lasts)}


def stale(*what: str) -> Callable[[list[dict[str, str]]], bool]:
    """These readings are late, and no others."""
    return lambda late: (
        {f"{one['asset']} {one['quantity']}": one["state"] for one in late}
        == (dict.fromkeys(what, "stale"))
    )


def read_grid(time: str, reading: dict[str, Any], alarms: dict[str, Any]) -> list[Row]:
    """A reading of the grid, the step decided anew, and the alarms."""
    return [
        (time, "hear", reading, 200, {}),
        (time, "anew", None, 200, {}),
        (time, "look", None, 200, alarms),
    ]


def substation(*told: tuple[str, str, float]) -> dict[str, Any]:
    """Readings of ten seconds: when, of what, and what."""
    return {"series": [
        {**one, "resolution": "PT10S"}
        for time, quantity, value in told
        for one in readings(pd.Timestamp(f"{DAY}{time}Z"), quantity, {"grid": value})]}  # fmt: skip


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
        ("12:00", "PUT forecasts/load_kw", {**FORECAST, "assets": {"shp": QUANTILES}}, 422,
            {"problems.*.cure": ["Did you mean shop?"]}),
    ],
    "an announced outage begins within a step for which the grid was read": [
        ("12:00", "PUT events/storm", {"type": "outage", "start": f"{DAY}12:20:00Z", "end": f"{DAY}14:00:00Z"}, 201, {}),
        ("12:00", "hear", BACK, 200, {}),
        ("12:00", "decide", 0.5, 200, {"grid.available": True}),
        ("12:21", "PUT clock", {"now": f"{DAY}12:21:00Z"}, 200, {}),
        ("12:21", "anew", None, 200, {"anew": "event storm began", "grid.available": False, "grid.known_by": "event"}),
        ("12:22", "PUT clock", {"now": f"{DAY}12:22:00Z"}, 200, {}),
        ("12:22", "anew", None, 204, {}),
    ],
    "prices of any resolution are those of the steps that they touch": [
        # From 12:15 on: 45 min of the first step, a quarter of it dear.
        ("12:00", "PUT events/quarters", {**CHEAP, "start": f"{DAY}12:15:00Z", "resolution": "PT15M",
            "price_gbp_per_kwh": [0.1, 0.2, 0.6, 0.3]}, 201, {}),
        ("12:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.3)}),
        ("13:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.3)}),
        ("14:00", "PUT events/hours", {**CHEAP, "start": f"{DAY}13:00:00Z", "resolution": "PT2H",
            "price_gbp_per_kwh": [0.7, 0.8]}, 201, {}),
        ("14:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": 0.7}),
        ("15:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": 0.8}),
        # The one that was written last, wherever it says anything: a month in one value, then 20 min.
        ("16:00", "PUT events/quarters", {**CHEAP, "start": f"{DAY}12:00:00Z", "resolution": "PT720H",
            "price_gbp_per_kwh": [0.2]}, 200, {}),
        ("16:00", "PUT events/hours", {**CHEAP, "start": f"{DAY}16:30:00Z", "resolution": "PT20M",
            "price_gbp_per_kwh": [0.8]}, 200, {}),
        ("16:00", "decide", 0.2, 200, {"expected.price_gbp_per_kwh": pytest.approx(0.4)}),
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
        ("12:13", "hear", LOST, 200, {}),
        ("13:00", "decide", 0.5, 200, {"grid.available": False}),  # its reading holds for an hour
        ("14:00", "decide", 0.5, 200, {"grid.available": True}),
    ],
    "health and metrics say whether there is a plan": [
        ("12:00", "GET /livez", None, 200, {}),
        ("12:00", "GET plan", None, 200, {"status": "none", "reason": "The first step is being decided."}),
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
    # Alarms.
    "a calm service has no alarm": [row for hour in range(3) for row in (
        (f"{12 + hour}:00", "decide", 0.5, 200, {}),
        (f"{12 + hour}:59", "look", None, 200, {"alarms": []}))],
    "a step that is not decided is an alarm": [
        ("12:00", "decide", 0.5, 200, {}),
        ("12:00", "hear", LOST, 200, {}),
        ("12:00", "look", None, 200, {
            "alarms.*.kind": ["grid_lost"], "alarms.*.priority": ["high"], "alarms.*.state": ["raised"]}),
        # It should have been decided anew by now.
        ("12:02", "look", None, 200, {"alarms.0.text": lambda text: text.startswith("The plan does not know yet: grid lost at")}),
        ("12:02", "anew", None, 200, {}),
        ("12:02", "GET alarms", None, 200, {"alarms": one(kind="no_decision", priority="high", state="cleared")}),
        ("13:03", "look", None, 200, {}),
        ("13:04", "look", None, 200, {
            "alarms": one(kind="no_decision", text=f"{NO_PLAN} set-points hold until 13:06, then {NOT_KNOWN}")}),
        ("13:09", "look", None, 200, {
            "alarms": one(kind="no_decision", priority="high", state="raised", text=f"{NO_PLAN} {NOT_KNOWN}")}),
        ("13:09", "GET /metrics", None, 200, {"text": has('vppres_alarms{kind="no_decision"} 1.0')}),
    ],
    "an island with little left is an alarm": [
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "decide", 0.2, 200, {}),
        ("12:02", "look", None, 200, {
            "alarms": one(kind="island_margin", priority="medium", state="raised")}),
    ],
    "what is left of an island is estimated if the reading is late": [
        # Full when it was read last, and nearly empty by the set-points since.
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "decide", 0.34, 200, {"expected.soc": lambda soc: 0.15 < max(soc.values()) < 0.22}),
        ("12:59", "look", None, 200, {"alarms.*.kind": lambda kinds: "island_margin" not in kinds}),
        ("13:00", "look", None, 200, {
            "alarms": one(kind="island_margin", priority="medium", state="raised")}),
    ],
    "readings are not late before they can have come": [
        # At the end of a step that was decided on fresh readings, and after one without any.
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "decide", 0.151, 200, {}),
        ("13:00", "look", None, 200, {"alarms.critical_off.text": f"{OFF}."}),
        ("13:00", "hear", NO_PV, 200, {}),
        ("13:00", "POST steps", None, 200, {}),
        ("13:00", "GET alarms", None, 200, {"alarms.critical_off.text": LATE}),
    ],
    "an alarm whose condition is gone says so": [
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "decide", 0.151, 200, {}),
        ("12:00", "GET alarms", None, 200, {"alarms.critical_off.gone_since": None}),
        ("12:05", "DELETE events/storm", None, 200, {}),
        ("12:05", "anew", None, 200, {}),
        ("12:05", "GET alarms", None, 200, {"alarms.critical_off.gone_since": f"{DAY}12:05:00Z"}),
        ("12:10", "look", None, 200, {"alarms.critical_off.gone_since": f"{DAY}12:05:00Z"}),
    ],
    "a contradiction ends with the reading, although the plan that ignored it still holds": [
        ("12:01", "POST telemetry", {"series": [*readings(NOON, "grid_on", {"grid": 0.0}), FLOW]}, 200, {}),
        ("12:01", "POST steps", None, 200, {}),
        ("12:01", "GET alarms", None, 200, {
            "alarms": one(kind="grid_contradicted", priority="high", state="raised")}),
        ("12:02", "look", None, 200, {}),
        ("12:02", "hear", BACK, 200, {}),
        ("12:03", "look", None, 200, {}),
        ("12:08", "look", None, 200, {
            "alarms": one(kind="grid_contradicted", priority="high", state="cleared")}),
    ],
    "a grid that is lost is an alarm until it is back": [
        ("12:00", "decide", 0.85, 200, {}),
        *read_grid("12:10", LOST, {"alarms.grid_lost.text": BY_SCADA, "alarms": one(kind="grid_lost", priority="high", state="raised")}),
        ("12:10", "PUT mode", {"mode": "off"}, 200, {}),
        *read_grid("12:12", LOST, {"alarms.grid_lost.text": BY_SCADA}),  # no plan says if there is grid
        ("12:12", "PUT mode", {"mode": "auto"}, 200, {}),
        ("12:12", "PUT events/storm", {**DARK, "end": None}, 201, {}),
        *read_grid("12:14", LOST, {"alarms.grid_lost.text": "The grid is lost, by scada, as announced.",
            "alarms": one(kind="grid_lost", priority="medium", state="raised")}),
        *read_grid("12:20", BACK, {"alarms": lambda alarms: all(
            one["cleared_at"] or one["gone_since"] for one in alarms if one["kind"] == "grid_lost")}),
    ],
    "sources that are silent are an alarm": [
        ("12:00", "look", None, 200, {}),
        ("12:06", "look", None, 200, {"alarms": one(text="No source has sent a reading.")}),
        ("13:00", "decide", 0.5, 200, {}),
        *((f"{hour}:00", "look", None, 200, {}) for hour in range(14, 18)),
        ("18:00", "look", None, 200, {"alarms.scada.text": "No data from scada: soc of big, soc of small."}),
    ],
    "devices that reject are an alarm": [
        ("12:00", "decide", 0.5, 200, {}),
        *(("12:01", f"POST setpoints/{{{name}}}/status", {"status": "rejected", "reason": "fuse"}, 200, {})
            for name in ("big", "hospital")),
        ("12:01", "look", None, 200, {
            "alarms": lambda alarms: {one["subject"] for one in alarms} == {"big", "hospital"},
            "alarms.big.priority": "medium",
            "alarms.big.text": "big did not follow its set-point: its device rejected it.",
            "alarms.hospital.priority": "high",
            "alarms.hospital.text": "hospital did not follow its set-point: rejected: fuse."}),
        ("12:02", "hear", {"soc": {"big": 0.5}}, 200, {}),
        ("12:02", "look", None, 200, {"alarms.hospital.state": "raised", "alarms.big.state": "cleared"}),
    ],
    # Between two steps.
    "events, modes and refusals are planned for at once": [
        *DECIDED,
        ("12:13", "PUT events/storm", {"type": "outage", "start": f"{DAY}12:10:00Z"}, 201, {}),
        ("12:14", "anew", None, 200, {"anew": "event storm", "grid.available": False}),
        ("12:14", "POST setpoints/{big}/status", {"status": "rejected"}, 200, {}),
        ("12:15", "anew", None, 200, {"anew": "big rejected", "estimated": OUT}),
        ("12:15", "PUT mode", {"mode": "off", "reason": "work"}, 200, {}),
        ("12:16", "anew", None, 200, {"status": "off"}),
        ("12:16", "PUT mode", {"mode": "auto"}, 200, {}),
        ("12:16", "DELETE events/storm", None, 200, {}),
        ("12:17", "anew", None, 200, {"anew": "mode auto; event storm withdrawn", "setpoints.*.served": all}),
        ("12:17", "GET status", None, 200, {"steps.ok": 1}),
        ("12:17", "PUT events/note", {"type": "alert", "start": f"{DAY}12:10:00Z", "text": "!"}, 201, {}),
        ("12:17", "anew", None, 204, {}),
    ],
    "a device that is back is planned for at once": [
        *DECIDED,
        ("12:13", "PUT events/storm", {"type": "outage", "start": f"{DAY}12:10:00Z"}, 201, {}),
        ("12:14", "anew", None, 200, {"anew": "event storm"}),
        ("12:14", "POST setpoints/{big}/status", {"status": "rejected"}, 200, {}),
        ("12:15", "anew", None, 200, {"anew": "big rejected", "estimated": OUT}),
        ("12:15", "POST setpoints/{old_big}/status", {"status": "accepted"}, 200, {}),
        ("12:16", "anew", None, 200, {"anew": "big accepted", "estimated": IN}),
        ("12:16", "POST setpoints/{big}/status", {"status": "aborted"}, 200, {}),
        ("12:17", "anew", None, 200, {"anew": "big aborted", "estimated": OUT}),
        ("12:17", "hear", {"soc": {"big": 0.8}}, 200, {}),
        ("12:18", "anew", None, 200, {"anew": "battery big is heard", "estimated": IN}),
        ("12:18", "hear", {"soc": {"big": 0.8}}, 200, {}),
        ("12:18", "anew", None, 204, {}),
        ("12:18", "hear", {"online": {"big": 0.0}}, 200, {}),
        ("12:19", "anew", None, 200, {"anew": "big online = 0 (scada)", "estimated": OUT}),
        ("12:19", "hear", {"online": {"big": 0.0}}, 200, {}),
        ("12:19", "anew", None, 204, {}),
        ("12:19", "hear", {"online": {"big": 1.0}}, 200, {}),
        ("12:20", "anew", None, 200, {"anew": "battery big is heard; big online = 1 (scada)", "estimated": IN}),
        ("12:20", "hear", {"online": {"hospital": 0.0}}, 200, {}),
        ("12:21", "anew", None, 200, {"anew": "hospital online = 0 (scada)", "setpoints.hospital.served": False}),
        ("12:21", "hear", {"online": {"hospital": 1.0}}, 200, {}),
        ("12:22", "anew", None, 200, {
            "anew": "customer hospital is heard; hospital online = 1 (scada)", "setpoints.hospital.served": True}),
    ],
    "a lost grid that stands alone is planned for and asked again": [
        *DECIDED,
        ("12:13", "POST telemetry", substation(("12:13", "grid_on", 0.0)), 200, {"asked_again": [ALONE]}),
        ("12:13", "anew", None, 200, {"grid.available": False}),
        ("12:13", "GET plan", None, 200, {"asked_again": [ALONE], "grid.available": False}),
        ("12:13:10", "POST telemetry", substation(("12:13", "import_kw", 0.0), ("12:13:10", "grid_on", 0.0)), 200,
            {"": lambda answer: "asked_again" not in answer}),
        ("12:13:10", "anew", None, 204, {}),
        ("12:13:10", "GET plan", None, 200, {"grid.available": False}),
    ],
    "a lost grid that another source has seen is not asked again": [
        *DECIDED,
        ("12:13", "POST telemetry", {"series": [
            *substation(("12:13", "grid_on", 0.0))["series"],
            {**substation(("12:13", "grid_on", 0.0))["series"][0], "source": "watch"}]}, 200,
            {"": {"accepted": 2, "duplicates": 0, "refused": []}}),
    ],
    **{f"an outage that ended within the step is over for the rest of it: {storm['type']}": [
        *DECIDED,
        ("12:13", "PUT events/storm", storm, 201, {}),
        ("12:13", "anew", None, 200, {"grid.available": False}),
        ("12:33", "PUT mode", {"mode": "off", "reason": "work"}, 200, {}),
        ("12:33", "PUT mode", {"mode": "auto"}, 200, {}),
        ("12:33", "anew", None, 200, {"grid.available": True}),
    ] for storm in (SHORT, CERTAIN)},
    "a first reading is planned for when it comes": [
        ("12:00", "POST steps", None, 200, {"estimated": OUT}),
        ("12:00:20", "POST telemetry", spoken("12:00", 0.6), 200, {}),
        ("12:00:20", "anew", None, 200, {
            "anew": "battery big is heard; battery small is heard",
            "estimated": lambda words: not any("is out" in each for each in words)}),
    ],
    **{f"an import since the grid was said to be lost takes it back: {how}": [
        *DECIDED,
        ("12:13", "POST telemetry", substation(("12:13", "grid_on", 0.0)), 200, {}),
        ("12:13", "anew", None, 200, {"grid.available": False}),
        *(row for poll, status in ((1, 200), (2, 204)) for row in (
            (f"12:13:{poll}0", "POST telemetry", substation((f"12:13:{poll - 1}0", "import_kw", 80.0),
                *[(f"12:13:{poll}0", "grid_on", 0.0)] * (how == "stuck")), 200, {}),
            (f"12:13:{poll}0", "anew", None, status, {}),
            (f"12:13:{poll}0", "GET plan", None, 200, {"grid.available": True, "estimated": IGNORED}))),
        # And the grid is lost in truth.
        ("12:13:30", "POST telemetry", substation(("12:13:20", "import_kw", 0.0), ("12:13:30", "grid_on", 0.0)), 200, {}),
        ("12:13:30", "anew", None, 200, {"grid.available": False}),
    ] for how in ("stuck", "said once")},
    # Readings.
    "a forecast has the range of a reading": [
        *(("12:00", "PUT forecasts/load_kw", {**AT_NOON, "assets": {"shop": {"p50": [kw]}}}, status, {})
            for kw, status in ((200.0, 200), (MOST_KW, 422), (2.0 * MOST_KW, 422))),
        ("12:00", "decide", 0.5, 200, {"status": ("ok", "fallback").__contains__}),
        ("12:00", "PUT forecasts/pv_kw", {**AT_NOON, "assets": {"roof": {"p50": [20.0], "p90": [2e4]}}}, 422, {
            "detail": "forecast, pv_kw of roof = 20000.0: is beyond the system's rating of 30 kW. Give the power in kW."}),
    ],
    "a reading before the first step holds the island": [  # the scenario begins with 0.15 in the big battery
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "POST telemetry", spoken("11:50", 0.62, "PT5M"), 200, {}),
        ("12:00", "POST steps", None, 200, {
            "setpoints.hospital.served": True, "late": stale("big soc", "small soc"),
            "setpoints.*.reason": lambda reasons: not any(why.startswith("default") for why in reasons)}),
    ],
    "a reading denies what the plan believed": [  # ten minutes before the next step, in an outage
        ("12:00", "decide", 0.84, 200, {"expected.soc.big": above(0.6)}),
        ("12:00", "PUT events/storm", AT_ONE, 201, {}),
        ("13:00", "POST telemetry", spoken("12:50", 0.25), 200, {}),
        ("13:00", "POST steps", None, 200, {
            "late": [], "setpoints.shop.served": False,
            # Of 160 kWh a tenth is above the lower limit of 0.15.
            "setpoints": lambda points: -sum(p["p_kw"] for p in points if p["kind"] == "batteries") <= 0.1 * 160.0}),
    ],
    "the gate checks what was decided on": [  # a reading that stands still while the battery moved is not believed
        ("12:00", "decide", 0.2, 200, {}),
        ("12:00", "PUT events/storm", AT_ONE, 201, {}),
        ("13:00", "POST telemetry", {"series": readings(NOON, "battery_kw", {"big": 50.0, "small": 30.0})}, 200, {}),
        ("13:00", "decide", 0.2, 200, {
            "estimated": has("(frozen)"),
            "setpoints": lambda points: min(p["p_kw"] for p in points if p["kind"] == "batteries") < -10.0,
            "setpoints.*.reason": lambda reasons: not any(why.startswith("default") for why in reasons)}),
    ],
    "a critical customer that is off on an old reading is an alarm": [
        ("12:00", "PUT events/storm", DARK, 201, {}),
        ("12:00", "POST telemetry", spoken("10:00", 0.16), 200, {}),
        ("12:00", "POST steps", None, 200, {"setpoints.hospital.served": False}),
        *(("12:00", f"GET {path}", None, 200, {"alarms.critical_off.text": LATE,
            "alarms": one(kind="critical_off", priority="high", state="raised")})
            for path in ("alarms", "overview", "status")),
        ("13:00", "decide", 0.16, 200, {"setpoints.hospital.served": False}),
        ("13:00", "GET alarms", None, 200, {"alarms.critical_off.text": f"{OFF}.",
            "alarms": one(kind="critical_off", priority="high", state="raised")}),
    ],
    "blind, late and lost are told apart": [  # of the small battery nobody has ever heard: it is left out
        ("12:00", "hear", {"soc": {"big": 0.5}, "load_kw": {"shop": None}}, 200, {}),
        ("12:00", "POST steps", None, 200, {
            "setpoints.small.p_kw": 0.0,
            "estimated": lambda words: "battery small is out" in words and begins(words, "load shop ")}),
        # A state of charge of an hour ago is none of now, nor is the demand.
        ("13:00", "POST steps", None, 200, {"late": stale("big soc", "shop load_kw")}),
        ("14:00", "POST steps", None, 200, {
            "late": stale("big soc", "shop load_kw"), "estimated": lambda words: begins(words, "soc big ")}),
        # What was ordered since goes on to count, as long as it says anything.
        ("16:00", "POST steps", None, 200, {
            "late": one(asset="big", quantity="soc", state="lost"), "estimated": IN}),
        ("16:00", "GET status", None, 200, {"sources": {"scada": f"{DAY}12:00:00Z"}}),
        ("17:00", "decide", 0.5, 200, {"late.0.asset": "shop"}),  # it comes back by itself
    ],
    "a battery that refuses is left out until it is heard": [
        ("12:00", "PUT events/storm", AT_ONE, 201, {}),
        ("12:00", "decide", 0.3, 200, {"setpoints.big.p_kw": above(10.0)}),
        *(("12:05", "POST setpoints/{big}/status", {"status": status, "reason": "locked"}, 200, {"id": has("big")})
            for status in ("accepted", "rejected")),
        ("12:05", "GET setpoints", None, 200, {"setpoints.big.status": "rejected", "setpoints.small.status": "new"}),
        # What it was to store it has not: its old reading still stands.
        ("13:00", "hear", {"soc": {"small": 0.3}}, 200, {}),
        ("13:00", "POST steps", None, 200, {
            "setpoints.big.p_kw": 0.0,
            "estimated": lambda words: "battery big is out" in words and "soc big 0.3000" in " ".join(words)}),
        ("14:00", "decide", 0.3, 200, {"estimated": IN}),
    ],
}  # fmt: skip


@pytest.mark.parametrize("rows", SEQUENCES.values(), ids=list(SEQUENCES))
def test_a_sequence_of_requests(rows: list[Row], tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as service:
        Player(service).play(rows)
