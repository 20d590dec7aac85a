"""Messages of a controller and a solver's process, and their form on the socket."""

from __future__ import annotations

import pickle
import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vppres.core.errors import InputError
from vppres.model.beyond_paper.table import own_additions
from vppres.model.site import Site
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits

OUT_OF_MEMORY = 77
"""Status with which a solver's process ends when memory runs out: no other end has it."""

_LENGTH = struct.Struct("!Q")
_CHUNK = 1 << 20
"""Most that is read of a socket at once, in bytes."""


def _own_parts() -> tuple[str, ...]:
    """Names of your own parts that are added in this process."""
    return tuple(part.__qualname__ for part in own_additions())


@dataclass(frozen=True, eq=False)
class Setup:
    """Setup of a solver."""

    #: Makes the solver of the fields that follow; a class or function of a module, so that its name
    #: is all that crosses the socket.
    factory: Callable[[Site, str, str, SolveLimits, int], WindowSolver]
    site: Site  #: fixed data
    #: Names of the method and in the table of solvers.
    method: str
    solver: str
    limits: SolveLimits  #: gaps and time limit of a window
    polygon_sides: int  #: sides of an inverter's polygon
    own: tuple[str, ...] = field(default_factory=_own_parts)  #: your own parts that the problem has

    @cached_property
    def key(self) -> str:
        """Setups of equal content have equal solvers."""
        return (
            f"{self.factory!r} {self.site.key} {self.method} {self.solver} {self.limits} "
            f"{self.polygon_sides}"
        )

    def make(self) -> WindowSolver:
        """The solver.

        Raises
        ------
        InputError
            If the problem has parts of your own that this process does not know.
        """
        if self.own != _own_parts():
            raise InputError.of(
                "options",
                f"does not know the problem's own parts ({', '.join(self.own)})",
                "Solve in this process, or write them into the package's page.",
                field="isolate",
                value="true",
            )
        return self.factory(self.site, self.method, self.solver, self.limits, self.polygon_sides)


@dataclass(frozen=True, eq=False)
class Task:
    """A method of a solver to be called."""

    key: str  #: of the solver's setup
    method: str  #: name of the method
    args: tuple[Any, ...]  #: what it is called with
    #: Of a solver that the process may not have yet; sites are sent once.
    setup: Setup | None = None


@dataclass(frozen=True, eq=False)
class Reply:
    """Reply to a task: a value or an error; neither where the process lacks the setup."""

    value: Any = None
    error: Exception | None = None
    compilations: int = 0
    unknown: bool = False


class Channel:
    """One end of a socket that carries Python objects, each within a deadline."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def send(self, message: object, within_s: float | None = None) -> None:
        """Send an object.

        Raises
        ------
        TimeoutError
            If the other end has not taken it in time.
        OSError
            If there is no other end.
        """
        body = pickle.dumps(message, protocol=5)
        self._end.settimeout(within_s)
        self._end.sendall(_LENGTH.pack(len(body)) + body)

    def waits(self, within_s: float) -> bool:
        """Whether something is to be received, or the other end is closed, within a time."""
        poll = select.poll()
        poll.register(self._end, select.POLLIN)
        return bool(poll.poll(1e3 * within_s))

    def receive(self, within_s: float | None = None) -> bytes:
        """An object as it was pickled.

        Raises
        ------
        TimeoutError
            If it has not come in time.
        EOFError
            If there is no other end.
        OSError
            If the other end broke off.
        """
        due = None if within_s is None else time.monotonic() + within_s
        (length,) = _LENGTH.unpack(self._exactly(_LENGTH.size, due))
        return bytes(self._exactly(length, due))

    def _exactly(self, count: int, due: float | None) -> bytearray:
        """Receive a number of bytes."""
        found = bytearray()
        while len(found) < count:
            if due is not None:
                # Zero would mean "do not wait" and raise another error.
                self._end.settimeout(max(due - time.monotonic(), 1e-3))
            part = self._end.recv(min(count - len(found), _CHUNK))
            if not part:
                raise EOFError
            found += part
        return found

    def close(self) -> None:
        """Give the socket back."""
        self._end.close()
