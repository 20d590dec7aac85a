"""A service in a process of its own, for as long as it is used."""

from __future__ import annotations

import multiprocessing
import os
import socket
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vppres.core.errors import InputError, VppresError
from vppres.service.access import LOOPBACK
from vppres.service.http.client import Client
from vppres.service.http.serve import Address, serve
from vppres.service.operation.site import Service

START_S = 60.0
"""What a start may take: libraries are loaded, and a process to solve in is begun."""

END_S = 20.0


@dataclass(frozen=True)
class Started:
    """A service that runs."""

    url: str
    pid: int
    folder: Path

    def size(self) -> dict[str, float]:
        """Memory in MB, open files, and size of the database in kB; what the system tells."""
        found = {
            "database_kb": sum(f.stat().st_size for f in self.folder.glob("service.db*")) / 1e3
        }
        status = Path(f"/proc/{self.pid}/status")
        if status.exists():
            lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
            found["memory_mb"] = int(lines["VmRSS"].split()[0]) / 1024.0
            found["open_files"] = float(len(os.listdir(f"/proc/{self.pid}/fd")))
        return {name: round(value, 1) for name, value in found.items()}


@contextmanager
def started(service: Service, folder: Path, port: int | None = None) -> Iterator[Started]:
    """A service on this machine, ended in the end, at a free port if none is given.

    Raises
    ------
    InputError
        If it does not answer.
    """
    address = Address(port=_free_port() if port is None else port)
    with address.listening():  # what cannot listen fails here, before another service answers
        pass
    process = multiprocessing.get_context("spawn").Process(
        target=_serve, args=(service, folder, address), name="vppres-service"
    )
    process.start()
    try:
        _wait_for(process, address)
        assert process.pid is not None
        yield Started(address.url, process.pid, folder)
    finally:
        process.terminate()
        process.join(END_S)
        if process.is_alive():
            process.kill()
            process.join()


def _serve(service: Service, folder: Path, address: Address) -> None:
    """In the other process; mistakes are shown there."""
    try:
        serve(service, folder, address, lambda _: None)
    except VppresError as error:
        raise SystemExit(str(error)) from None


def _wait_for(process: Any, address: Address) -> None:
    """Until it answers."""
    end = time.monotonic() + START_S
    while process.is_alive() and time.monotonic() < end:
        with closing(Client(address.url)) as client:
            try:
                if client.ask("GET", "/livez").status == 200:
                    return
            except OSError:
                time.sleep(0.1)
    raise InputError(f"No service could be started at {address.url}.")


def _free_port() -> int:
    with socket.socket() as sock:
        sock.bind((LOOPBACK[0], 0))
        port: int = sock.getsockname()[1]
        return port
