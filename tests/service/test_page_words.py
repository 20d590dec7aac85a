"""The page's first lines: what is measured, announced and ordered; supply is said where it is."""

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
    said,
    serving,
    site,
)
from tests.support.page_words import NODE, said_by
from vppres.scenario.remarks import former_words
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service

pytestmark = pytest.mark.skipif(NODE is None, reason="no node on the path")

SCRIPT = """
import { SiteClock, announced, announcesNothing, attention, facts, verdict, why } from "./words.mjs";
import { readFileSync } from "node:fs";
const view = JSON.parse(readFileSync(0));
view.clock = new SiteClock("UTC");
view.now = new Date(view.overview.now);
const { off, status } = view.overview.plan;
const reasons = (off ?? []).map((one) => why(one, null, status).words);
const events = Object.values(view.overview.events).map((event) => announced(event, view));
console.log(JSON.stringify({ verdict: verdict(view), facts: facts(view), attention: attention(view), announced: announcesNothing(view), reasons, events }));
"""


OFF = {"mode": "off", "reason": "work"}


def told(http: Caller, folder: Path) -> dict[str, Any]:
    """What the page says now."""
    site_of, overview = (http.get(f"/v1/{name}").json() for name in ("site", "overview"))
    view = json.dumps({"site": site_of, "overview": overview, "lost": False})
    found: dict[str, Any] = said_by(SCRIPT, folder, view)
    return found


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


def test_a_contradicted_loss_of_the_grid_comes_first(live: Live, tmp_path: Path) -> None:
    http, clock = live
    series = readings(NOON, "grid_on", {"grid": 0.0})
    flow = {**readings(NOON, "import_kw", {"grid": 80.0})[0], "resolution": "PT30S"}
    http.post("/v1/telemetry", {"series": [*series, flow]})
    decided(http, clock, NOON + pd.Timedelta("1min"))
    assert told(http, tmp_path)["verdict"] == [
        "alarm",
        "Readings contradict each other on whether there is grid: supply is uncertain.",
        "The plan ignores a reading: grid_on = 0 of scada is contradicted by an import of 80 kW.",
    ]


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


def test_nothing_that_can_form_the_grid_is_said_first(tiny: Scenario, tmp_path: Path) -> None:
    """With what could form it; also where nobody decided, and before a plan knows of it."""
    clock = SetClock(NOON)
    service = Service(site(tiny), replace(HERE, mode="physical"))
    with serving(service, tmp_path / "state", clock) as (http, runner):
        http.post("/v1/telemetry", {"series": readings(NOON, "grid_on", {"grid": 0.0})})
        lit = decided(http, clock, NOON, soc=0.8)
        clock.set(NOON + pd.Timedelta("1min"))
        for asset in ("big", "small"):
            point = said(lit, "batteries")[asset]["id"]
            http.post(f"/v1/setpoints/{point}/status", {"status": "rejected"})
        first = "Nothing can form the grid: all 3 customers are off supply."
        more = (
            "What could form it: big (its device rejected it); small (its device rejected it); "
            "a generator that a crew brings; the grid when it is back. Outage, end unknown."
        )
        dark = []
        for change in (None, runner.anew, lambda: http.put("/v1/mode", OFF)):
            if change is not None:
                change()
                clock.set(clock.now() + pd.Timedelta("1min"))
                runner.anew()
            found, overview = told(http, tmp_path), http.get("/v1/overview").json()
            assert found["verdict"] == ["alarm", first, more]
            assert set(found["reasons"]) == {"nothing can form the grid"}
            plan = overview["plan"]
            assert len(plan["off"]) == 3
            assert all(one["p_kw"] == 0.0 for one in plan["batteries"].values())
            dark.append(plan["expected"] and plan["expected"]["v_min_pu"])
        assert dark[1:] == [None, None]  # no voltage
        blacked_out = runner.store.step(NOON)["before"][-1]["id"]
        assert blacked_out != lit["id"]
        http.put("/v1/mode", {"mode": "auto"})
        clock.set(clock.now() + pd.Timedelta("1min"))
        runner.anew()
        why = http.get("/v1/explanations").json()
    words = "nothing can form the grid: not big (it is out), small (it is out)."
    assert why["step"]["words"] == f"The island is blacked out: {words}"
    assert {one["words"] for one in why["reasons"]} == {f"Not supplied: {words}"}


def test_nothing_is_green_before_a_reading_has_come(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path / "state") as (http, clock, _):
        http.post("/v1/steps")
        words = "3 customers connected by the plan; no reading is in time."
        assert told(http, tmp_path)["verdict"][:2] == ["warning", words]
        decided(http, clock, NOON + pd.Timedelta("1h"))
        assert told(http, tmp_path)["verdict"][:2] == ["fine", "All 3 customers supplied."]


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


