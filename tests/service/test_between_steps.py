"""Between two steps: what changes is decided anew at once, for the rest of the step."""

from __future__ import annotations

import threading
import time as machine
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from tests.support.live_service import (
    HERE,
    NOON,
    Running,
    decided,
    heard,
    readings,
    running,
    said,
    site,
)
from vppres.core.errors import InputError, StorageError
from vppres.scenario.scenario import Scenario
from vppres.service.events.announced import check_not_over
from vppres.service.http.serve import opened
from vppres.service.operation.loop import Loop
from vppres.service.operation.runner import Service
from vppres.service.payloads import Belief

LATER = NOON + pd.Timedelta("13min")
END = "2026-11-21T13:06:00Z"


@pytest.fixture
def live(tiny: Scenario, tmp_path: Path) -> Iterator[Running]:
    """A service that has decided the step of noon, with grid; it is 12:13."""
    with running(tiny, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON, soc=0.85)
        clock.set(LATER)
        yield http, clock, runner


def grid(on: float, at: pd.Timestamp = LATER) -> dict[str, Any]:
    """The grid's reading."""
    return {"series": readings(at, "grid_on", {"grid": on})}


def test_a_grid_that_is_lost_is_planned_for_at_once(live: Running) -> None:
    http, clock, runner = live
    before = http.get("/v1/plan").json()
    assert runner.anew() is None
    http.post("/v1/telemetry", grid(0.0))
    why = "grid lost at 2026-11-21T12:13:00Z (scada)"
    assert http.get("/v1/plan").json()["unaware_of"] == [why]
    assert http.get("/v1/overview").json()["plan"]["unaware_of"] == [why]
    runner.anew()
    plan = http.get("/v1/plan").json()
    assert plan["grid"] == {"available": False, "known_by": "reading"}
    assert (plan["start"], plan["valid_from"], plan["anew"]) == (
        "2026-11-21T12:00:00Z", "2026-11-21T12:13:00Z", why,
    )  # fmt: skip
    assert "unaware_of" not in plan
    on = said(plan, "customers")
    assert on["hospital"]["served"] and not all(one["served"] for one in on.values())
    now = http.get("/v1/setpoints").json()["setpoints"]
    assert all(one["active"] and one["anew"] == why and one["valid_until"] == END for one in now)
    was = http.get("/v1/setpoints?at=2026-11-21T12:05:00Z").json()["setpoints"]
    assert [one["id"] for one in was] == [one["id"] for one in before["setpoints"]]
    assert http.get("/v1/status").json()["steps"]["ok"] == 1  # a step counts once
    accepted = http.post(f"/v1/setpoints/{was[0]['id']}/status", {"status": "accepted"})
    assert accepted.status == 200
    # And back again.
    clock.set(LATER + pd.Timedelta("20min"))
    http.post("/v1/telemetry", grid(1.0, clock.now()))
    runner.anew()
    light = http.get("/v1/plan").json()
    assert all(one["served"] for one in said(light, "customers").values())
    assert [one["valid_from"] for one in light["before"]] == [
        "2026-11-21T12:00:00Z",
        "2026-11-21T12:13:00Z",
    ]
    assert decided(http, clock, NOON + pd.Timedelta("1h"))["status"] == "ok"


def test_what_was_stored_in_the_step_counts_when_it_is_decided_anew(live: Running) -> None:
    """13 minutes of what was ordered first, then 47 of what was ordered anew."""
    http, clock, runner = live
    first = said(http.get("/v1/plan").json(), "batteries")["big"]["p_kw"]
    http.post("/v1/telemetry", grid(0.0))
    plan = runner.anew()
    assert plan is not None
    second = said(plan, "batteries")["big"]["p_kw"]
    assert first < 0.0 and second < 0.0 and first != second
    clock.set(NOON + pd.Timedelta("1h"))
    silent = runner.step()
    given_kwh = -(first * 13 + second * 47) / 60 / 0.95
    left = 0.85 - given_kwh / 100.0
    assert any(one.startswith(f"soc big {left:.4f} ") for one in silent["estimated"])


def test_events_modes_and_refusals_are_planned_for_at_once(live: Running) -> None:
    http, clock, runner = live

    def anew() -> dict[str, Any]:
        clock.set(clock.now() + pd.Timedelta("1min"))
        found = runner.anew()
        assert found is not None
        return found

    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T12:10:00Z"})
    dark = anew()
    assert dark["anew"] == "event storm" and not dark["grid"]["available"]
    point = said(dark, "batteries")["big"]
    http.post(f"/v1/setpoints/{point['id']}/status", {"status": "rejected"})
    without = anew()
    assert without["anew"] == "big rejected" and "battery big is out" in without["estimated"]
    http.put("/v1/mode", {"mode": "off", "reason": "work"})
    assert anew()["status"] == "off"
    http.put("/v1/mode", {"mode": "auto"})
    http.delete("/v1/events/storm")
    light = anew()
    assert light["anew"] == "mode auto; event storm withdrawn"
    assert all(one["served"] for one in said(light, "customers").values())
    assert http.get("/v1/status").json()["steps"]["ok"] == 1
    http.put("/v1/events/note", {"type": "alert", "start": "2026-11-21T12:10:00Z", "text": "!"})
    assert runner.anew() is None


