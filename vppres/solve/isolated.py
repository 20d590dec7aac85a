"""Windows solved in a process of their own, which is killed and replaced when it is late.

A solver is compiled code: it may crash, or wait for ever where no time limit of its own reaches.
In a process of its own that costs a window its answer, and the controller nothing. The process is a
fresh interpreter (``spawn``; HiGHS is never run in threads), is kept warm between windows and
shared by all solvers of a thread. POSIX systems only: ``docs/operation.md``.

Tasks and replies are pickled, which says where each ends: a stream of them needs nothing between.
"""

from __future__ import annotations

import atexit
import math
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Flags
from vppres.core.errors import InputError, SolverLostError
from vppres.core.parent import command
from vppres.model.beyond_paper.table import beyond_paper, own_additions
from vppres.model.data import WindowData
from vppres.model.numerics import POLYGON_SIDES
from vppres.model.site import Site
from vppres.solve.cache import SITES_KEPT
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

OUT_OF_MEMORY = 77
"""Status with which a solver's process ends when memory runs out: no other end has it."""


def _own_parts() -> tuple[str, ...]:
    """Names of your own parts that are added in this process."""
    return tuple(part.__qualname__ for part in own_additions())


@dataclass(frozen=True, eq=False)
class Setup:
    """Setup of a solver; those of equal content are equal."""

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
        """Content in words."""
        return (
            f"{self.factory!r} {self.site.key} {self.method} {self.solver} {self.limits} "
            f"{self.polygon_sides}"
        )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Setup) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

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

    setup: Setup  #: of the solver
    method: str  #: name of the method
    args: tuple[Any, ...]  #: what it is called with


@dataclass(frozen=True, eq=False)
class Reply:
    """Reply to a task: a value or an error."""

    value: Any = None
    error: Exception | None = None
    compilations: int = 0


SUPPORTED = os.name == "posix"
"""Whether this system has what isolation needs: inherited sockets and ``SIGKILL``."""

LATE_S = 1.0
LATE_S_PER_BUS = 1.5e-3
"""What an answer may take beyond the window's time limit.

A solver looks at its clock between iterations, and what it found is still put into the network and
sent: half a second on 33 buses, two on 1,000. The rest is for a machine that is busy.
"""

FIRST_S = 2.0
FIRST_S_PER_ENTRY = 2e-3
"""What a process may take longer over its first window of a kind, which it compiles.

An entry is a bus in a step. Compiling took 0.2 s for 33 buses and 6 steps, and 3 s for 1,021.
"""

START_S = 60.0
"""Time for a process to load the libraries: 3.5 s of CPU time that others may want too."""

MEMORY_SHARE = 0.5
"""Share of the memory there is that a solver may allocate: the controller has to live as well."""

LOOK_S = 0.2
"""Time between two looks at a process that loads: whether it was stopped."""

LOG_READ = 20_000
"""How much of what a process wrote goes into the note of its error, in bytes."""

_SOON_S = 1e-3
"""Least time for a message to be taken, in s: a socket takes zero for none."""

_REAP_S = 1.0
"""Time for a process that was killed to be gone, in s."""


