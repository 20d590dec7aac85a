"""A scenario played against the service, the plant being the world."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import vppres
from tests.support.command_line import call
from tests.support.live_service import HERE, NOON, client, site
from tests.support.long_days import repeated
from tests.support.played_service import Here, crowded, played
from vppres.outlook.outlook import OutageOutlook, seen_outages
from vppres.scenario.outage_warnings import OutageStatistics, OutageWarning
from vppres.scenario.scenario import Scenario
from vppres.scenario.timegrid import TimeGrid
from vppres.service.clock import SetClock, written
from vppres.service.http.client import Answer
from vppres.service.operation.site import Service
from vppres.service.plans.world import World, critical_off, energy_allowed
from vppres.service.simulate import Play, Player, TelemetryFaults, Way, announcements, warned

HOUR = pd.Timedelta("1h")


@pytest.mark.nightly
def test_a_played_day_is_the_run(tiny: Scenario, tmp_path: Path) -> None:
    """Devices of all kinds that follow their set-points do what those of a run do."""
    day = crowded(tiny)
    run = vppres.run_day(day, HERE)
    assert run.gensets is not None and run.gensets["running"].any()
    player = played(Service(day, HERE, rehearsal=True), day, tmp_path, Play(announced=False))
    assert player.tally.statuses == {"ok": day.grid.n_steps} and player.tally.estimated == 0
    assert run.thermal_loads is not None and run.vehicles is not None
    for kind, table, columns in (
        ("gensets", run.gensets, ("running", "p_kw", "fuel_end_litres", "hours_before")),
        ("thermal_loads", run.thermal_loads, ("p_kw", "t_end_c")),
        ("chargers", run.vehicles, ("p_kw",)),
    ):
        for column in columns:
            found = np.concatenate([one.kinds[kind][column] for one in player.world.records])
            assert found == pytest.approx(table[column].to_numpy(float), abs=1e-6), (kind, column)


def stormy(tiny: Scenario, days: int) -> Scenario:
    """Days of hours, each with an outage from two to five in the afternoon."""
    day = site(tiny)
    grid = TimeGrid(NOON.normalize(), 60.0, 24 * days)
    hours = np.arange(24 * days) % 24
    limits = np.where((hours >= 14) & (hours < 17), 0.0, np.inf)
    rows = {name: values[hours] for name, values in day.series.items()}
    return replace(day, grid=grid, **{**rows, "grid_limit_kw": limits})


@pytest.mark.nightly
def test_a_week_of_bad_telemetry_leaves_no_critical_customer_off(
    tiny: Scenario, tmp_path: Path
) -> None:
    """30 % lost, 10 % late, clocks off by 90 s, everything sent twice: two of the days."""
    faults = TelemetryFaults(lost=0.3, delayed=0.1, skew_s=90.0, repeats=True, seed=3)
    service = Service(site(tiny), HERE, paced=True)
    world = stormy(tiny, 2)
    clock = SetClock(world.grid.start)
    player = played(service, world, tmp_path, Play(notice_h=6.0, faults=faults), clock)
    tally = player.tally
    assert set(tally.statuses) <= {"ok", "fallback"} and sum(tally.statuses.values()) == 48
    assert tally.off_needlessly == 0 and tally.gate == 0
    assert tally.estimated > 20 and tally.refused == 0
    assert max(world.outage) and any(r.steps["fallback"] == "none" for r in player.world.records)


def test_who_is_too_slow_misses_steps_and_devices_fall_to_their_default(
    tiny: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("vppres.service.simulate.machine.monotonic", lambda: now[0])
    monkeypatch.setattr(
        "vppres.service.simulate.machine.sleep", lambda s: now.append(now.pop() + s)
    )
    service = Service(tiny, replace(HERE, horizon_h=0.0), rehearsal=True)
    with client(service, tmp_path) as http:

        class Slow(Here):
            def ask(self, method: str, path: str, body: Any = None) -> Answer:
                if path == "/v1/steps":
                    now[0] += 15.0  # two and a half steps of 6 s
                return super().ask(method, path, body)

        player = Player(World(tiny, HERE), Slow(http), Play(speed=600.0, announced=False))
        tally = player.play()
        assert tally.statuses == {"ok": 3, "missed": 3}
        assert http.get("/v1/status").json()["steps"]["missed"] == 3
    # In an hour that nobody decided batteries rest: the last word is over.
    missed = player.world.records[1]
    assert np.abs(missed.batteries["charge_kw"]).max() == 0.0


def test_readings_get_lost_late_shifted_and_repeated() -> None:
    reading = {"source": "a", "start": "2026-11-21T12:00:00Z", "asset": "big"}
    other = {**reading, "source": "b"}
    everything = [{**reading, "asset": str(i)} for i in range(1000)]
    way = Way(TelemetryFaults(lost=0.3, delayed=0.1, seed=1))
    arrived = [len(way.arriving(t, everything if t == 0 else [])) for t in range(5)]
    assert arrived[0] == pytest.approx(600, abs=50)
    assert sum(arrived[1:4]) == pytest.approx(100, abs=30) and min(arrived[1:4]) > 10
    assert arrived[4] == 0
    shifted = Way(TelemetryFaults(skew_s=90.0, repeats=True)).arriving(0, [reading, other])
    assert [one["start"][11:19] for one in shifted] == ["12:01:30", "11:58:30"] * 2


def test_energy_that_is_there_is_a_sum_by_hand(tiny: Scenario) -> None:
    world = World(tiny, HERE)
    record = world.obey(0, [])
    critical = np.asarray(tiny.customers.tier == tiny.tiers[0])
    assert energy_allowed(tiny, record)  # there is grid
    dark = replace(tiny, grid_limit_kw=np.zeros(tiny.grid.n_steps))
    b = tiny.batteries
    there_kw = (
        tiny.pv_kw[0].sum()
        + np.minimum(b.p_max_kw, (b.soc_initial - b.soc_min) * b.energy_kwh * b.eta_discharge).sum()
    )
    needed_kw = tiny.load_kw[0][critical].sum()
    assert energy_allowed(dark, record) == (there_kw >= needed_kw)
    empty = replace(record, batteries={**record.batteries, "soc_start": b.soc_min},
                    pv={**record.pv, "available_kw": 0.0 * tiny.pv_kw[0]})  # fmt: skip
    assert not energy_allowed(dark, empty)
    off = replace(record, customers={**record.customers, "served": np.zeros(len(critical), bool)})
    assert critical_off(tiny, off).tolist() == critical.tolist()


def test_outages_are_announced_in_time(tiny: Scenario) -> None:
    found = list(announcements(stormy(tiny, 2), 6.0))
    assert [(str(at), body["start"], body["end"]) for at, _, body in found] == [
        ("2026-11-21 08:00:00+00:00", "2026-11-21T14:00:00Z", "2026-11-21T17:00:00Z"),
        ("2026-11-22 08:00:00+00:00", "2026-11-22T14:00:00Z", "2026-11-22T17:00:00Z"),
    ]


def test_the_clock_is_set_where_it_is_not_the_machines(tiny: Scenario, tmp_path: Path) -> None:
    with client(Service(site(tiny), HERE, paced=True), tmp_path) as http:
        assert http.put("/v1/clock", {"now": "2026-11-21T12:00:00Z"}).status == 200
        assert http.post("/v1/steps").json()["start"] == "2026-11-21T12:00:00Z"
        back = http.put("/v1/clock", {"now": "2026-11-21T11:00:00Z"}).json()
        assert back["problems"][0]["message"] == "does not go back"
        assert http.get("/v1/status").json()["now"] == "2026-11-21T12:00:00Z"


@pytest.mark.nightly
def test_a_day_is_played_from_the_command_line(tiny: Scenario, tmp_path: Path) -> None:
    """With a service in a process of its own, as in the tutorial."""
    from vppres.io.scenario_writer import write_scenario

    day = repeated(tiny, 24)
    write_scenario(day, tmp_path / "site")
    asked = (
        "serve",
        "simulate",
        str(tmp_path / "site"),
        "--horizon",
        "0",
        "--no-isolate",
        "--json",
    )
    result = call(*asked)
    assert result.exit_code == 0, result.stderr
    import json

    found = json.loads(result.stdout)
    assert found["steps"] == {"ok": 24}
    assert found["size"][-1]["open_files"] <= found["size"][0]["open_files"] + 2


def warned_storm(tiny: Scenario) -> Scenario:
    """An outage of three hours, warned of six hours before it, then more exactly; one in vain."""
    day = stormy(tiny, 1).between(7, 18)
    start = day.grid.times[np.flatnonzero(day.outage)[0]]
    first = OutageWarning(
        start - 6 * HOUR, "storm", onset_earliest=start - 2 * HOUR, onset_likely=start,
        onset_latest=start + 3 * HOUR, probability=0.6,
        duration_p10_h=1.0, duration_p50_h=3.0, duration_p90_h=6.0,
    )  # fmt: skip
    exact = OutageWarning(start - 1.5 * HOUR, "storm", onset_likely=start, probability=0.9)
    vain = replace(first, issued_at=start - 5 * HOUR, outage="vain", onset_latest=start + 9 * HOUR)
    clear = OutageWarning(start - 3 * HOUR, "vain", probability=0.0)
    return replace(
        day, warnings=(first, exact, vain, clear), outage_statistics=OutageStatistics("none")
    )


def test_warnings_are_announced_as_they_are_issued(tiny: Scenario, tmp_path: Path) -> None:
    """What the service believes at each step is what the scenario's own messages say."""
    day = warned_storm(tiny)
    issued = [(at, name, not body) for at, name, body in warned(day)]
    assert [(name, gone) for _, name, gone in issued] == [
        ("warned-1", False), ("warned-2", False), ("warned-2", True), ("warned-1", False),
    ]  # fmt: skip
    assert [at for at, _, _ in issued] == sorted(one.issued_at for one in day.warnings)
    quiet = replace(site(tiny), outage_statistics=OutageStatistics("none"))
    options = replace(HERE, outages="belief")
    service = Service(quiet, options, paced=True)
    plans: dict[str, list[float]] = {}
    with client(service, tmp_path, SetClock(day.grid.start)) as http:
        player = Player(World(day, options), Here(http), Play(beliefs=True))
        player.play()
        for time in day.grid.times:
            answer = http.post("/v1/steps", {"time": written(time)}).json()
            plans[answer["start"]] = answer["outage_probability"]
    told = OutageOutlook(day.warnings, day.outage_statistics, 1.0)
    for t, time in enumerate(day.grid.times):
        seen = seen_outages(day.grid.times[: t + 1], day.outage[: t + 1].tolist())
        asked = told.at(time, 49, seen).out_probability
        found = plans[written(time)]
        assert found == pytest.approx(asked.tolist(), abs=2e-6), time
    assert max(max(each[1:]) for each in plans.values()) > 0.5
