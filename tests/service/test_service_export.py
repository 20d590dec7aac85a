"""What a service heard and said, as the run of a scenario; and what it forgets."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.command_line import call
from tests.support.live_service import (
    HERE,
    NOON,
    client,
    decided,
    heard,
    readings,
    said,
    serving,
    site,
)
from tests.support.long_days import repeated
from tests.support.played_service import played
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.reliability import reliability_by_tier
from vppres.day.simulate import run_day
from vppres.day.trajectory import taken
from vppres.io.scenario_writer import write_scenario
from vppres.model.site import Site
from vppres.report.events import events_of
from vppres.report.finished import read_finished
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.replay.export import export
from vppres.service.simulate import Play
from vppres.service.storage.store import Store

HOUR = pd.Timedelta("1h")


@pytest.mark.nightly
def test_a_played_day_that_is_written_out_is_the_run(tiny: Scenario, tmp_path: Path) -> None:
    """Customers, batteries, PV and import, to the last bit; reports work on it."""
    day = repeated(tiny, 24, "2025-07-01T00:00Z")
    options = RunOptions(horizon_h=1.0, isolate=False)
    run = run_day(day, options)
    write_scenario(day, tmp_path / "site")
    played(Service(day, options, rehearsal=True), day, tmp_path / "state", Play(announced=False))
    out = tmp_path / "out"
    times = ("--from", "2025-07-01T00:00Z", "--to", "2025-07-02T00:00Z")
    result = call("serve", "export", tmp_path / "site", *times, "--out", out, "--horizon", "1",
                  "--state", tmp_path / "state")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    again = read_finished(out).trajectory
    for table, columns in (
        ("customers", ["p_load_kw", "served"]),
        ("batteries", ["charge_kw", "discharge_kw", "soc_start", "soc_end"]),
        ("pv", ["available_kw", "curtailed_kw", "q_kvar"]),
        ("steps", ["outage", "p_grid_kw", "bound", "fallback", "status"]),
    ):
        for column in columns:
            found = getattr(again, table)[column].to_numpy()
            assert np.array_equal(found, getattr(run, table)[column].to_numpy()), (table, column)
    other = shutil.copytree(out, tmp_path / "other")
    compared = call("compare", out, other, "--out", tmp_path / "both.html")
    assert compared.exit_code == 0, compared.stderr


def test_what_was_measured_stands_over_the_profile(tiny: Scenario, tmp_path: Path) -> None:
    clock = SetClock(NOON)
    service = Service(site(tiny), HERE)
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/storm", {"type": "outage", "start": "2026-11-21T13:00:00Z",
                                      "end": "2026-11-21T14:00:00Z"})  # fmt: skip
        for hours in (0, 1, 3):
            time = NOON + hours * HOUR
            clock.set(time)
            http.post(
                "/v1/telemetry", {"series": readings(time, "load_kw", {"shop": 33.0 + hours})}
            )
            decided(http, clock, time, soc=0.5 + 0.1 * hours)
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T16:00")  # while it runs
        http.delete("/v1/events/storm")
        said = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T16:00").scenario.warnings
        assert [(one.outage, one.issued_at, one.all_clear) for one in said] == [
            ("storm", NOON, False),
            ("storm", NOON + 3 * HOUR, True),
        ]
        assert (said[0].onset_likely, said[0].duration_p90_h) == (NOON + HOUR, 1.0)
        with pytest.raises(InputError, match="finds no step from 2026-11-20"):
            export(service, tmp_path, "2026-11-20", "2026-11-20T05:00")
        with pytest.raises(InputError, match="does not end after it begins"):
            export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T12:00")
        with pytest.raises(InputError, match="is not a time"):
            export(service, tmp_path, "noon", "2026-11-21")
        with pytest.raises(InputError, match="holds no state of a service"):
            export(service, tmp_path / "nowhere", "2026-11-20", "2026-11-21")
    assert run.steps["status"].tolist()[2] == "missed"
    assert run.steps["outage"].tolist() == [False, True, False, False]
    shop = run.customers[run.customers["id"] == "shop"]["p_load_kw"].tolist()
    assert shop[:2] == [33.0, 34.0] and shop[3] == 36.0
    big = run.batteries[run.batteries["id"] == "big"]["soc_start"]
    assert big.tolist()[0] == 0.5 and big.tolist()[3] == pytest.approx(0.8)


def test_prices_and_limits_are_those_that_were_known(tiny: Scenario, tmp_path: Path) -> None:
    """Of steps that were decided what the plan rested on, of others what was said by then."""
    clock = SetClock(NOON)
    service = Service(site(tiny), HERE)
    price = {"type": "price", "start": "2026-11-21T12:00:00Z", "resolution": "PT1H"}
    limit = {"type": "import_limit", "start": "2026-11-21T13:00:00Z", "limit_kw": 55.0}
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/tariff", {**price, "price_gbp_per_kwh": [0.5, 0.6, 0.7, 0.8]})
        decided(http, clock, NOON)
        http.put("/v1/events/tariff", {**price, "price_gbp_per_kwh": [9.0, 0.61, 0.71, 0.81]})
        http.put("/v1/events/cap", limit)
        decided(http, clock, NOON + HOUR)
        http.put("/v1/mode", {"mode": "off"})
        decided(http, clock, NOON + 2 * HOUR)
        clock.set(NOON + 2.5 * HOUR)
        http.put("/v1/events/cap", {**limit, "limit_kw": 5.0})
        http.put("/v1/mode", {"mode": "auto"})
        decided(http, clock, NOON + 4 * HOUR)
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T17:00")
    profile = service.scenario.price_gbp_per_kwh
    assert run.scenario.price_gbp_per_kwh.tolist() == [0.5, 0.61, 0.71, 0.81, profile[16]]
    # Two o'clock was switched off; of three, which was missed, it is known what had been said.
    assert run.scenario.grid_limit_kw.tolist() == [np.inf, 55.0, 55.0, 5.0, 5.0]


def test_a_database_of_an_earlier_version_is_exported(tiny: Scenario, tmp_path: Path) -> None:
    """It lacks what came later, and nothing is added to what is only read."""
    clock = SetClock(NOON)
    service = Service(site(tiny), HERE)
    price = {"type": "price", "start": written(NOON), "resolution": "PT1H"}
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/tariff", {**price, "price_gbp_per_kwh": [0.51]})
        decided(http, clock, NOON)
    with closing(sqlite3.connect(tmp_path / "service.db")) as db:
        db.execute("DROP TABLE written_events")
    run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    assert run.scenario.price_gbp_per_kwh.tolist() == [0.51]


def test_what_is_old_is_forgotten_and_what_holds_is_not(tiny: Scenario, tmp_path: Path) -> None:
    clock = SetClock(NOON)
    service = replace(Service(site(tiny), HERE), keep_days=1.0)
    storm = {"type": "outage", "start": "2026-11-30T13:00:00Z"}
    with client(service, tmp_path, clock) as http:
        http.put("/v1/events/storm", storm)
        http.put("/v1/events/storm", {**storm, "start": "2026-12-30T13:00:00Z"})
        decided(http, clock, NOON)
        http.put("/v1/events/calm", storm)
        http.delete("/v1/events/calm")
        decided(http, clock, NOON + 3 * 24 * HOUR)
        assert len(http.get("/v1/events/storm/versions").json()) == 1
        assert http.get("/v1/events/calm/versions").json() == []
        assert list(http.get("/v1/events").json()) == ["storm"]
    store = Store(tmp_path, Site.of(service.scenario).key, reading=True)
    assert not store.step(NOON) and store.step(NOON + 3 * 24 * HOUR)
    assert not store.between(NOON, NOON + HOUR, ["soc"])
    assert store.audit() and len(store.plans(NOON, NOON + 72 * HOUR)) < 72
    assert store.outcomes() == {"ok": 2, "missed": 71}  # those that are forgotten too
    store.close()
    assert written(NOON) == "2026-11-21T12:00:00Z"


def test_the_share_of_a_step_decided_anew_is_that_while_it_was_on(
    tiny: Scenario, tmp_path: Path
) -> None:
    """The shop has all for 15 minutes, a half for 15, and nothing for 30; homes 1, 1 and a half."""
    day = site(tiny)
    day = replace(day, customers=replace(day.customers, share_min=[1.0, 0.5, 0.5]))
    shop = {"kind": "customers", "asset": "shop", "served": True, "share": 0.5}
    homes = {"kind": "customers", "asset": "homes", "served": True, "share": 0.5}
    clock, service = SetClock(NOON), Service(day, HERE)
    with serving(service, tmp_path, clock) as (http, runner):
        decided(http, clock, NOON)
        for minutes, asked in ((15, [shop]), (30, [{**shop, "served": False}, homes])):
            clock.set(NOON + minutes * MINUTE)
            for one in asked:
                if not one["served"]:
                    one.pop("share")
            mode = {"mode": "manual", "until": written(NOON + HOUR), "reason": "test"}
            assert http.put("/v1/mode", {**mode, "setpoints": asked}).status == 200
            assert runner.anew() is not None
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    found = run.customers.set_index("id")
    assert found["time_on"].to_dict() == {"hospital": 1.0, "shop": 0.5, "homes": 1.0}
    shares = {"hospital": 1.0, "shop": 0.75, "homes": 0.75}
    assert found["share"].to_dict() == pytest.approx(shares, abs=1e-5)
    assert run.supplied[0] == pytest.approx([1.0, 0.375, 0.75], abs=1e-5)
    assert taken(run.customers).tolist()[1] == 0.0


MINUTE = pd.Timedelta("1min")
ISLAND = RunOptions(horizon_h=2.0, isolate=False, mode="physical")


def test_a_dark_minute_between_two_steps_is_in_history_and_export(
    tiny: Scenario, tmp_path: Path
) -> None:
    """The former rejects its set-point of 12:20, and is back a minute later."""
    clock = SetClock(NOON)
    service = Service(site(tiny), ISLAND)

    def grid(on: float, minutes: float) -> None:
        clock.set(NOON + minutes * MINUTE)
        http.post("/v1/telemetry", {"series": readings(clock.now(), "grid_on", {"grid": on})})
        assert runner.anew() is not None

    with serving(service, tmp_path, clock) as (http, runner):
        decided(http, clock, NOON, soc=0.85)
        grid(0.0, 20.0)
        island = said(http.get("/v1/plan").json(), "customers")
        assert island["hospital"]["served"]
        clock.set(NOON + 21 * MINUTE)
        for former in ("big", "small"):
            point = said(http.get("/v1/plan").json(), "batteries")[former]["id"]
            http.post(f"/v1/setpoints/{point}/status", {"status": "rejected"})
        assert runner.anew() is not None
        dark = said(http.get("/v1/plan").json(), "customers")
        assert not dark["hospital"]["served"]
        clock.set(NOON + 22 * MINUTE)
        http.post("/v1/telemetry", heard(clock.now(), 0.8))
        assert runner.anew() is not None
        grid(1.0, 40.0)
        clock.set(NOON + HOUR)
        (hour,) = http.get(f"/v1/history?since={written(NOON)}").json()["steps"]
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    assert hour["off_min"]["hospital"] == pytest.approx(2.0)
    assert hour["served"]["critical"] == pytest.approx(58.0 / 60.0)
    hospital = run.customers.set_index("id").loc["hospital"]
    assert (hospital["served"], hospital["losses"]) == (True, 1)
    assert hospital["time_on"] == pytest.approx(58.0 / 60.0)
    by_tier = reliability_by_tier(run).loc["critical"]
    assert by_tier["interruptions"] == 1.0
    assert by_tier["minutes_lost"] == pytest.approx(2.0)
    assert by_tier["unserved_kwh"] == pytest.approx(hospital["p_load_kw"] * 2.0 / 60.0)
    words = [one.words for one in events_of(run)]
    assert any("hospital (critical) 2 min" in one for one in words), words
    assert sum(run.time_off[0] * 60.0) == pytest.approx(sum(hour["off_min"].values()))


@pytest.mark.parametrize(("mode", "dark_min"), [("auto", 33.0), ("off", 30.0)])
def test_what_nobody_planned_for_is_the_plants_answer(
    tiny: Scenario, tmp_path: Path, mode: str, dark_min: float
) -> None:
    """Empty batteries; lost at 12:10, back at 12:40, each read three minutes later.

    With ``auto`` the plan of 12:13 leaves all off, up to that of 12:43; with ``off`` everybody is
    connected, as before, but nothing forms the grid up to 12:40.
    """
    clock = SetClock(NOON)
    service = Service(site(tiny), ISLAND)
    with serving(service, tmp_path, clock) as (http, runner):
        decided(http, clock, NOON, soc=0.15)
        clock.set(NOON + 5 * MINUTE)
        http.put("/v1/mode", {"mode": mode, "reason": "work"})
        runner.anew()
        for minutes, on in ((10, 0.0), (40, 1.0)):
            clock.set(NOON + (minutes + 3) * MINUTE)
            read = readings(NOON + minutes * MINUTE, "grid_on", {"grid": on})
            http.post("/v1/telemetry", {"series": read})
            runner.anew()
        clock.set(NOON + HOUR)
        (hour,) = http.get(f"/v1/history?since={written(NOON)}").json()["steps"]
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    everybody = ("homes", "hospital", "shop")
    assert hour["off_min"] == {name: pytest.approx(dark_min) for name in everybody}
    assert not run.steps["outage"][0]
    assert run.customers["losses"].tolist() == [1, 1, 1]
    assert run.customers["time_on"].to_numpy() == pytest.approx(1.0 - dark_min / 60.0)


def test_a_step_that_was_dark_from_its_beginning_in_mode_off_is_dark_in_history_and_export(
    tiny: Scenario, tmp_path: Path
) -> None:
    """One plan, all connected by its defaults, and nothing forms the grid of the island."""
    clock = SetClock(NOON - MINUTE)
    service = Service(site(tiny), ISLAND)
    with client(service, tmp_path, clock) as http:
        series = [*heard(NOON - MINUTE, 0.15)["series"]]
        series += readings(NOON - MINUTE, "grid_on", {"grid": 0.0})
        http.post("/v1/telemetry", {"series": series})
        http.put("/v1/mode", {"mode": "off", "reason": "work"})
        clock.set(NOON)
        plan = http.post("/v1/steps").json()
        assert plan["status"] == "off" and not plan["grid"]["available"]
        assert all(one["served"] for one in said(plan, "customers").values())
        clock.set(NOON + HOUR)
        (hour,) = http.get(f"/v1/history?since={written(NOON)}").json()["steps"]
        run = export(service, tmp_path, "2026-11-21T12:00", "2026-11-21T13:00")
    assert set(hour["served"].values()) == {0.0}
    assert not run.customers["served"].any()
    assert reliability_by_tier(run)["minutes_lost"].tolist() == [60.0] * 3
