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
    readings,
    site,
)
from tests.support.long_days import repeated
from tests.support.played_service import played
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.day.simulate import run_day
from vppres.io.scenario_writer import write_scenario
from vppres.model.site import Site
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