class Worker:
    """A solver's process, started at once and loading while the caller goes on.

    Parameters
    ----------
    memory_bytes : int
        What it may allocate.

    Raises
    ------
    SolverLostError
        If the process cannot be started.
    """

    def __init__(self, memory_bytes: int) -> None:
        self.memory_bytes = memory_bytes
        self._warm: OrderedDict[Setup, set[object]] = OrderedDict()
        self._begin = time.monotonic()
        self._ready = False
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)
        self._end, theirs = socket.socketpair()
        self._replies = self._end.makefile("rb")
        try:
            with theirs:
                self.process = _spawned(theirs, memory_bytes, self._log)
        except (OSError, ValueError) as error:
            self._close()
            raise SolverLostError(
                f"The solver's process could not be started: {error}. Solve in the controller's "
                "own process, RunOptions(isolate=False) or --no-isolate."
            ) from error

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self.process.poll() is None

    def knows(self, task: Task, kind: object) -> bool:
        """Whether the process has done a task of that kind, and so compiled its problems."""
        return kind in self._warm.get(task.setup, ())

    def compiled(self, setup: Setup | None) -> bool:
        """Whether the process has compiled any problems of a setup."""
        return setup in self._warm

    def done(self, task: Task, kind: object) -> None:
        """Remember a task that was done."""
        kinds = self._warm.pop(task.setup, set())
        self._warm[task.setup] = kinds | {kind}
        while len(self._warm) > SITES_KEPT:
            self._warm.popitem(last=False)

    def ask(self, task: Task, within_s: float) -> Reply:
        """Do a task.

        The time until the reply counts from when the process is ready.

        Raises
        ------
        SolverLostError
            If there is no reply in time; the process is to be ended then.
        """
        if not self._ready:
            self._started()
            self._ready = True
        due = time.monotonic() + within_s
        try:
            self._end.settimeout(within_s)
            self._end.sendall(pickle.dumps(task, protocol=5))
        except TimeoutError:
            raise _late("answer", within_s) from None
        except OSError:
            raise self._dead() from None
        return self._hear(due, "answer", within_s)

    def _started(self) -> None:
        """Wait until the process has loaded; one that is stopped never will."""
        due = self._begin + START_S
        while not self._speaks() and time.monotonic() < due:
            if self._stopped:
                raise SolverLostError(
                    "The solver's process was stopped while it started, and was killed."
                )
        self._hear(due, "start", START_S)

    def _speaks(self) -> bool:
        """Whether the process has sent something, or ended, after a look."""
        self._end.settimeout(LOOK_S)
        try:
            self._end.recv(1, socket.MSG_PEEK)
        except TimeoutError:
            return False
        except OSError:
            pass
        return True

    @property
    def _stopped(self) -> bool:
        """Whether a signal keeps the process from running."""
        with suppress(ChildProcessError):
            pid, status = os.waitpid(self.process.pid, os.WNOHANG | os.WUNTRACED)
            if pid and not os.WIFSTOPPED(status):  # it has ended, which Popen is to know
                self.process.returncode = os.waitstatus_to_exitcode(status)
            return bool(pid) and os.WIFSTOPPED(status)
        return False

    def _hear(self, due: float, verb: str, within_s: float) -> Reply:
        """The next reply."""
        try:
            self._end.settimeout(max(due - time.monotonic(), _SOON_S))
            reply: Reply = pickle.load(self._replies)
        except TimeoutError:
            raise _late(verb, within_s) from None
        except (EOFError, OSError, pickle.UnpicklingError):  # or it ended within a reply
            raise self._dead() from None
        except Exception as error:
            raise SolverLostError(
                f"The solver's process sent what cannot be read: {type(error).__name__}: {error}."
            ) from error
        return reply

    def _dead(self) -> SolverLostError:
        """The error of a process that has ended by itself."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_REAP_S)  # its socket closes a moment before it is gone
        log = self._last_words()
        error = SolverLostError(f"The solver's process {self._end_in_words(log)}.")
        if log:
            error.add_note(f"Its last words:\n{log}")
        return error

    def _end_in_words(self, log: str) -> str:
        """How the process ended."""
        status = self.process.returncode
        # C++ and Rust say so and abort.
        refused = "bad_alloc" in log or "memory allocation of" in log
        if status == OUT_OF_MEMORY or (status == -signal.SIGABRT and refused):
            return f"ran out of memory, {self.memory_bytes / 1e9:.1f} GB"
        if status is None:
            return "closed its socket"
        if status == -signal.SIGKILL:
            return "was killed by signal 9 (SIGKILL), as the system does where memory runs out"
        if status < 0:
            return f"died of signal {-status} ({_signal_name(-status)})"
        return f"ended with status {status}"

    def _last_words(self) -> str:
        """End of what it wrote to standard output and error."""
        self._log.seek(0, os.SEEK_END)
        self._log.seek(max(self._log.tell() - LOG_READ, 0))
        lines = self._log.read().decode(errors="replace").splitlines()
        # A line of some hundred names, which says nothing about this end.
        return "\n".join(line for line in lines if not line.startswith("Extension modules:"))

    def end(self) -> None:
        """Kill the process and leave nothing of it."""
        self.process.kill()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(_REAP_S)
        self._close()

    def forget(self) -> None:
        """Leave a process that another process started, after a fork."""
        self._close()
        self.process.returncode = 0

    def _close(self) -> None:
        """Give the files back."""
        for file in (self._replies, self._end, self._log):
            file.close()


def _late(verb: str, within_s: float) -> SolverLostError:
    """The error of a process that has passed its deadline."""
    return SolverLostError(
        f"The solver's process did not {verb} within {within_s:.1f} s and was killed."
    )


def _spawned(theirs: socket.socket, memory_bytes: int, log: Any) -> subprocess.Popen[bytes]:
    """A fresh interpreter that finds the modules that this one finds.

    ``-P`` keeps the working folder, which may hold anything, out of its path.
    """
    if not sys.executable:
        raise ValueError("this Python does not know its own executable")
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    python, *rest = command("vppres.solve.worker", str(theirs.fileno()), str(memory_bytes))
    return subprocess.Popen(
        [python, "-P", "-X", "faulthandler", *rest],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        pass_fds=[theirs.fileno()],
        env={**os.environ, "PYTHONPATH": path},
    )


def _signal_name(number: int) -> str:
    """As ``kill -l`` calls it."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return "unknown"


