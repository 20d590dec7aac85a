"""The process that solves windows for another: ``python -m vppres.solve.worker``.

It is started by :mod:`vppres.solve.isolated` and is of no use by itself. Tasks and replies go
through the socket that it inherits. It ends with the process that started it
(:mod:`vppres.core.parent`), however that one ends.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import resource
import signal
import socket
import sys
import traceback
from functools import lru_cache
from pathlib import Path

from vppres.core.errors import SolveError
from vppres.solve.isolated import OUT_OF_MEMORY, Reply, Setup, Task
from vppres.solve.ladder import WindowSolver

SOLVERS_KEPT = 8
"""Solvers of the last setups: whole fleet, parts of it, wider voltages, the first tier."""

_FIRST_VICTIM = "500"
"""Added to what the kernel counts against a process when memory runs out (-1000 to 1000)."""


@lru_cache(SOLVERS_KEPT)
def solver_of(setup: Setup) -> WindowSolver:
    """The solver of a setup."""
    return setup.make()


def done(task: Task) -> Reply:
    """Do a task."""
    try:
        solver = solver_of(task.setup)
        value = getattr(solver, task.method)(*task.args)
        return Reply(value, compilations=solver.compilations)
    except MemoryError:
        raise
    except Exception as error:
        error.add_note(f"In the solver's process:\n{traceback.format_exc()}")
        return Reply(error=_portable(error))


def serve(fd: int, memory_bytes: int) -> None:
    """Do tasks until the other end of the socket is closed."""
    _prepare()
    end = socket.socket(fileno=fd)
    tasks = end.makefile("rb")
    try:
        _limit_memory(memory_bytes)
        end.sendall(pickle.dumps(Reply()))
        while True:
            end.sendall(pickle.dumps(done(pickle.load(tasks)), protocol=5))
    except MemoryError:
        os._exit(OUT_OF_MEMORY)
    except (EOFError, OSError):
        os._exit(0)  # the other end is closed


def _prepare() -> None:
    """Leave Ctrl-C to the parent, write no core, and be the first to go where memory runs out."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            Path("/proc/self/oom_score_adj").write_text(_FIRST_VICTIM, encoding="ascii")


def _limit_memory(memory_bytes: int) -> None:
    """Let allocations beyond a limit fail; what the libraries have taken already is not counted."""
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        limit = pages * os.sysconf("SC_PAGE_SIZE") + memory_bytes
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        if most != resource.RLIM_INFINITY:
            limit = min(limit, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))


def _portable(error: Exception) -> Exception:
    """The error, or its name and text where it cannot cross the socket."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return SolveError(f"{type(error).__name__}: {error}")
    return error


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]))
