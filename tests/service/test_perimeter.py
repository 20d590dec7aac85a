"""Who may come in: names and origins, tokens with an end, how often, TLS; and what is written down."""

from __future__ import annotations

import ssl
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import sqlalchemy as sa

from tests.support import live_service
from tests.support.asgi import Caller
from tests.support.browser import free_port, listening
from tests.support.live_service import NOON, reading
from tests.support.refusals import refusal
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.io import write_scenario
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock, written
from vppres.service.http import serve as service
from vppres.service.http.app import make_app
from vppres.service.http.perimeter import MOST_STEPS_ASKED
from vppres.service.http.started import started
from vppres.service.limits import Rate, RateLimits
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.records import Reading, seconds

OUTAGE = {"type": "outage", "start": "2026-11-21T14:00:00Z"}


def site() -> Service:
    return Service(live_service.site(tiny_scenario()), RunOptions(horizon_h=1.0, isolate=False))


@pytest.fixture(scope="module")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    with service.opened(site(), tmp_path_factory.mktemp("live"), SetClock(NOON)) as runner:
        yield runner


@pytest.fixture
def http(runner: Runner) -> Caller:
    return Caller(make_app(runner, Access(), ["localhost", "::1", "vpp.example"]))


@pytest.mark.parametrize(
    "host",
    ["evil.example", "localhost.evil.example", "localhost@evil", "", "localhost:port", "a b"],
)
def test_it_answers_to_its_own_names_alone(http: Caller, host: str) -> None:
    answer = http.get("/livez", host=host)
    assert (answer.status, answer.headers["content-type"]) == (400, "application/problem+json")


@pytest.mark.parametrize("host", ["localhost", "localhost:8420", "[::1]:8420", "VPP.example"])
def test_its_names_have_ports_and_capital_letters(http: Caller, host: str) -> None:
    assert http.get("/livez", host=host).status == 200


@pytest.mark.parametrize("origin", [
    "http://evil.example",
    "null",
    "http://[",
    "file://",
    "http://localhost:3000",
    "ftp://localhost",
])  # fmt: skip
def test_a_page_of_others_changes_nothing(http: Caller, runner: Runner, origin: str) -> None:
    before = runner.store.changes
    for ask in (lambda: http.put("/v1/events/x", OUTAGE, origin=origin),
                lambda: http.post("/v1/steps", origin=origin),
                lambda: http.delete("/v1/events/x", origin=origin)):  # fmt: skip
        answer = ask()
        assert answer.status == 403 and "a page from elsewhere" in answer.json()["detail"]
    assert runner.store.changes == before and not runner.last


def test_its_own_page_may(http: Caller, runner: Runner) -> None:
    for origin, host in (
        ("http://localhost:8420", "localhost:8420"),
        ("https://vpp.example", "VPP.example"),
        ("https://vpp.example", "vpp.example:443"),
        ("http://[::1]:8420", "[::1]:8420"),
    ):
        assert http.put("/v1/events/x", OUTAGE, origin=origin, host=host).status in (200, 201)
    assert http.delete("/v1/events/x").status == 200


def test_every_answer_tells_the_browser_what_it_may_not(http: Caller) -> None:
    for path in ("/", "/livez", "/v1/plan", "/v1/nothing", "/metrics"):
        headers = http.get(path).headers
        assert headers["x-content-type-options"] == "nosniff", path
        assert headers["x-frame-options"] == "DENY" and headers["referrer-policy"] == "no-referrer"
        assert headers["content-security-policy"].startswith("default-src 'none'"), path
        assert "access-control-allow-origin" not in headers
        assert "strict-transport-security" not in headers


def test_a_token_ends_with_its_days(runner: Runner) -> None:
    secret, token = new_token("panel:read", days=30)
    assert token.expires is not None
    sent = {"authorization": f"Bearer {secret}"}
    for after_s, status in ((-1, 200), (0, 401), (1e6, 401)):
        access = Access([token], now=lambda at=token.expires + after_s: at)
        assert Caller(make_app(runner, access)).get("/v1/plan", **sent).status == status
    with pytest.raises(InputError, match="is not a name with scopes"):
        new_token(":read", days=1)


