"""Between the service and an MQTT broker: readings in, set-points out.

``python -m vppres.service.mqtt`` needs the extra ``vppres[mqtt]`` and a broker that speaks MQTT 5.

============================================  ==================================================
``vppres/telemetry/ASSET/QUANTITY``           read: a number, or nothing where it is missing;
                                              what is neither is logged, and named on the
                                              service's page; retained messages are left out,
                                              since nothing says from when they are
``vppres/setpoints/ASSET``                    written, retained: the set-point as JSON, which the
                                              broker forgets when it ends; ``KIND/ASSET`` of
                                              assets of several kinds that have one name
``vppres/asked/ASSET/QUANTITY``               written: why a reading is to be sent again at once
``vppres/status``                             written, retained: ``online``, and ``offline`` as
                                              the bridge's last will
============================================  ==================================================

Assets are written as in a URL, ``%2F`` for a slash, or as they are named: both are heard, and
set-points are written to both where they differ.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import os
import threading
from collections import Counter, deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from typing import Any
from urllib.parse import quote, unquote

import paho.mqtt.client as mqtt
import pandas as pd
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from vppres.core.errors import InputError
from vppres.service.clock import written
from vppres.service.http.client import Client
from vppres.service.payloads import MOST_SERIES

MOST_WAITING = 10_000
"""Readings that are kept while the service does not answer; then the oldest are dropped."""

WILDCARDS = "+#"
"""Not to be written in a topic."""

LONGEST_SHOWN = 40
"""Bytes of a payload that is no number."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Topics:
    """Names at the broker.

    Examples
    --------
    >>> Topics().set_points("b/2")
    ['vppres/setpoints/b%2F2', 'vppres/setpoints/b/2']
    >>> Topics().set_points("house", "pv")
    ['vppres/setpoints/pv/house']
    >>> Topics().reading("vppres/telemetry/b%2F2/soc")
    ('b/2', 'soc')
    >>> Topics().reading("vppres/telemetry/b/2/soc")
    ('b/2', 'soc')
    """

    prefix: str = "vppres"

    @property
    def status(self) -> str:
        """Whether the bridge is there."""
        return f"{self.prefix}/status"

    @property
    def readings(self) -> str:
        """All readings."""
        return f"{self.prefix}/telemetry/#"

    def set_points(self, asset: str, kind: str = "") -> list[str]:
        """Topics of a set-point: the asset's name as in a URL, and plain if a topic allows it.

        The ``kind`` stands before a name that others have too.
        """
        names = [quote(asset, safe="")]
        if not set(asset) & set(WILDCARDS):
            names.append(asset)
        place = f"{self.prefix}/setpoints/{kind}{'/' * bool(kind)}"
        return [f"{place}{name}" for name in dict.fromkeys(names)]

    @property
    def grid_again(self) -> str:
        """Topic that asks again for the state of the grid."""
        return f"{self.prefix}/asked/grid/grid_on"

    def reading(self, topic: str) -> tuple[str, str]:
        """Asset and quantity of a reading's topic."""
        asset, _, quantity = topic.removeprefix(f"{self.prefix}/telemetry/").rpartition("/")
        return unquote(asset), quantity