def test_a_service_that_comes_back_within_a_step_sees_what_it_missed(
    tiny: Scenario, tmp_path: Path
) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        decided(http, clock, NOON, soc=0.85)
        clock.set(LATER)
        http.post("/v1/telemetry", grid(0.0))
    clock.set(LATER + pd.Timedelta("2min"))
    with opened(Service(site(tiny), HERE), tmp_path, clock) as runner:
        assert runner.changes.reasons == ()
        runner.look()
        plan = runner.anew()
        assert plan is not None and not plan["grid"]["available"]
        assert said(plan, "customers")["hospital"]["served"]


def test_the_loop_answers_a_lost_grid_within_seconds(live: Running) -> None:
    http, _, runner = live
    loop = Loop(runner)
    loop.start()
    try:
        machine.sleep(0.2)
        http.post("/v1/telemetry", grid(0.0))
        begin = machine.monotonic()
        while not runner.last or "anew" not in runner.last:
            assert machine.monotonic() < begin + 30.0
            machine.sleep(0.02)
        assert runner.changes.reasons == ()
    finally:
        loop.end()
    assert not loop.is_alive()


def test_the_loop_tries_a_new_plan_again_that_could_not_be_kept(
    live: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, _, runner = live
    done = threading.Event()
    tries = []

    def anew() -> None:
        tries.append(runner.changes.new.is_set())
        runner.changes.new.clear()
        if len(tries) == 1:
            raise StorageError("the disk is full")
        runner.changes.known(runner.changes.noted)
        done.set()

    monkeypatch.setattr(runner, "anew", anew)
    monkeypatch.setattr("vppres.service.operation.loop.RETRY_S", 0.01)
    loop = Loop(runner)
    loop.start()
    runner.changes.note("event storm")
    assert done.wait(20.0)
    loop.end()


def test_a_change_at_the_moment_of_a_plan_is_seen_once_the_clock_goes_on(live: Running) -> None:
    http, _, runner = live
    http.post("/v1/telemetry", grid(0.0))
    assert runner.anew() is not None
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T12:00:00Z"})
    assert runner.anew() is None and not runner.changes.new.is_set()
    runner.set_clock(LATER + pd.Timedelta("1min"))
    assert runner.changes.new.is_set()
    assert runner.anew() is not None


def test_a_step_that_is_not_decided_yet_is_left_to_its_own_plan(live: Running) -> None:
    http, clock, runner = live
    clock.set(NOON + pd.Timedelta("1h"))
    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T13:00:00Z"})
    assert runner.anew() is None and runner.changes.reasons == ("event storm",)
    http.post("/v1/telemetry", heard(clock.now()))
    plan = http.post("/v1/steps").json()
    assert not plan["grid"]["available"] and "anew" not in plan
    assert runner.changes.reasons == ()


PAST: dict[str, dict[str, Any]] = {
    "storm": {"type": "outage", "start": "2026-11-21T09:00:00Z", "end": "2026-11-21T12:13:00Z"},
    "cable": {"type": "import_limit", "start": "2026-11-21T09:00Z", "end": "2026-11-21T10:00Z",
              "limit_kw": 5.0},
    "tariff": {"type": "price", "start": "2026-11-21T09:00:00Z", "resolution": "PT1H",
               "price_gbp_per_kwh": [0.1, 0.2]},
}  # fmt: skip


def test_what_is_wholly_past_is_not_announced(live: Running) -> None:
    """But an event that is known may be ended so."""
    http, _, _ = live
    for name, past in PAST.items():
        answer = http.put(f"/v1/events/{name}", past)
        assert answer.status == 422, name
        assert answer.json()["problems"][0]["message"] == "lies wholly in the past", name
    assert http.get("/v1/events").json() == {}
    for name, past in PAST.items():
        http.put(f"/v1/events/{name}", {"type": "outage", "start": past["start"]})
        assert http.put(f"/v1/events/{name}", past).status == 200, name


@pytest.mark.parametrize(
    ("duration", "over"),
    [
        ({"family": "discrete", "hours": [1.0, 2.0], "probabilities": [0.5, 0.5]}, True),
        ({"family": "discrete", "hours": [1.0, 5.0], "probabilities": [0.5, 0.5]}, False),
        ({"family": "until", "until": "2026-11-21T11:00:00Z"}, True),
        ({"family": "lognormal", "median_h": 1.0, "sigma": 1.0, "max_h": None}, False),
    ],
)
def test_a_believed_outage_is_over_when_its_longest_is(
    duration: dict[str, Any], over: bool
) -> None:
    onset = {"start": "2026-11-21T08:00Z", "resolution": "PT1H", "probabilities": [0.5, 0.5]}
    body = {"type": "outage_belief", "probability": 0.6, "onset": onset, "duration": duration}
    with pytest.raises(InputError, match="wholly in the past") if over else nullcontext():
        check_not_over(Belief.model_validate(body), NOON)


@pytest.mark.parametrize("certain", [True, False])
def test_an_outage_that_ended_within_the_step_is_over_for_the_rest_of_it(
    live: Running, certain: bool
) -> None:
    """Also one that is stated as a belief of certain length."""
    http, clock, runner = live
    storm: dict[str, Any] = {
        "type": "outage", "start": "2026-11-21T12:05:00Z", "end": "2026-11-21T12:20:00Z",
    }  # fmt: skip
    if not certain:
        onset = {"start": "2026-11-21T12:00:00Z", "resolution": "PT10M", "probabilities": [1.0]}
        length = {"family": "until", "until": storm["end"]}
        storm = {"type": "outage_belief", "probability": 1.0, "onset": onset, "duration": length}
    assert http.put("/v1/events/storm", storm).status in (200, 201)
    dark = runner.anew()
    assert dark is not None and not dark["grid"]["available"]
    clock.set(LATER + pd.Timedelta("20min"))
    http.put("/v1/mode", {"mode": "off", "reason": "work"})
    http.put("/v1/mode", {"mode": "auto"})
    light = runner.anew()
    assert light is not None and light["grid"]["available"]


def test_set_points_beyond_a_rating_and_unknown_assets_are_refused(live: Running) -> None:
    http, _, _ = live
    manual = {
        "mode": "manual",
        "until": "2026-11-21T14:00:00Z",
        "setpoints": [
            {"kind": "batteries", "asset": "big", "p_kw": -51.0},
            {"kind": "batteries", "asset": "small", "p_kw": 30.0, "q_kvar": 20.0},
            {"kind": "pv", "asset": "roof", "p_kw": 29.0},
        ],
    }
    found = http.put("/v1/mode", manual)
    assert found.status == 422
    assert [(one["field"], one["message"]) for one in found.json()["problems"]] == [
        ("p_kw of big", "is beyond its rating of 50 kW"),
        ("kVA of small", "is beyond its rating of 35 kVA"),
    ]
    assert http.get("/v1/mode").json()["mode"] == "auto"
    for path in ("/v1/setpoints", "/v1/explanations"):
        assert http.get(f"{path}?asset=bigg").status == 404
        assert "Did you mean big?" in http.get(f"{path}?asset=bigg").json()["detail"]


def test_an_announced_end_ends_an_outage_that_nobody_reads_any_more(live: Running) -> None:
    http, clock, _ = live
    storm = {"type": "outage", "start": "2026-11-21T12:05:00Z", "end": "2026-11-21T13:00:00Z"}
    http.put("/v1/events/storm", storm)
    http.post("/v1/telemetry", grid(0.0))
    # Its reading holds for an hour; after that nobody has seen the outage go on.
    seen = [decided(http, clock, NOON + hours * pd.Timedelta("1h"))["grid"] for hours in (1, 2)]
    assert [one["available"] for one in seen] == [False, True]


def test_a_device_that_is_back_is_planned_for_at_once(live: Running) -> None:
    http, clock, runner = live

    def anew(why: str) -> dict[str, Any]:
        clock.set(clock.now() + pd.Timedelta("1min"))
        found = runner.anew()
        assert found is not None and found["anew"] == why
        return found

    def said_of(quantity: str, asset: str, value: float) -> None:
        sent = {"series": readings(clock.now(), quantity, {asset: value})}
        assert http.post("/v1/telemetry", sent).status == 200

    http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T12:10:00Z"})
    point = said(anew("event storm"), "batteries")["big"]
    status = f"/v1/setpoints/{point['id']}/status"
    http.post(status, {"status": "rejected"})
    assert "battery big is out" in anew("big rejected")["estimated"]
    http.post(status, {"status": "accepted"})
    assert "battery big is out" not in anew("big accepted")["estimated"]
    point = said(runner.last, "batteries")["big"]
    http.post(f"/v1/setpoints/{point['id']}/status", {"status": "aborted"})
    assert "battery big is out" in anew("big aborted")["estimated"]
    said_of("soc", "big", 0.8)
    assert "battery big is out" not in anew("battery big is heard")["estimated"]
    said_of("soc", "big", 0.8)
    assert runner.anew() is None
    said_of("online", "big", 0.0)
    assert "battery big is out" in anew("big online = 0 (scada)")["estimated"]
    said_of("online", "big", 0.0)
    assert runner.anew() is None
    said_of("online", "big", 1.0)
    assert (
        "battery big is out"
        not in anew("battery big is heard; big online = 1 (scada)")["estimated"]
    )
    said_of("online", "hospital", 0.0)
    assert not said(anew("hospital online = 0 (scada)"), "customers")["hospital"]["served"]
    said_of("online", "hospital", 1.0)
    back = anew("customer hospital is heard; hospital online = 1 (scada)")
    assert said(back, "customers")["hospital"]["served"]


def test_a_first_reading_is_planned_for_when_it_comes(tiny: Scenario, tmp_path: Path) -> None:
    with running(tiny, tmp_path) as (http, clock, runner):
        first = runner.step()
        assert "battery big is out" in first["estimated"]
        clock.set(NOON + pd.Timedelta("20s"))
        http.post("/v1/telemetry", {"series": readings(NOON, "soc", {"big": 0.6, "small": 0.6})})
        plan = runner.anew()
        assert plan is not None
        assert plan["anew"] == "battery big is heard; battery small is heard"
        assert not any("is out" in one for one in plan["estimated"])


def of_the_substation(*told: tuple[str, str, float]) -> dict[str, Any]:
    """Readings of ten seconds: when, of what, and what."""
    return {
        "series": [
            {**one, "resolution": "PT10S"}
            for after, quantity, value in told
            for one in readings(LATER + pd.Timedelta(after), quantity, {"grid": value})
        ]
    }


def available(http: Any) -> bool:
    """Whether the plan believes in a grid."""
    found: bool = http.get("/v1/plan").json()["grid"]["available"]
    return found


def test_a_lost_grid_that_stands_alone_is_planned_for_and_asked_again(live: Running) -> None:
    """What comes within seconds bears it out, or takes it back."""
    http, clock, runner = live
    answer = http.post("/v1/telemetry", of_the_substation(("0s", "grid_on", 0.0))).json()
    alone = (
        "grid_on = 0 of scada at 2026-11-21T12:13:00Z stands alone: send grid_on again within "
        "10 s, and import_kw since then"
    )
    assert answer["asked_again"] == [alone]
    runner.anew()
    assert not available(http)
    assert http.get("/v1/plan").json()["asked_again"] == [alone]
    clock.set(LATER + pd.Timedelta("10s"))
    said = of_the_substation(("0s", "import_kw", 0.0), ("10s", "grid_on", 0.0))
    assert "asked_again" not in http.post("/v1/telemetry", said).json()
    runner.anew()
    assert not available(http)


@pytest.mark.parametrize("stuck", [True, False])
def test_an_import_since_the_grid_was_said_to_be_lost_takes_it_back(
    live: Running, stuck: bool
) -> None:
    """A contact that is stuck, polled each ten seconds; or one that said it once."""
    http, clock, runner = live
    http.post("/v1/telemetry", of_the_substation(("0s", "grid_on", 0.0)))
    runner.anew()
    assert not available(http)
    for poll in (1, 2):
        clock.set(LATER + poll * pd.Timedelta("10s"))
        told = [(f"{poll - 1}0s", "import_kw", 80.0)]
        if stuck:
            told.append((f"{poll}0s", "grid_on", 0.0))
        http.post("/v1/telemetry", of_the_substation(*told))
        assert (runner.anew() is None) is (poll == 2)
        assert available(http)
        [words] = [one for one in runner.last["estimated"] if "grid_on" in one]  # type: ignore[index]
        assert words == "grid_on = 0 of scada is contradicted by an import of 80 kW"
    # And the grid is lost in truth.
    clock.set(LATER + pd.Timedelta("30s"))
    told = [("20s", "import_kw", 0.0), ("30s", "grid_on", 0.0)]
    http.post("/v1/telemetry", of_the_substation(*told))
    runner.anew()
    assert not available(http)


def test_a_lost_grid_that_was_announced_or_seen_by_another_is_not_asked_again(
    live: Running,
) -> None:
    http, _, _ = live
    told = of_the_substation(("0s", "grid_on", 0.0))
    other = {**told["series"][0], "source": "watch"}
    answer = http.post("/v1/telemetry", {"series": [*told["series"], other]}).json()
    assert answer == {"accepted": 2, "duplicates": 0, "refused": []}