def test_tokens_are_kept_with_their_end_and_removed(tmp_path: Path) -> None:
    service.add_token(site(), tmp_path, "panel:read", days=2)
    service.add_token(site(), tmp_path, "scada:telemetry")
    with service.opened(site(), tmp_path) as runner:
        panel, scada = runner.store.tokens()
        assert panel.expires is not None and scada.expires is None
    with pytest.raises(InputError, match="Did you mean panel"):
        service.remove_token(site(), tmp_path, "pannel")
    service.remove_token(site(), tmp_path, "panel")
    with service.opened(site(), tmp_path) as runner:
        assert [token.name for token in runner.store.tokens()] == ["scada"]
        assert [row[1] for row in runner.store.audit()] == ["token", "token", "token removed"]


def test_a_bucket_fills_with_time() -> None:
    clock = [0.0]
    limits = RateLimits({"read": Rate(per_s=2.0, at_once=3.0)}, now=lambda: clock[0])
    assert [limits.wait_s("a", "read") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]
    assert limits.wait_s("b", "read") == 0.0 and limits.wait_s("a", "other") == 0.0
    clock[0] = 0.5
    assert [limits.wait_s("a", "read") for _ in range(2)] == [0.0, 0.5]
    clock[0] = 100.0
    assert [limits.wait_s("a", "read") for _ in range(4)] == [0.0, 0.0, 0.0, 0.5]


def test_few_wait_for_a_step_and_the_others_are_sent_away(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While one is decided that takes long; whoever looks on is not kept waiting."""
    go_on = threading.Event()

    def long(*_: Any) -> dict[str, Any]:
        go_on.wait(10)
        return {}

    monkeypatch.setattr(runner, "step", long)
    with listening(make_app(runner, Access())) as address, ThreadPoolExecutor(20) as pool:

        def ask() -> int:
            request = urllib.request.Request(f"{address}v1/steps", method="POST", data=b"")
            try:
                with urllib.request.urlopen(request) as answer:
                    return int(answer.status)
            except urllib.error.HTTPError as error:
                return int(error.code)

        asked = [pool.submit(ask) for _ in range(20)]
        while sum(one.done() for one in asked) < 20 - MOST_STEPS_ASKED:
            threading.Event().wait(0.01)
        with urllib.request.urlopen(f"{address}v1/status") as answer:
            assert answer.status == 200
        go_on.set()
        statuses = sorted(one.result() for one in asked)
    assert statuses == [200] * MOST_STEPS_ASKED + [429] * (20 - MOST_STEPS_ASKED)


def test_everything_that_changes_something_is_written_down_for_good(
    runner: Runner, http: Caller
) -> None:
    before = len(runner.store.audit())
    forecast = {"issued_at": written(NOON), "start": written(NOON), "resolution": "PT1H",
                "assets": {"shop": {"p50": [40.0]}}}  # fmt: skip
    http.post("/v1/telemetry", {"series": [reading("big", "soc", NOON, 0.5)]})
    http.put("/v1/forecasts/load_kw", forecast)
    http.put("/v1/events/storm", OUTAGE)
    http.delete("/v1/events/storm")
    http.put("/v1/mode", {"mode": "auto"})
    written_down = runner.store.audit()[before:]
    assert [action for _, action, _ in written_down] == [
        "telemetry", "forecast", "event", "event withdrawn", "mode",
    ]  # fmt: skip
    assert {actor for actor, _, _ in written_down} == {"anybody here"}
    for change in ("UPDATE audit SET actor = 'nobody'", "DELETE FROM audit"):
        with (
            pytest.raises(sa.exc.IntegrityError, match="only added to"),
            runner.store._engine.begin() as db,
        ):
            db.execute(sa.text(change))
    assert runner.store.audit()[before:] == written_down


def test_a_batch_is_written_at_once_and_counted_by_reading(runner: Runner) -> None:
    def kept(*values: float) -> tuple[int, int]:
        rows = [
            Reading("big", "online", seconds(NOON) + i, "plc", 60, v) for i, v in enumerate(values)
        ]
        found = runner.store.write_readings(rows, NOON)
        return found.accepted, found.duplicates

    assert kept(1.0, 0.0, nan) == (3, 0)
    assert kept(1.0, 1.0, nan) == (1, 2)
    assert kept(nan, 1.0, 0.0) == (2, 1)
    assert kept() == (0, 0)
    found = runner.store.between(NOON, NOON + pd.Timedelta("1min"), ["online"])
    assert not found[0].known and [one.value for one in found[1:]] == [1.0, 0.0]


def test_batches_that_are_too_large_are_refused(http: Caller) -> None:
    one = reading("big", "soc", NOON, *[0.5] * 2000, lasts="PT1S")
    answer = http.post("/v1/telemetry", {"series": [one] * 11})
    assert answer.status == 422
    detail = answer.json()["detail"]
    assert detail == "request, body: has more than 20000 readings. Send them in parts."


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate of our own making for localhost."""
    folder = tmp_path_factory.mktemp("tls")
    files = folder / "certificate.pem", folder / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
         "-nodes", "-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost",
         "-out", str(files[0]), "-keyout", str(files[1])],
        check=True, capture_output=True,
    )  # fmt: skip
    return files


