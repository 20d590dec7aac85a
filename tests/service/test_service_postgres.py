"""The state of a service in PostgreSQL, with a real server that the tests start and stop."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
import sqlalchemy as sa

from tests.support import postgres
from tests.support.live_service import HERE, NOON, client, decided, heard, said, site
from vppres.core.errors import InputError, StorageError
from vppres.scenario.scenario import Scenario
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service
from vppres.service.storage.database import OnServer
from vppres.service.storage.store import Store

HOUR = pd.Timedelta("1h")

pytestmark = pytest.mark.skipif(bool(postgres.missing()), reason=postgres.missing())


@pytest.fixture(scope="module")
def server() -> Iterator[postgres.Server]:
    found = postgres.Server()
    yield found
    found.close()


@pytest.mark.nightly
def test_it_decides_as_with_sqlite_and_goes_on_after_a_restart(
    tiny: Scenario, tmp_path: Path, server: postgres.Server
) -> None:
    service = Service(site(tiny), HERE)
    storm = {"type": "outage", "start": "2026-11-21T13:00:00Z"}
    address = server.new_database()
    plans = []
    for place, parts in ((tmp_path, [range(4)]), (address, [range(2), range(2, 4)])):
        found = []
        for part in parts:
            clock = SetClock(NOON)
            with client(service, place, clock) as http:
                http.put("/v1/events/storm", storm)
                for hours in part:
                    time = NOON + hours * HOUR
                    found.append(decided(http, clock, time, 0.5 - 0.1 * hours)["setpoints"])
                    again = http.post("/v1/telemetry", heard(time, 0.5 - 0.1 * hours)).json()
                    assert (again["accepted"], again["duplicates"]) == (0, 2)
                    assert http.get("/readyz").status == 200
        plans.append(found)
    assert plans[0] == plans[1]
    with pytest.raises(InputError, match="holds the state of another site"):
        Store(address, "another site")


# A connection whose server died under it is dropped as it is.
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_second_process_is_refused_until_the_first_one_is_gone(server: postgres.Server) -> None:
    address = server.new_database()
    first = Store(address, "site")
    with pytest.raises(InputError, match="is in use: another process serves from it"):
        Store(address, "site")
    # Its session is gone, as when it is killed or cut off.
    assert isinstance(first._database, OnServer)
    with first._engine.begin() as db:
        db.execute(
            sa.text(
                "SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory' "
                "AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
            )
        )
    second = Store(address, "site")
    with pytest.raises(StorageError, match="Another process serves from"):
        first.put_setting("mode", {}, NOON, "the dead")
    second.put_setting("mode", {"mode": "off"}, NOON, "the living")
    assert second.setting("mode")[0] == {"mode": "off"}
    second.close()
    first.close()
    Store(address, "site").close()


# A connection whose server died under it is dropped as it is.
@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_server_that_is_stopped_and_started_loses_nothing(
    tiny: Scenario, tmp_path: Path, server: postgres.Server
) -> None:
    service = Service(site(tiny), HERE)
    storm = {"type": "outage", "start": "2026-11-21T13:00:00Z"}
    clock = SetClock(NOON)
    one = NOON + HOUR
    with client(service, server.new_database(), clock) as http:
        http.put("/v1/events/storm", storm)
        first = decided(http, clock, NOON)
        clock.set(one)
        assert http.post("/v1/telemetry", heard(one, 0.4)).status == 200
        server.stop()
        assert http.post("/v1/telemetry", heard(one, 0.3)).status == 503
        refused = http.post("/v1/steps")
        assert refused.status == 503 and "does not answer" in refused.json()["detail"]
        assert http.get("/v1/plan").json()["setpoints"] == first["setpoints"]
        assert http.get("/readyz").status == 503
        server.start()
        plan = http.post("/v1/steps").json()
        assert plan["start"] == written(one) and http.get("/readyz").status == 200
    undisturbed = SetClock(NOON)
    with client(service, tmp_path, undisturbed) as http:
        http.put("/v1/events/storm", storm)
        decided(http, undisturbed, NOON)
        assert said(decided(http, undisturbed, one, 0.4), "batteries") == said(plan, "batteries")


def test_no_server_and_no_password_in_the_message(server: postgres.Server) -> None:
    with pytest.raises(InputError) as caught:
        Store(f"postgresql://vppres:secret@127.0.0.1:{server.port}/nowhere", "site")
    assert "does not answer" in str(caught.value) and "secret" not in str(caught.value)


@pytest.mark.nightly
def test_times_of_the_next_century_have_room(server: postgres.Server) -> None:
    address = server.new_database()
    store = Store(address, "site")
    with store._engine.connect() as db:
        kinds = {c["name"]: c["type"] for c in sa.inspect(db).get_columns("telemetry")}
    assert isinstance(kinds["time"], sa.BIGINT)
    assert isinstance(kinds["value"], sa.DOUBLE_PRECISION)
    store.close()
