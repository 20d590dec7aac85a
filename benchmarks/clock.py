"""Where the time of a solve goes, measured from outside, and a process's memory."""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ParamSpec, TypeVar
from unittest.mock import patch

import highspy
from cvxpy.reductions.solvers.solving_chain import SolvingChain

from vppres.solve.certificate import Certificate
from vppres.solve.programs import ProgramSolution
from vppres.solve.result import Outcome
from vppres.solve.solvers import solve_by_clarabel

P = ParamSpec("P")
R = TypeVar("R")


@dataclass
class Clock:
    """Seconds by stage, and those inside the solvers' own libraries."""

    stages_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    library_s: float = 0.0


@contextmanager
def watched() -> Iterator[Clock]:
    """Measure the stages and the solvers' libraries while the block runs.

    The package reports stages by name only, and its ``solver_s`` includes what cvxpy does around a
    solver; the places where both can be told apart are wrapped for the time of the block.
    """
    clock = Clock()
    note = Certificate.note

    def noted(known: Certificate, stage: str, outcome: Outcome) -> None:
        clock.stages_s[stage] += outcome.solve_s
        note(known, stage, outcome)

    def timed(ask: Callable[P, R]) -> Callable[P, R]:
        def asking(*args: P.args, **options: P.kwargs) -> R:
            begin = time.perf_counter()
            try:
                return ask(*args, **options)
            finally:
                clock.library_s += time.perf_counter() - begin

        return asking

    with (
        patch.object(Certificate, "note", noted),
        patch.object(ProgramSolution, "of", timed(ProgramSolution.of)),
        patch("vppres.solve.solvers.solve_by_clarabel", timed(solve_by_clarabel)),
        patch.object(SolvingChain, "solve_via_data", timed(SolvingChain.solve_via_data)),
    ):
        yield clock


BUSY = 30.0
"""Times that HiGHS gets on the clock on the wall: other work on the machine does not end it."""


@contextmanager
def on_cpu_time() -> Iterator[None]:
    """Let deadlines and HiGHS count this process's CPU time while the block runs.

    HiGHS knows the clock on the wall alone; it is asked to stop instead.
    """
    run, set_callback = highspy.Highs.run, highspy.Highs.setCallback
    asked: dict[int, Callable[..., None]] = {}

    def remembered(solver: highspy.Highs, ask: Callable[..., None], data: object) -> Any:
        asked[id(solver)] = ask
        return set_callback(solver, ask, data)

    def patient(solver: highspy.Highs) -> Any:
        own = asked.pop(id(solver), None)
        left_s = solver.getOptionValue("time_limit")[1] - solver.getRunTime()
        end_s = time.process_time() + left_s
        solver.setOptionValue("time_limit", solver.getRunTime() + BUSY * left_s)

        def ask(kind: object, text: str, now: object, answer: Any, data: object) -> None:
            if own is not None:
                own(kind, text, now, answer, data)
            answer.user_interrupt = answer.user_interrupt or time.process_time() > end_s

        kinds = highspy.cb.HighsCallbackType
        set_callback(solver, ask, None)
        solver.startCallback(kinds.kCallbackMipInterrupt)
        if own is None:
            solver.startCallback(kinds.kCallbackSimplexInterrupt)
        return run(solver)

    clock = SimpleNamespace(perf_counter=time.process_time)
    with (
        patch("vppres.solve.deadline.time", clock),
        patch.object(highspy.Highs, "run", patient),
        patch.object(highspy.Highs, "setCallback", remembered),
    ):
        yield


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, in MB.

    Where the kernel tells it of the program alone, that is taken: what a process reports of its own
    use begins with the memory of the one that started it.
    """
    status = Path("/proc/self/status")
    lines = status.read_text("utf-8").splitlines() if status.is_file() else []
    for line in lines:
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1e3
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def limit_memory(share: float = 0.6) -> None:
    """Let this process fail with ``MemoryError`` instead of filling the machine.

    A kernel that runs out of memory ends whichever process it likes, others' included.
    """
    page = os.sysconf("SC_PAGE_SIZE")
    pages = os.sysconf("SC_PHYS_PAGES")
    limit = int(share * page * pages)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def in_fresh_process(work: Callable[P, R], *args: P.args, **options: P.kwargs) -> R:
    """Run in a process of its own: nothing is compiled there, and its memory is the work's."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *args, **options).result()
