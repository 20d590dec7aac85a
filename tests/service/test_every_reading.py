"""A reading that no number holds, and late and odd ones on the page; more in ``sequences/odd_readings.txt``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import NOON, Live, readings
from tests.support.page_words import NODE, said_by

HUGE = 10**400  # more than a float holds


def beside(value: Any) -> dict[str, Any]:
    """A batch of three good series and one of the shop's demand, the second."""
    big, small = readings(NOON, "soc", {"big": 0.5, "small": 0.6})
    odd = readings(NOON, "load_kw", {"shop": value})
    return {"series": [big, *odd, small, *readings(NOON, "grid_on", {"grid": 1.0})]}


def test_a_number_of_400_digits_loses_no_other(live: Live) -> None:
    http, _ = live
    answer = http.post("/v1/telemetry", beside(HUGE)).json()
    assert answer["accepted"] == 3
    (refused,) = answer["refused"]
    assert refused["field"] == "load_kw of shop" and refused["message"] and refused["cure"]
    (source,) = http.get("/v1/overview").json()["sources"]
    (words,) = source["refused"]
    assert words.startswith("load_kw of shop") and refused["message"] in words


STATES = """
import { sourceState } from "./words.mjs";
import { readFileSync } from "node:fs";
console.log(JSON.stringify(JSON.parse(readFileSync(0)).sources.map(sourceState)));
"""


@pytest.mark.skipif(NODE is None, reason="no node on the path")
def test_the_page_says_what_is_late_and_what_was_rejected(live: Live, tmp_path: Path) -> None:
    http, clock = live
    http.post("/v1/telemetry", beside("unavailable"))

    def said() -> Any:
        return said_by(STATES, tmp_path, json.dumps(http.get("/v1/overview").json()))

    rejected = "\u25b2 1 rejected: load_kw of shop = unavailable: is not a number"
    assert said() == [["late", rejected]]
    clock.set(NOON + pd.Timedelta("2h"))
    assert said() == [
        ["late", f"\u25b2 3 late: soc of big, grid_on of grid, soc of small; {rejected}"]
    ]
