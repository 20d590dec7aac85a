"""A reading that is none loses no other: it is named in the answer, in the log and on the page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import NOON, Live, readings
from tests.support.page_words import NODE, said_by

HUGE = 10**400  # more than a float holds
NO_NUMBERS = {
    "text": "unknown",
    "a number as text": "0.5",
    "NaN": math.nan,
    "true": True,
    "a list": [0.5],
    "an object": {"value": 0.5},
}
NO_SERIES: dict[str, tuple[Any, str]] = {
    "quantity": ({"quantity": "mood"}, "quantity of shop"),
    "time": ({"start": "noon"}, "start of shop"),
    "duration": ({"resolution": "an hour"}, "resolution of shop"),
    "field": ({"colour": "red"}, "colour of shop"),
    "values": ({"values": []}, "values of shop"),
    "asset": ({"asset": 5}, "series.1.asset"),
    "another asset": ({"asset": "nobody"}, "asset"),
    "future": ({"start": "2027-11-21T12:00:00Z"}, "time of shop"),
    "range": ({"values": [-1.0]}, "load_kw of shop"),
    "400 digits": ({"values": [HUGE]}, "load_kw of shop"),
}


def beside(odd: Any) -> dict[str, Any]:
    """A batch of three good series and an odd one, the second."""
    good = readings(NOON, "soc", {"big": 0.5, "small": 0.6})
    return {"series": [good[0], odd, good[1], *readings(NOON, "grid_on", {"grid": 1.0})]}


def load(value: Any) -> dict[str, Any]:
    """The shop's demand."""
    found: dict[str, Any] = readings(NOON, "load_kw", {"shop": value})[0]
    return found


def on_the_page(http: Any) -> list[str]:
    """What of the source was refused."""
    (source,) = http.get("/v1/overview").json()["sources"]
    assert source["source"] == "scada"
    found: list[str] = source["refused"]
    return found


@pytest.mark.parametrize("name", NO_NUMBERS)
def test_a_value_that_is_no_number_loses_no_other(
    name: str, live: Live, caplog: pytest.LogCaptureFixture
) -> None:
    http, _ = live
    sent = beside(load(NO_NUMBERS[name]))
    answer = http.post("/v1/telemetry", sent)
    assert answer.status == 200 and answer.json()["accepted"] == 3
    (refused,) = answer.json()["refused"]
    assert (refused["field"], refused["message"]) == ("load_kw of shop", "is not a number")
    assert "load_kw of shop" in caplog.text
    (words,) = on_the_page(http)
    assert words.startswith("load_kw of shop = ") and words.endswith(": is not a number")
    # It is logged when it begins, and stands until there is a number.
    http.post("/v1/telemetry", sent)
    assert caplog.text.count("load_kw of shop") == 1
    plan = http.post("/v1/steps").json()
    assert plan["status"] == "ok" and not any("is out" in one for one in plan["estimated"])
    http.post("/v1/telemetry", beside(load(7.0)))
    assert on_the_page(http) == []


def test_the_values_beside_it_in_a_series_are_kept(live: Live) -> None:
    http, clock = live
    minutes = {**load(None), "start": "2026-11-21T11:57:00Z", "resolution": "PT1M"}
    answer = http.post("/v1/telemetry", {"series": [{**minutes, "values": [5.0, "6.0", None, 8]}]})
    assert answer.json()["accepted"] == 3
    assert [one["field"] for one in answer.json()["refused"]] == ["load_kw of shop"]
    assert http.get("/v1/overview").json()["sources"][0]["ok"] == 1
    clock.set(NOON + pd.Timedelta("61min"))
    assert on_the_page(http)
    clock.set(NOON + pd.Timedelta("181min"))
    assert on_the_page(http) == []


@pytest.mark.parametrize("name", NO_SERIES)
def test_a_series_that_cannot_be_read_loses_no_other(name: str, live: Live) -> None:
    http, _ = live
    odd, field = NO_SERIES[name]
    answer = http.post("/v1/telemetry", beside({**load(7.0), **odd}))
    assert answer.status == 200 and answer.json()["accepted"] == 3
    (refused,) = answer.json()["refused"]
    assert refused["field"] == field and refused["message"] and refused["cure"]
    (words,) = on_the_page(http)
    assert words.startswith(field) and refused["message"] in words


def test_what_is_no_series_at_all_is_named_by_its_place_and_sender(live: Live) -> None:
    http, _ = live
    answer = http.post("/v1/telemetry", beside(5))
    assert [one["field"] for one in answer.json()["refused"]] == ["series.1"]
    names = {one["source"]: one["refused"] for one in http.get("/v1/overview").json()["sources"]}
    assert names["scada"] == [] and len(names) == 2
    assert any("series.1" in words for each in names.values() for words in each)


def test_a_batch_of_nothing_else_is_refused_and_on_the_page(live: Live) -> None:
    http, _ = live
    answer = http.post("/v1/telemetry", {"series": [load("unavailable")]})
    assert answer.status == 422
    assert answer.json()["problems"][0]["field"] == "load_kw of shop"
    assert on_the_page(http) == ["load_kw of shop = unavailable: is not a number"]


@pytest.mark.skipif(NODE is None, reason="no node on the path")
def test_the_page_says_what_is_late_and_what_was_rejected(live: Live, tmp_path: Path) -> None:
    http, clock = live
    http.post("/v1/telemetry", beside(load("unavailable")))
    script = """
import { sourceState } from "./words.mjs";
import { readFileSync } from "node:fs";
console.log(JSON.stringify(JSON.parse(readFileSync(0)).sources.map(sourceState)));
"""

    def said() -> Any:
        return said_by(script, tmp_path, json.dumps(http.get("/v1/overview").json()))

    rejected = "\u25b2 1 rejected: load_kw of shop = unavailable: is not a number"
    assert said() == [["late", rejected]]
    clock.set(NOON + pd.Timedelta("2h"))
    assert said() == [
        ["late", f"\u25b2 3 late: soc of big, grid_on of grid, soc of small; {rejected}"]
    ]
