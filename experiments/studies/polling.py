"""Fifty clients that look and ten that post, beside steps that are decided one after another.

``python -m experiments.studies.polling`` starts the service as a process of its own, rehearsing the
packaged day at H = 5, and asks it for a while as control rooms and gateways do: over connections
that stay open, every client at its own pace. It prints percentiles of the answers' times, and what
the service used of the processor.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd

import vppres
from vppres.service.clock import written

DAY = "uk-heatwave-2022"
LOOKING = ("/v1/overview", "/v1/setpoints", "/v1/plan", "/v1/status")
PATIENCE_S = 120.0
TICKS = os.sysconf("SC_CLK_TCK")


class Client:
    """One connection that stays open.

    Parameters
    ----------
    port : int
        Where the service listens on this machine.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def ask(self, method: str, path: str, body: Any = None) -> int:
        """Send a request and read the answer; its status."""
        if self._streams is None:
            self._streams = await asyncio.open_connection("127.0.0.1", self.port)
        reader, writer = self._streams
        content = b"" if body is None else json.dumps(body).encode()
        head = (
            f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            f"Content-Length: {len(content)}\r\n\r\n"
        )
        writer.write(head.encode() + content)
        await writer.drain()
        lines = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower().split("\r\n")
        length = next(int(s[16:]) for s in lines if s.startswith("content-length: "))
        await reader.readexactly(length)
        if "connection: close" in lines:
            await self.close()
        return int(lines[0].split()[1])

    async def close(self) -> None:
        """Let go of the connection."""
        if self._streams is not None:
            self._streams[1].close()
            await self._streams[1].wait_closed()
            self._streams = None


Times = dict[str, list[float]]


async def regularly(
    every_s: float, until: float, say: Callable[[], Awaitable[tuple[str, int]]], found: Times
) -> None:
    """Ask at a pace of one's own, whatever the answers take."""
    await asyncio.sleep(random.uniform(0.0, every_s))
    while time.monotonic() < until:
        begun = time.monotonic()
        what, status = await say()
        found[what if status < 400 else f"{what} {status}"].append(time.monotonic() - begun)
        await asyncio.sleep(max(0.0, begun + every_s - time.monotonic()))


def batch(day: Any, now: pd.Timestamp, second: int, source: str) -> dict[str, Any]:
    """A reading of every battery, customer and PV system."""
    at = written(now + pd.Timedelta(seconds=second))
    ids = (
        ("soc", day.batteries.id, 0.5),
        ("load_kw", day.customers.id, 40.0),
        ("pv_kw", day.pv.id, 5.0),
    )
    return {
        "series": [
            {"source": source, "asset": str(name), "quantity": quantity, "start": at,
             "resolution": "PT1S", "values": [value]}
            for quantity, names, value in ids
            for name in names
        ]
    }  # fmt: skip


async def load(port: int, clients: int, posting: int, seconds: float) -> Times:
    """Answer times by what was asked."""
    day = vppres.load_scenario(DAY)
    times = list(day.grid.times)
    until = time.monotonic() + seconds
    found: Times = defaultdict(list)
    step = 0

    async def looking(client: Client, number: int) -> tuple[str, int]:
        path = LOOKING[number % len(LOOKING)]
        return path, await client.ask("GET", path)

    async def posted(client: Client, number: int) -> tuple[str, int]:
        body = batch(day, times[step], int(time.monotonic()) % 3600, f"gateway{number}")
        return "POST /v1/telemetry", await client.ask("POST", "/v1/telemetry", body)

    async def steps() -> None:
        nonlocal step
        client = Client(port)
        while time.monotonic() < until:
            begun = time.monotonic()
            await client.ask("POST", "/v1/steps", {"time": written(times[step])})
            found["POST /v1/steps"].append(time.monotonic() - begun)
            step = min(step + 1, len(times) - 1)
        await client.close()

    async def each(say: Any, number: int, every_s: float) -> None:
        client = Client(port)
        await regularly(every_s, until, lambda: say(client, number), found)
        await client.close()

    await asyncio.gather(
        steps(),
        *(each(looking, number, 2.0) for number in range(clients)),
        *(each(posted, number, 5.0) for number in range(posting)),
    )
    return found


def used_s(pid: int) -> float:
    """Time of the processor of a process, in s."""
    with open(f"/proc/{pid}/stat", encoding="utf-8") as file:
        fields = file.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def study(clients: int, posting: int, seconds: float) -> dict[str, Any]:
    """Percentiles in ms by what was asked, and the service's share of a processor."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "vppres", "serve", DAY, "--rehearse", "--horizon", "5"]
        process = subprocess.Popen(
            [*command, "--port", str(port), "--state", folder],
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        )
        try:
            _wait_for(port)
            before = used_s(process.pid)
            found = asyncio.run(load(port, clients, posting, seconds))
            used = used_s(process.pid) - before
        finally:
            process.terminate()
            process.communicate(timeout=60)
    answers = sum(map(len, found.values()))
    return {
        "answers_per_s": round(answers / seconds, 1),
        "service_processor_share": round(used / seconds, 3),
        "load_of_machine": round(os.getloadavg()[0], 1),
        "ms": {what: _percentiles(found[what]) for what in sorted(found)},
    }


def _percentiles(taken_s: Sequence[float]) -> dict[str, float]:
    at = {"p50": 50, "p95": 95, "p99": 99, "most": 100}
    ms = {name: round(1e3 * float(np.percentile(taken_s, q)), 1) for name, q in at.items()}
    return {"count": len(taken_s), **ms}


def _wait_for(port: int) -> None:
    """Until the service answers."""
    until = time.monotonic() + PATIENCE_S
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            return
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--posting", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0)
    asked = parser.parse_args(arguments)
    print(json.dumps(study(asked.clients, asked.posting, asked.seconds), indent=1))  # noqa: T201


if __name__ == "__main__":
    main()