class Workers:
    """Processes that wait for tasks; a thread that finds none idle starts another.

    Each may allocate ``memory_bytes``, half of what there is if not given.
    """

    def __init__(self, memory_bytes: int | None = None) -> None:
        self.memory_bytes = memory_bytes or memory_limit_bytes()
        self._idle: list[Worker] = []
        self._lock = threading.Lock()

    @property
    def pids(self) -> list[int]:
        """Process identifiers of those that are idle."""
        with self._lock:
            return [worker.process.pid for worker in self._idle]

    def start(self) -> None:
        """Start a process if none is idle, so that it loads while the caller goes on."""
        self._put(self._taken())

    def ask(self, task: Task, kind: object, within_s: Callable[[bool], float]) -> Reply:
        """Do a task in an idle process.

        Tasks of one ``kind`` and setup need the same problems. ``within_s`` is the time for the
        reply in s, given whether the process has done a task of that kind.

        Raises
        ------
        SolverLostError
            If the process died or was late. Another one is started at once: it loads while the
            caller falls back.
        """
        worker = self._taken(task.setup)
        try:
            reply = worker.ask(task, within_s(worker.knows(task, kind)))
        except SolverLostError:
            worker.end()
            with suppress(SolverLostError):  # the next task tries again and says why
                self._put(Worker(self.memory_bytes))
            raise
        except BaseException:
            worker.end()  # a later task must not get the answer to this one
            raise
        if reply.error is None:
            worker.done(task, kind)
        self._put(worker)
        return reply

    def close(self) -> None:
        """End the processes that are idle; the next task starts another."""
        with self._lock:
            idle = self._idle
            self._idle = []
        for worker in idle:
            worker.end()

    def forget(self) -> None:
        """Leave processes that another process started, after a fork."""
        for worker in self._idle:
            worker.forget()
        self._idle = []
        self._lock = threading.Lock()

    def _taken(self, setup: Setup | None = None) -> Worker:
        """An idle process, if possible one that has the setup's problems; or a new one."""
        with self._lock:
            dead = [worker for worker in self._idle if not worker.alive]
            self._idle = [worker for worker in self._idle if worker.alive]
            found = next((w for w in self._idle if w.compiled(setup)), None)
            if found is None and self._idle:
                found = self._idle[-1]
            if found is not None:
                self._idle.remove(found)
        for worker in dead:
            worker.end()
        return found or Worker(self.memory_bytes)

    def _put(self, worker: Worker) -> None:
        """Let others have a process."""
        with self._lock:
            self._idle.append(worker)