def test_the_first_lines_tell_what_is_announced_and_ordered(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path / "state") as (http, clock, runner):
        http.post("/v1/telemetry", {"series": readings(NOON, "grid_on", {"grid": 1.0})})
        decided(http, clock, NOON, soc=0.85)
        calm = told(http, tmp_path)
        assert calm["verdict"][:2] == ["fine", "All 3 customers supplied."]
        physical = former_words(site(tiny), "physical", always=True)
        assert physical.startswith("In an island big at bus")
        assert http.get("/v1/site").json()["former"] == ""
        assert calm["facts"] == (
            "Measured: grid on, read at 12:00 (scada). Announced: no outage. "
            "Ordered at 12:00: 3 of 3 customers connected."
        )
        later = NOON + pd.Timedelta("13min")
        clock.set(later)
        http.post("/v1/telemetry", {"series": readings(later, "grid_on", {"grid": 0.0})})
        lost = told(http, tmp_path)
        assert lost["verdict"][:2] == [
            "alarm",
            "Grid lost, read at 12:13. The plan of 12:00 does not know it: supply is uncertain.",
        ]
        unaware = "The plan does not know yet: grid lost at 12:13 (scada)."
        assert ["warning", unaware] in lost["attention"]
        plan = runner.anew()
        assert plan is not None
        held = told(http, tmp_path)
        assert "off supply" in held["verdict"][1] and "Outage" in held["verdict"][1]
        assert held["facts"].startswith(
            "Measured: grid lost, read at 12:13 (scada). Announced: no outage."
        )
        assert "Ordered at 12:13 (grid lost" in held["facts"]
        assert set(held["reasons"]) == {"planned; the reason follows"}
        clock.set(clock.now() + pd.Timedelta("1min"))
        point = {"kind": "customers", "asset": "shop", "served": False}
        manual = {"mode": "manual", "until": "2026-11-22T02:00:00Z", "reason": "crew at work"}
        http.put("/v1/mode", {**manual, "setpoints": [point]})
        http.put("/v1/events/storm", {"type": "outage", "start": manual["until"]})
        runner.anew()
        by_hand = told(http, tmp_path)
        assert by_hand["verdict"][1].startswith("Outage, end unknown: ")
        assert set(by_hand["reasons"]) == {"by the operator: crew at work"}
        assert "Announced: outage from Sun 02:00, end unknown (storm)." in by_hand["facts"]
        clock.set(clock.now() + pd.Timedelta("1min"))
        http.put("/v1/mode", {"mode": "off", "reason": "work"})
        runner.anew()
        off = told(http, tmp_path)
        assert off["verdict"][1].endswith("There is no grid: supply is uncertain.")
        assert "supplied" not in off["verdict"][1]


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


def test_a_fault_is_named_with_its_end(tiny: Scenario, tmp_path: Path) -> None:
    """What is announced, what is out, and why customers are off."""
    named = replace(tiny.batteries, grid_forming=[True, False])
    with running(replace(tiny, batteries=named), tmp_path / "state") as (http, clock, runner):
        decided(http, clock, NOON)
        clock.set(NOON + pd.Timedelta("10min"))
        now = written(clock.now())
        http.put("/v1/events/cable", {"type": "fault", "line": "4", "start": now})
        later = {"start": "2026-11-21T16:00:00Z", "end": "2026-11-21T17:00:00Z"}
        http.put("/v1/events/work", {"type": "fault", "bus": "3", **later})
        runner.anew()
        page = told(http, tmp_path)
        soon = {"type": "fault", "line": "4", "start": "2026-11-21T12:40:00Z"}
        http.put("/v1/events/cable", soon)
        clock.set(NOON + pd.Timedelta("11min"))
        runner.anew()
        to_come = "Line 2-4 will be out of service from 12:40, end unknown."
        assert to_come in told(http, tmp_path)["verdict"][2]
    out = "Line 2-4 is out of service, end unknown."
    work = "Bus 3 will be out of service from 16:00 to 17:00."
    level, words, after = page["verdict"]
    assert (level, words) == (
        "warning",
        "1 of 3 customers off supply, all critical customers supplied.",
    )
    assert after == f"{out} {work} No outage is announced."
    assert page["reasons"] == ["no battery forms the grid behind line 2-4, which is out"]
    assert page["events"] == [
        "Line 2-4 out of service since 12:10, end unknown",
        "Bus 3 out of service from 16:00 to 17:00",
    ]
