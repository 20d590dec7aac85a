"""Cheap requests that strangers may send to a service.

A service of the packaged day runs in a process of its own. Beside connections that ask for nothing,
8 MB of mistakes and 13,000 reads it is asked whether it lives, and decides a step.
"""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tests.support.live_service import NOON, reading
from vppres.service.clock import written
from vppres.service.http.client import Client
from vppres.service.http.connections import MOST_AT_ONCE
from vppres.service.http.started import Started

READERS = 26
READS = 500
READ = ("/v1/setpoints", "/v1/plan", "/readyz", "/v1/overview")


def telemetry(**fields: Any) -> dict[str, Any]:
    """A body of one series."""
    return {"series": [{**reading("big", "soc", NOON, 0.5), **fields}]}


def empty_texts() -> bytes:
    """8 MB of readings that are none: 2.6 million mistakes."""
    one = json.dumps(telemetry(values=[""] * 1280)["series"][0], separators=(",", ":"))
    return f'{{"series":[{",".join([one] * 2000)}]}}'.encode()


def unknown_fields() -> bytes:
    """8 MB of fields that there are not."""
    fields = ",".join(f'"{i:x}":0' for i in range(780_000))
    return f'{{"series":[{{{fields}}}]}}'.encode()


def address(own: Started) -> tuple[str, int]:
    """Host and port."""
    host, _, port = own.url.removeprefix("http://").rpartition(":")
    return host, int(port)


def lives(own: Started) -> float:
    """How long ``/livez`` takes over a connection of its own, in s."""
    begin = time.perf_counter()
    with closing(http.client.HTTPConnection(*address(own), timeout=60)) as asked:
        asked.request("GET", "/livez")
        assert asked.getresponse().status == 200
    return time.perf_counter() - begin


@contextmanager
def silent(own: Started, many: int) -> Iterator[None]:
    """Connections that send nothing, and others that send half a head."""
    opened = []
    for number in range(many):
        one = socket.create_connection(address(own))
        if number % 2:
            with suppress(OSError):
                one.send(b"GET /livez HT")
        opened.append(one)
    try:
        yield
    finally:
        for one in opened:
            one.close()


@contextmanager
def beside(work: Callable[[int], None], many: int) -> Iterator[list[threading.Thread]]:
    """Work in threads of its own."""
    threads = [threading.Thread(target=work, args=(number,)) for number in range(many)]
    for one in threads:
        one.start()
    try:
        yield threads
    finally:
        for one in threads:
            one.join()


def sends(own: Started, body: bytes) -> None:
    """Send a body of mistakes, which is refused."""
    with closing(http.client.HTTPConnection(*address(own), timeout=120)) as asked:
        asked.request("POST", "/v1/telemetry", body, {"content-type": "application/json"})
        assert asked.getresponse().status in (413, 422)


def reads(own: Started, number: int) -> None:
    """Look many times at one thing."""
    with closing(http.client.HTTPConnection(*address(own), timeout=120)) as asked:
        for _ in range(READS):
            asked.request("GET", READ[number % len(READ)])
            asked.getresponse().read()


def peak_mb(own: Started) -> float:
    """Most memory that the service has had."""
    lines = Path(f"/proc/{own.pid}/status").read_text().splitlines()
    (peak,) = (line for line in lines if line.startswith("VmHWM"))
    return int(peak.split()[1]) / 1024


def step_beside(
    own: Started, operator: Client, now: pd.Timestamp, work: Callable[[int], None], many: int
) -> dict[str, Any]:
    """A step that is decided while others are at work: its status and time, and ``/livez`` in s."""
    operator.wanted("PUT", "/v1/clock", {"now": written(now)})
    with beside(work, many) as threads:
        time.sleep(0.2)
        answer = operator.wanted("POST", "/v1/steps")
        took = [lives(own)]
        while any(one.is_alive() for one in threads):
            took.append(lives(own))
            time.sleep(0.05)
    return {
        "step": answer.body["status"],
        "step_s": answer.seconds,
        "livez_p95_s": float(np.percentile(took, 95)),
        "livez_most_s": max(took),
        "peak_mb": peak_mb(own),
    }


def attacks(own: Started, start: pd.Timestamp, length: pd.Timedelta) -> Iterator[dict[str, Any]]:
    """One row for each kind of stranger."""
    works: dict[str, tuple[Callable[[int], None], int]] = {
        "nobody": (lambda _: None, 1),
        "8 MB of empty texts": (lambda _: sends(own, empty_texts()), 1),
        "8 MB of unknown fields": (lambda _: sends(own, unknown_fields()), 1),
        f"{READERS * READS} reads": (lambda number: reads(own, number), READERS),
    }
    with closing(Client(own.url)) as operator:
        for step, (name, (work, many)) in enumerate(works.items(), start=1):
            now = start + step * length
            yield {"beside": name, **step_beside(own, operator, now, work, many)}
        with silent(own, MOST_AT_ONCE):
            now = start + (len(works) + 1) * length
            row = step_beside(own, operator, now, lambda _: time.sleep(1.0), 1)
            yield {"beside": f"{MOST_AT_ONCE} silent connections", **row}
