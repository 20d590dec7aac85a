"""Words of the page; its first lines are in ``sequences/page.txt``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.asgi import Caller
from tests.support.live_service import (
    HERE,
    NOON,
    Live,
    client,
    decided,
    readings,
    running,
    site,
)
from tests.support.page_words import NODE, first_lines, said_by
from vppres.scenario.scenario import Scenario
from vppres.service.clock import written
from vppres.service.operation.site import Service

pytestmark = pytest.mark.skipif(NODE is None, reason="no node on the path")


def told(http: Caller, folder: Path) -> dict[str, Any]:
    """What the page says now."""
    return first_lines(http.get("/v1/site").json(), http.get("/v1/overview").json(), folder)


FUEL = """
import { fuelLasts } from "./words.mjs";
const set = { litres_per_h_idle: 4, litres_per_kwh: 0.25 };
console.log(JSON.stringify([fuelLasts(set, 70, 40), fuelLasts(set, 7, 40), fuelLasts(set, 0, 12)]));
"""

CREW = """
import { SiteClock, announced, crewSays, facts } from "./words.mjs";
const view = { clock: new SiteClock("Europe/London"), now: new Date("2026-07-01T14:20:00Z") };
const said = %s.map((text) => crewSays(text, view));
const plan = { start: "2026-07-01T14:00:00Z", off: [] };
const overview = { plan, events: { crew: said[0] } };
const first = facts({ ...view, site: { customers: {} }, overview });
console.log(JSON.stringify({ said, first, words: said.map((body) => body && announced(body, view)) }));
"""


def test_what_a_crew_says_is_one_field(tmp_path: Path) -> None:
    """Times are those of the site's clocks, the next ones that come."""
    lines = [
        "not before 16:00, about 18:00",
        "Back within the hour",
        "within 30 min",
        "by 9:05",
        "soon",
        "about 25:00",
    ]
    done = said_by(CREW % json.dumps(lines), tmp_path)
    day = "2026-07-0{}:00.000Z"
    times = [
        {"not_before": day.format("1T15:00"), "likely": day.format("1T17:00")},
        {"by": day.format("1T15:20")},
        {"by": day.format("1T14:50")},
        {"by": day.format("2T08:05")},
    ]
    expected = [{"type": "restoration", "source": "operator", **each} for each in times]
    assert done["said"] == [*expected, None, None]
    assert done["words"][0] == "Restoration not before 16:00, about 18:00"
    assert "Announced: restoration not before 16:00, about 18:00 (crew)." in done["first"]


CREW_EVENT = """
import { SiteClock, crewEvent } from "./words.mjs";
import { readFileSync } from "node:fs";
const { view, said } = JSON.parse(readFileSync(0));
Object.assign(view, { clock: new SiteClock("UTC"), now: new Date(view.overview.now) });
let answer;
try { answer = crewEvent(said, view); } catch (error) { answer = error.message; }
console.log(JSON.stringify(answer));
"""


def test_what_a_crew_says_is_an_event_that_the_service_takes(live: Live, tmp_path: Path) -> None:
    """Where outages are taken for known it is the end of the one that is announced or measured."""
    http, clock = live

    def event(said: str) -> Any:
        parts = {name: http.get(f"/v1/{name}").json() for name in ("site", "overview")}
        given = json.dumps({"view": parts, "said": said})
        return said_by(CREW_EVENT, tmp_path, given)

    assert event("about 18:00") == "No outage is announced or measured."
    http.post("/v1/telemetry", {"series": readings(NOON, "grid_on", {"grid": 0.0})})
    clock.set(NOON + pd.Timedelta("1min"))
    name, body = event("not before 14:00, about 18:00")
    assert (name, body["start"], body["end"][:16]) == (
        "crew",
        written(NOON),
        "2026-11-21T18:00",
    )
    assert http.put(f"/v1/events/{name}", body).status == 201
    name, body = event("by 19:00")
    assert http.put(f"/v1/events/{name}", body).json()["end"] == "2026-11-21T19:00:00Z"
    assert event("not before 14:00").startswith("This service plans with a known end.")
    http.post("/v1/steps")
    assert told(http, tmp_path)["verdict"][1].startswith("Outage until 19:00")