class Bridge:
    """Carries readings one way and set-points the other.

    The client has a token with ``read`` and ``telemetry``; ``resolution`` says how long a reading
    holds.
    """

    def __init__(self, service: Client, topics: Topics, resolution: str = "PT1M") -> None:
        self.service = service
        self.topics = topics
        self.resolution = resolution
        self._waiting: deque[dict[str, Any]] = deque(maxlen=MOST_WAITING)
        self._published: dict[str, tuple[str, bool]] = {}
        self.broker = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        self.broker.will_set(topics.status, "offline", qos=1, retain=True)
        self.broker.on_connect = self._connected
        self.broker.on_message = self._heard

    def _connected(self, broker: Any, *_: Any) -> None:
        """Again after every loss: nothing else says what is subscribed, and what is retained."""
        broker.subscribe(self.topics.readings, qos=1)
        broker.publish(self.topics.status, "online", qos=1, retain=True)
        self._published.clear()

    def _heard(self, _broker: Any, _data: Any, message: Any) -> None:
        """A reading; what is none is sent as it is: the service names it, and its page does."""
        # The broker keeps no time with a retained message: stamped now, it would replace readings
        # that are newer. A source's next message is not marked as retained.
        if message.retain:
            log.warning("%r is retained, from an unknown time: left out", message.topic)
            return
        asset, quantity = self.topics.reading(message.topic)
        value = _number(message.payload)
        if isinstance(value, str):
            log.warning("%r is no number: %r", message.topic, value)
        self._waiting.append(
            {
                "source": "mqtt",
                "asset": asset,
                "quantity": quantity,
                "start": written(pd.Timestamp.now(tz="UTC").floor("s")),
                "resolution": self.resolution,
                "values": [value],
            }
        )

    def turn(self) -> None:
        """Send what was read, and publish what is new of the set-points.

        Raises
        ------
        InputError, OSError
            If the service refuses or does not answer; readings are kept for the next turn.
        """
        while self._waiting:
            self._send(list(islice(self._waiting, MOST_SERIES)))
        found = self.service.wanted("GET", "/v1/setpoints").body
        # What is published before there is a broker would be published again.
        shared = Counter(point["asset"] for point in found["setpoints"])
        for point in found["setpoints"] if self.broker.is_connected() else ():
            kind = point["kind"] if shared[point["asset"]] > 1 else ""
            topics = self.topics.set_points(point["asset"], kind)
            self._publish(point, topics, pd.Timestamp(found["at"]))

    def _send(self, sending: list[dict[str, Any]]) -> None:
        """Send as many readings as the service takes at once."""
        answer = self.service.ask("POST", "/v1/telemetry", {"series": sending})
        if answer.status >= 500 or answer.status in (401, 403, 429):
            raise InputError(f"telemetry: the service answers {answer.status}")
        for asked in answer.body.get("asked_again", ()):
            self.broker.publish(self.topics.grid_again, asked, qos=1)
        for refused in answer.body.get("refused") or answer.body.get("problems") or []:
            what = (
                f"{refused['field']} = {refused['value']}" if refused["value"] else refused["field"]
            )
            log.warning("telemetry: %s: %s", what, refused["message"])
        for one in sending:
            # The oldest may have been dropped for newer ones meanwhile.
            if self._waiting and self._waiting[0] is one:
                self._waiting.popleft()

    def _publish(self, point: dict[str, Any], topics: Sequence[str], now: pd.Timestamp) -> None:
        """A set-point that is new; the broker forgets it when it ends, also without the service."""
        key = f"{point['kind']}/{point['asset']}"
        state = (point["id"], point["active"])
        if self._published.get(key) == state:
            return
        properties = Properties(PacketTypes.PUBLISH)
        if point["active"]:
            left = pd.Timestamp(point["valid_until"]) - now
            properties.MessageExpiryInterval = max(1, int(left.total_seconds()))
        for topic in topics:
            self.broker.publish(topic, json.dumps(point), qos=1, retain=True, properties=properties)
        self._published[key] = state

    def run(self, host: str, port: int, every_s: float, end: threading.Event) -> None:
        """Go on until the end; what fails is tried again, the broker too."""

        def waits(*_: Any) -> None:
            log.error("the broker at %s:%d does not answer: tried again", host, port)

        self.broker.on_connect_fail = waits
        self.broker.connect_async(host, port)
        self.broker.loop_start()
        try:
            while not end.wait(every_s):
                try:
                    self.turn()
                except (InputError, OSError) as error:
                    log.error("%s", error)
        finally:
            if self.broker.is_connected():
                last = self.broker.publish(self.topics.status, "offline", qos=1, retain=True)
                last.wait_for_publish(5)
            self.broker.disconnect()
            self.broker.loop_stop()


def _number(payload: bytes) -> float | str | None:
    """The number of a payload; its text if it is none, or no finite one; None if it is empty."""
    if not payload:
        return None
    with suppress(ValueError):
        value = float(payload)
        # Python reads 1_0 as ten; no device means that.
        if math.isfinite(value) and b"_" not in payload:
            return value
    return payload[:LONGEST_SHOWN].decode(errors="replace")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the bridge until it is interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m vppres.service.mqtt", description=__doc__.split("\n")[0]
    )
    parser.add_argument("--service", default="http://127.0.0.1:8420", help="where vppres serves")
    parser.add_argument("--broker", default="127.0.0.1", help="name or address of the broker")
    parser.add_argument("--port", type=int, default=1883, help="port of the broker")
    parser.add_argument("--prefix", default="vppres", help="what all topics begin with")
    parser.add_argument("--every", type=float, default=5.0, help="seconds between two turns")
    parser.add_argument("--resolution", default="PT1M", help="how long a reading holds")
    asked = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    service = Client(asked.service, os.environ.get("VPPRES_TOKEN"))
    bridge = Bridge(service, Topics(asked.prefix), asked.resolution)
    if "VPPRES_MQTT_USER" in os.environ:
        bridge.broker.username_pw_set(
            os.environ["VPPRES_MQTT_USER"], os.environ.get("VPPRES_MQTT_PASSWORD")
        )
    with suppress(KeyboardInterrupt):
        bridge.run(asked.broker, asked.port, asked.every, threading.Event())


if __name__ == "__main__":
    main()