def memory_limit_bytes() -> int:
    """Half of this machine's memory, or of its control group's where that is less."""
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):  # "max" where the group has no limit
        there = min(there, int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return int(MEMORY_SHARE * there)


_workers: Workers | None = None
_workers_lock = threading.Lock()


def shared_workers() -> Workers:
    """The processes that all isolated solvers of this process share."""
    global _workers
    with _workers_lock:
        if _workers is None:
            _workers = Workers()
        return _workers


def close_workers() -> None:
    """End the processes that solve for this one; the next window starts another.

    They end by themselves with this process, and need some 200 MB each until then.
    """
    if _workers is not None:
        _workers.close()


def _forget_workers() -> None:
    """In a fork: its parent goes on talking to the processes."""
    global _workers, _workers_lock
    if _workers is not None:
        _workers.forget()
    _workers = None
    _workers_lock = threading.Lock()


atexit.register(close_workers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_workers)


class IsolatedSolver(WindowSolver):
    """A solver of windows whose answers come from another process, bit for bit the same.

    Parameters
    ----------
    site, method, solver, limits, polygon_sides
        As for :class:`vppres.solve.ladder.WindowSolver`.
    factory : callable, optional
        Makes the solver in the other process; a class or function of a module.
    workers : Workers, optional
        Where the processes come from; those that all of this process share if not given.

    Raises
    ------
    InputError
        If method or solver are unknown, or this system has no isolation.
    SolverLostError
        If no process can be started.
    """

    def __init__(
        self,
        site: Site,
        method: str = "decomposed",
        solver: str = "highs",
        limits: SolveLimits | None = None,
        polygon_sides: int = POLYGON_SIDES,
        factory: Callable[..., WindowSolver] = WindowSolver,
        workers: Workers | None = None,
    ) -> None:
        if not SUPPORTED:
            raise InputError.of(
                "options",
                "is not available on this system",
                "Leave it out, or use Linux or macOS.",
                field="isolate",
                value=True,
            )
        super().__init__(site, method, solver, limits, polygon_sides)
        self._setup = Setup(factory, site, method, solver, self.limits, polygon_sides)
        self._workers = workers
        self._compilations = 0
        (self._workers or shared_workers()).start()

    @property
    def compilations(self) -> int:
        """Problems that the process has compiled for the site."""
        return self._compilations

    def solve(self, data: WindowData, within_s: float = math.inf) -> WindowSolution:
        """Solve a window in the other process.

        Raises
        ------
        SolveError
            As in this process; and ``SolverLostError`` if the process died or was late.
        """
        solution: WindowSolution = self._ask("solve", data, within_s, within_s=within_s)
        return solution

    def solve_served(
        self,
        data: WindowData,
        served: Flags,
        before: Dispatch | None = None,
        keeps_turns: bool = False,
        within_s: float = math.inf,
    ) -> WindowSolution | None:
        """Cheapest dispatch of a supply schedule in the network, None if it has none."""
        args = (served, before, keeps_turns, within_s)
        solution: WindowSolution | None = self._ask("solve_served", data, *args, within_s=within_s)
        return solution

    def least_slack(self, data: WindowData) -> float:
        """Least slack of the squared voltage limits that leaves a feasible relaxation."""
        slack: float = self._ask("least_slack", data)
        return slack

    def deadline_s(
        self, data: WindowData, compiled: bool = True, within_s: float = math.inf
    ) -> float:
        """Time after which the process is killed, in s.

        ``compiled`` says whether the process has solved a window of that kind before; the solver
        may take ``within_s``, or its limit where that is less.
        """
        buses = self.site.network.n_buses
        seconds = self.limits.at_most(within_s).time_s + LATE_S + LATE_S_PER_BUS * buses
        if compiled:
            return seconds
        return seconds + FIRST_S + FIRST_S_PER_ENTRY * buses * data.n_steps

    def _ask(self, method: str, data: WindowData, *args: Any, within_s: float = math.inf) -> Any:
        """Call a method of the solver in the other process."""
        task = Task(self._setup, method, (data, *args))
        # What decides on the problems that it needs.
        kind = method, data.n_steps, beyond_paper(self.site, data), data.moves is not None
        # After a fork they are others.
        reply = (self._workers or shared_workers()).ask(
            task, kind, lambda compiled: self.deadline_s(data, compiled, within_s)
        )
        if reply.error is not None:
            raise reply.error
        self._compilations = reply.compilations
        return reply.value