def test_other_machines_need_tokens_and_tls(certificate: tuple[Path, Path]) -> None:
    _, token = new_token("panel:read")
    some, (cert, key) = Access([token]), certificate
    service.Address("0.0.0.0", certificate=cert, key=key).check(some)
    service.Address("0.0.0.0", behind_proxy=True).check(some)
    service.Address().check(Access())
    for address, access, words in (
        (service.Address("0.0.0.0"), some, "TLS (--certificate and --key), or a proxy"),
        (service.Address("0.0.0.0"), Access(), "needs a token (--add-token NAME:SCOPES) and TLS"),
        (service.Address(certificate=cert), some, "needs --key"),
        (service.Address(certificate=key, key=cert), some, "is no certificate with its key"),
        (service.Address(certificate=Path("nowhere"), key=key), some, "is no certificate with its"),
    ):
        assert words in refusal(address.check, access)


def test_a_port_in_use_is_told_before_anything_is_done(tmp_path: Path) -> None:
    said: list[str] = []
    with service.Address(port=0).listening() as other:
        port = other.getsockname()[1]
        for starts in (
            lambda: service.serve(
                site(), tmp_path / "state", service.Address(port=port), said.append
            ),
            lambda: started(site(), tmp_path / "state", port).__enter__(),
        ):
            with pytest.raises(
                InputError, match=f"127.0.0.1:{port}: .*in use. Give another --port"
            ):
                starts()
    assert said == [] and list(tmp_path.iterdir()) == []


def test_a_site_without_a_whole_day_leaves_no_state_behind(tmp_path: Path) -> None:
    short = replace(site(), scenario=tiny_scenario())
    with (
        pytest.raises(InputError, match="does not fill a day"),
        service.opened(short, tmp_path / "state"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_served_with_tls(tmp_path: Path, certificate: tuple[Path, Path]) -> None:
    """As a process of its own, from the command line."""
    port = free_port()
    write_scenario(site().scenario, tmp_path / "site")
    command = [sys.executable, "-m", "vppres", "serve", "site", "--controller", "idle", "--port", str(port),
               "--certificate", str(certificate[0]), "--key", str(certificate[1])]  # fmt: skip
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert f"https://127.0.0.1:{port}" in process.stdout.readline()
        trusted = ssl.create_default_context(cafile=str(certificate[0]))
        for _ in range(200):
            try:
                answer = urllib.request.urlopen(f"https://localhost:{port}/livez", context=trusted)
                break
            except urllib.error.URLError:
                time.sleep(0.05)
        assert answer.headers["strict-transport-security"] == "max-age=31536000"
        answer.close()
    finally:
        process.terminate()
        process.communicate(timeout=30)
    assert process.returncode == 0


def test_last_readings_are_those_of_the_assets_that_are_named(runner: Runner) -> None:
    rows = [Reading(b, "soc", seconds(NOON), "plc", 60, 0.5) for b in ("big", "small")]
    runner.store.write_readings(rows, NOON)
    assert runner.store.latest(NOON, ["soc"]) == rows
    assert runner.store.latest(NOON, ["soc"], assets=["small"]) == rows[1:]
    assert runner.store.latest(NOON, ["soc"], assets=[]) == []
