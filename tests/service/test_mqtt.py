"""The bridge to MQTT with a real broker: readings arrive, set-points are there until they end."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support import live_service
from tests.support.browser import free_port, listening
from tests.support.tiny_day import tiny_scenario
from vppres.core.errors import InputError
from vppres.day.options import RunOptions
from vppres.service.access import Access, new_token
from vppres.service.clock import SetClock
from vppres.service.http.app import make_app
from vppres.service.http.client import Answer, Client
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service

paho = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
mqtt = pytest.importorskip("vppres.service.mqtt")
Bridge, Topics = mqtt.Bridge, mqtt.Topics
BROKER = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    port = free_port()
    with brokering(tmp_path_factory.mktemp("mqtt"), port):
        yield port


@contextmanager
def brokering(folder: Path, port: int) -> Iterator[None]:
    """A broker at a port."""
    if BROKER is None:
        pytest.skip("no mosquitto on the path")
    settings = folder / "mosquitto.conf"
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n", encoding="utf-8")
    process = subprocess.Popen([BROKER, "-c", str(settings)], stderr=subprocess.DEVNULL)
    within(10, lambda: socket.create_connection(("127.0.0.1", port)).close() or True)
    try:
        yield
    finally:
        process.terminate()
        process.wait(10)


def within(seconds: float, true: Callable[[], Any]) -> None:
    until = time.monotonic() + seconds
    while True:
        try:
            if true():
                return
        except OSError:
            pass
        assert time.monotonic() < until, "it did not come"
        time.sleep(0.02)


class Device:
    """A device at the broker: what it was told, by topic."""

    def __init__(self, port: int) -> None:
        from paho.mqtt.enums import CallbackAPIVersion

        self.told: dict[str, str] = {}
        self.client = paho.Client(CallbackAPIVersion.VERSION2, protocol=paho.MQTTv5)
        self.client.on_connect = lambda client, *_: client.subscribe("vppres/#", qos=1)
        self.client.on_message = lambda _c, _d, m: self.told.update({m.topic: m.payload.decode()})
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@contextmanager
def site(folder: Path, big: str = "big") -> Iterator[tuple[Runner, str, str]]:
    """A service that has just decided an hour; its address and a token."""
    tiny = tiny_scenario()
    named = replace(tiny.batteries, id=np.array([big, "small"], object))
    quiet = live_service.site(replace(tiny, batteries=named))
    served = Service(quiet, RunOptions(horizon_h=0.0, isolate=False))
    secret, token = new_token("bridge:read,telemetry")
    clock = SetClock(pd.Timestamp.now(tz="UTC").floor("s"))
    with opened(served, folder, clock) as runner:
        runner.step()
        with listening(make_app(runner, Access([token]))) as address:
            yield runner, address, secret


@contextmanager
def bridged(folder: Path) -> Iterator[tuple[Runner, Any]]:
    """A service, and a bridge to it without a broker."""
    with site(folder) as (runner, address, secret), closing(Client(address, secret)) as asking:
        yield runner, Bridge(asking, Topics())


def test_readings_go_in_and_set_points_come_out(tmp_path: Path, broker: int) -> None:
    with site(tmp_path) as (runner, address, secret):
        device = Device(broker)
        bridge = Bridge(Client(address, secret), Topics(), "PT1H")
        end = threading.Event()
        running = threading.Thread(target=bridge.run, args=("127.0.0.1", broker, 0.05, end))
        running.start()
        within(10, lambda: device.told.get("vppres/status") == "online")
        device.client.publish("vppres/telemetry/big/soc", "0.61", qos=1)
        device.client.publish("vppres/telemetry/shop/load_kw", "", qos=1)
        device.client.publish("vppres/telemetry/nobody/soc", "0.5", qos=1)
        now = pd.Timestamp.now(tz="UTC") + pd.Timedelta("1min")
        within(10, lambda: len(runner.store.latest(now, ["soc", "load_kw"])) == 2)
        found = {r.asset: r for r in runner.store.latest(now, ["soc", "load_kw"])}
        assert found["big"].value == 0.61 and not found["shop"].known
        assert (found["big"].source, found["big"].resolution_s) == ("mqtt", 3600)
        within(10, lambda: len([t for t in device.told if "/setpoints/" in t]) == 7)
        told = {
            t.rpartition("/")[2]: json.loads(v) for t, v in device.told.items() if "points" in t
        }
        assert runner.last
        for one in runner.last["setpoints"]:
            assert told[one["asset"]]["id"] == one["id"] and told[one["asset"]]["active"]
        device.client.publish("vppres/telemetry/grid/grid_on", "0", qos=1)
        asked = "vppres/asked/grid/grid_on"
        within(10, lambda: "stands alone" in device.told.get(asked, ""))
        end.set()
        running.join()
        within(10, lambda: device.told.get("vppres/status") == "offline")
        device.close()
        # Who comes later finds what is retained.
        late = Device(broker)
        within(10, lambda: len(late.told) >= 7)
        late.close()
        bridge.service.close()


def test_a_topic_has_a_name_as_it_is_or_as_in_an_address(tmp_path: Path, broker: int) -> None:
    with site(tmp_path, "Küche 2/b") as (runner, address, secret):
        bridge = Bridge(Client(address, secret), Topics("vppres/named"), "PT1H")
        bridge.broker.connect("127.0.0.1", broker)
        bridge.broker.loop_start()
        device = Device(broker)
        within(10, lambda: device.told.get("vppres/named/status") == "online")
        now = pd.Timestamp.now(tz="UTC") + pd.Timedelta("1min")
        for name, soc in (("Küche 2/b", 0.61), ("K%C3%BCche%202%2Fb", 0.62)):
            device.client.publish(f"vppres/named/telemetry/{name}/soc", str(soc), qos=1)
            within(10, lambda: len(bridge._waiting) == 1)
            bridge.turn()
            (found,) = runner.store.latest(now, ["soc"])
            assert (found.asset, found.value) == ("Küche 2/b", soc)
        for name in ("Küche 2/b", "K%C3%BCche%202%2Fb", "small"):
            within(10, lambda name=name: f"vppres/named/setpoints/{name}" in device.told)
        device.close()
        bridge.broker.disconnect()
        bridge.broker.loop_stop()
        bridge.service.close()


def test_the_broker_forgets_a_set_point_that_has_ended(tmp_path: Path, broker: int) -> None:
    with site(tmp_path) as (runner, address, secret):
        bridge = Bridge(Client(address, secret), Topics("vppres/short"))
        bridge.broker.connect("127.0.0.1", broker)
        bridge.broker.loop_start()
        within(10, bridge.broker.is_connected)
        assert isinstance(runner.clock, SetClock) and runner.last
        ends = pd.Timestamp(runner.last["setpoints"][0]["valid_until"])
        runner.clock.set(ends - pd.Timedelta("2s"))
        bridge.turn()
        early = Device(broker)
        within(10, lambda: "vppres/short/setpoints/big" in early.told)
        early.close()
        time.sleep(3.0)
        late = Device(broker)
        time.sleep(0.5)
        assert "vppres/short/setpoints/big" not in late.told
        late.close()
        bridge.broker.disconnect()
        bridge.broker.loop_stop()
        bridge.service.close()


@dataclass(frozen=True)
class Message:
    """What a broker hands over."""

    topic: str = "vppres/telemetry/big/soc"
    payload: bytes = b"0.4"
    retain: bool = False


def test_what_the_service_does_not_take_is_kept_or_told(tmp_path: Path) -> None:
    with site(tmp_path) as (runner, address, secret):
        bridge = Bridge(Client(address, "wrong"), Topics())
        bridge._heard(None, None, Message())
        with pytest.raises(InputError, match="the service answers 401"):
            bridge.turn()
        bridge.service.close()
        bridge.service = Client(address, secret)
        bridge.turn()
        now = pd.Timestamp.now(tz="UTC") + pd.Timedelta("1min")
        assert [one.value for one in runner.store.latest(now, ["soc"])] == [0.4]
        bridge.service.close()
    with pytest.raises(OSError, match="does not answer"):
        Bridge(Client(address, secret), Topics()).turn()


ODD = (
    Message(payload=b"nan"),
    Message(payload=b"-inf"),
    Message(payload=b"1e400"),
    Message(payload=b"\xff"),
    Message("vppres/telemetry/big/mood"),
    Message("vppres/telemetry//soc"),
    Message("vppres/telemetry/nobody/soc"),
    Message("vppres/telemetry/%00/soc"),
    Message(f"vppres/telemetry/{'x' * 300}/soc"),
)


def test_one_odd_message_loses_no_other(tmp_path: Path) -> None:
    now = pd.Timestamp.now(tz="UTC") + pd.Timedelta("1min")
    with bridged(tmp_path) as (runner, bridge):
        for number, odd in enumerate(ODD):
            soc = 0.2 + 0.05 * number
            for message in (odd, Message("vppres/telemetry/small/soc", b"%.2f" % soc)):
                bridge._heard(None, None, message)
            bridge.turn()
            heard = {one.asset: one.value for one in runner.store.latest(now, ["soc"])}
            assert heard["small"] == pytest.approx(soc), odd
            assert heard.get("big") is None, odd


@pytest.mark.nightly
def test_what_waited_is_sent_in_parts(tmp_path: Path) -> None:
    """Of readings that waited, a request takes as many as the service does."""
    count = 2 * mqtt.MOST_SERIES + 1

    with bridged(tmp_path) as (runner, bridge):
        for number in range(count):
            bridge._heard(None, None, Message())
            bridge._waiting[-1]["source"] = f"mqtt-{number}"
        bridge.turn()
        assert not bridge._waiting
        assert len(runner.store.contacts()) == count


@pytest.mark.nightly
def test_what_comes_while_others_are_sent_is_not_dropped(tmp_path: Path) -> None:
    class Service:
        """Hears more while it is asked."""

        def ask(self, *_: Any) -> Any:
            bridge._heard(None, None, Message(payload=b"0.9"))
            return Answer(200, {"refused": []}, 0.0)

    bridge = Bridge(Service(), Topics())  # type: ignore[arg-type]
    for _ in range(mqtt.MOST_WAITING):
        bridge._heard(None, None, Message())
    bridge._send(list(bridge._waiting))
    assert [one["values"] for one in bridge._waiting] == [[0.9]]


def test_a_bridge_waits_for_its_broker(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    port = free_port()
    with bridged(tmp_path) as (_, bridge):
        end = threading.Event()
        running = threading.Thread(target=bridge.run, args=("127.0.0.1", port, 0.05, end))
        running.start()
        try:
            within(10, lambda: "does not answer: tried again" in caplog.text)
            assert running.is_alive()
            if BROKER is not None:
                with brokering(tmp_path, port):
                    device = Device(port)
                    within(20, lambda: device.told.get("vppres/status") == "online")
                    within(10, lambda: len([t for t in device.told if "/setpoints/" in t]) == 7)
                    device.close()
        finally:
            end.set()
            running.join(20)
        assert not running.is_alive()


def test_a_retained_message_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    bridge = Bridge(Client("http://127.0.0.1:9"), Topics())
    bridge._heard(None, None, Message(payload=b".9", retain=True))
    bridge._heard(None, None, Message(payload=b".5"))
    assert [one["values"] for one in bridge._waiting] == [[0.5]]
    assert "is retained" in caplog.text


def test_set_points_of_one_name_have_topics_by_kind(tmp_path: Path) -> None:
    """A customer and a PV system may be called alike: none replaces what the other was told."""
    told = []

    class Broker:
        """Says what is published."""

        def is_connected(self) -> bool:
            return True

        def publish(self, topic: str, *_: Any, **__: Any) -> None:
            told.append(topic)

    with bridged(tmp_path) as (_, bridge):
        found = bridge.service.wanted("GET", "/v1/setpoints").body
        found["setpoints"] = [{**one, "asset": "house"} for one in found["setpoints"][:2]] + [
            found["setpoints"][2]
        ]
        kinds = ["customers", "pv", "pv"]
        for one, kind in zip(found["setpoints"], kinds, strict=True):
            one["kind"] = kind
        bridge.broker = Broker()
        bridge.service.wanted = lambda *_: Answer(200, found, 0.0)
        bridge.turn()
    name = found["setpoints"][2]["asset"]
    assert told == [f"vppres/setpoints/{each}" for each in ("customers/house", "pv/house", name)]


NO_NUMBERS = (b"62 %", b"0,62", b'{"value": 0.62}', b"unavailable", b"1_0e-1", b"nan", b"\xff")


@pytest.mark.parametrize("payload", NO_NUMBERS)
def test_what_is_no_number_is_logged_by_topic_and_named_on_the_page(
    payload: bytes, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with bridged(tmp_path) as (_, bridge):
        for message in (Message(), Message(payload=payload)):
            bridge._heard(None, None, message)
        bridge.turn()
        text = payload.decode(errors="replace")
        assert f"'vppres/telemetry/big/soc' is no number: {text!r}" in caplog.text
        (source,) = bridge.service.wanted("GET", "/v1/overview").body["sources"]
        assert source["source"] == "mqtt" and source["ok"] == 1
        assert source["refused"] == [f"soc of big = {text}: is not a number"]


def test_the_bridge_says_which_asset_and_quantity_are_unknown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with bridged(tmp_path) as (_, bridge):
        for topic in ("nobody/soc", "big/mood", "small/soc"):
            bridge._heard(None, None, Message(f"vppres/telemetry/{topic}"))
        bridge.turn()
        assert "telemetry: asset = nobody: is not at the site" in caplog.text
        assert "telemetry: quantity of big = mood: is not known" in caplog.text
        (source,) = bridge.service.wanted("GET", "/v1/overview").body["sources"]
        assert source["ok"] == 1 and len(source["refused"]) == 2