def rehearsed(day: Scenario, dark: slice, folder: Path) -> dict[str, Any]:
    """What the page says in a rehearsal of a day with an outage."""
    limits_kw = day.grid_limit_kw.copy()
    limits_kw[dark] = 0.0
    service = Service(replace(day, grid_limit_kw=limits_kw), HERE, rehearsal=True)
    with client(service, folder / "state") as http:
        http.post("/v1/steps")
        return told(http, folder)


def test_an_outage_of_a_rehearsal_is_not_called_announced(tiny: Scenario, tmp_path: Path) -> None:
    """The service knows it from the scenario."""
    found = rehearsed(site(tiny), slice(1, 4), tmp_path)
    assert found["verdict"][2] == "Outage known from the scenario, from 01:00, in 60 min."
    assert "Announced: no outage." in found["facts"]


def test_an_outage_of_a_scenario_is_told_as_such(tiny: Scenario, tmp_path: Path) -> None:
    """Its end, and beside it what no event says."""
    found = rehearsed(site(tiny), slice(2), tmp_path)
    assert found["verdict"][1].startswith("Outage until 02:00 by the scenario")
    assert found["announced"] == "No event; the scenario has an outage until 02:00."


PHASES = """
import { onPhase } from "./words.mjs";
const site = { phases: { c1: "b", c2: "bc", c3: "a b", c4: "a b c" } };
console.log(JSON.stringify(["c1", "c2", "c3", "c4", "c5"].map((name) => onPhase(name, site).replace("\\u00a0", " "))));
"""


def test_a_device_that_is_not_on_all_phases_is_named_with_its_own(tmp_path: Path) -> None:
    named = ["c1 (phase b)", "c2 (phase bc)", "c3 (phase a and b)", "c4", "c5"]
    assert said_by(PHASES, tmp_path) == named


def test_fuel_lasts_by_the_line_of_the_set(tmp_path: Path) -> None:
    """14 l/h at 40 kW."""
    assert said_by(FUEL, tmp_path) == ["5 h at 40.0 kW", "30 min at 40.0 kW", "0 s at 12.0 kW"]


ALARMS = """
import { SiteClock, alarms } from "./words.mjs";
const view = { clock: new SiteClock("UTC"), now: new Date("2026-07-01T18:20:00Z") };
const off = { text: "c24 off.", priority: "high", state: "raised", raised_at: "2026-07-01T17:00:00Z", advice: "Bring one." };
const low = { ...off, text: "Low.", priority: "medium" };
const gone = { ...off, gone_since: "2026-07-01T18:00:00Z" };
view.overview = { alarms: [gone, low] };
console.log(JSON.stringify(alarms(view).map((one) => one.slice(0, 3))));
"""


def test_an_alarm_whose_condition_is_gone_is_told_as_over(tmp_path: Path) -> None:
    """Behind those that stand, and without advice."""
    assert said_by(ALARMS, tmp_path) == [
        ["warning", "Low.", "Raised 17:00. Bring one."],
        ["note", "Over since 18:00: c24 off.", "Raised 17:00."],
    ]


def test_a_higher_tier_that_waits_for_a_lower_one_is_on_the_page(
    tiny: Scenario, tmp_path: Path
) -> None:
    with running(tiny, tmp_path / "state") as (http, clock, runner):
        decided(http, clock, NOON, soc=0.85)
        assert runner.last
        runner.last["solve"]["inverted"] = "hospital is off supply, while homes have 50.0 kW"
        found = told(http, tmp_path)["attention"]
    words = "A lower tier is on while a higher one waits: hospital is off supply, while homes have 50.0 kW."
    assert ["warning", words] in found
