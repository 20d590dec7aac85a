"""Solvers in a process of their own: same answers, and whatever ends the process has a name."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support import failing_solvers as failing
from tests.support.failing_solvers import BAD_PRICE, bad
from tests.support.small_windows import window
from vppres.contract.decision import Decider, Decision
from vppres.contract.observation import Observation
from vppres.control.guard.guard import GuardedController, GuardOptions
from vppres.control.mpc import MPCController
from vppres.core.errors import InfeasibleError, InputError, SolveError, SolverLostError
from vppres.day.faults import FaultPlan, SolverOutage
from vppres.day.options import RunOptions
from vppres.day.simulate import Day, run_day
from vppres.io.find import load_scenario
from vppres.live.controller import Controller
from vppres.live.measurement import Measurement
from vppres.model.site import Site
from vppres.scenario.scenario import Scenario
from vppres.solve.isolated import START_S, IsolatedSolver, Worker, Workers, shared_workers
from vppres.solve.ladder import WindowSolver
from vppres.solve.result import SolveLimits, WindowSolution

ROOT = Path(__file__).parents[2]
SHORT = SolveLimits(time_s=1.0)
LONG = SolveLimits(time_s=20.0)
"""For windows that have to be answered, which are compiled within the limit, on a busy machine."""

SOON_S = 20.0
"""Within what a fallback has to follow the deadline."""


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    """Processes for this module, which may allocate 1 GB beyond their libraries."""
    pool = Workers(1_000_000_000)
    yield pool
    pool.close()


def idle(workers: Workers) -> Worker:
    """The process that did the last task."""
    return workers._idle[-1]


def gone(pid: int, within_s: float = 60.0) -> bool:
    """Whether nothing is left of a process, not even a zombie, within some time."""
    due = time.monotonic() + within_s
    while time.monotonic() < due:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


def same(one: WindowSolution, other: WindowSolution) -> bool:
    """Whether two solutions agree in every bit but those of their times."""
    told = [
        "terms",
        "objective",
        "bound",
        "status",
        "service_gap",
        "cost_gap_gbp",
        "stages",
        "passes",
    ]
    return all(getattr(one, name) == getattr(other, name) for name in told) and all(
        values.tobytes() == getattr(other.dispatch, name).tobytes()
        and values.dtype == getattr(other.dispatch, name).dtype
        for name, values in one.dispatch.arrays().items()
    )


# Answers.


def test_answers_are_the_same_to_the_last_bit(workers: Workers) -> None:
    day = load_scenario("uk-heatwave-2022")
    here = WindowSolver(Site.of(day))
    there = IsolatedSolver(Site.of(day), workers=workers)
    windows = [window(day, slice(t0, t0 + 6)) for t0 in range(0, 20, 5)]
    for data in windows:
        assert same(here.solve(data), there.solve(data))
    assert len(workers._idle) == 1
    compiled = there.compilations
    assert compiled > 0
    there.solve(windows[0])
    assert there.compilations == compiled
    served = here.solve(windows[2]).dispatch.served
    one, other = here.solve_served(windows[2], served), there.solve_served(windows[2], served)
    assert one is not None and other is not None
    assert same(one, other)
    assert here.least_slack(windows[0]) == there.least_slack(windows[0])


def test_errors_come_back_as_they_were(tiny: Scenario, workers: Workers) -> None:
    def raised(factory: Callable[..., WindowSolver]) -> Exception:
        solver = IsolatedSolver(Site.of(tiny), factory=factory, workers=workers)
        with pytest.raises(Exception) as caught:
            solver.solve(bad(window(tiny, slice(3))))
        return caught.value

    error = raised(failing.Infeasible)
    assert type(error) is InfeasibleError
    assert str(error) == "The window has no feasible dispatch."
    assert "failing_solvers.py" in error.__notes__[0]
    refused = raised(failing.Refusing)
    assert isinstance(refused, InputError)
    assert [str(problem) for problem in refused.problems] == [
        "pv.csv, row 3: must be positive. Give a rating.",
        "pv.csv, id: is not there. Give one.",
    ]
    local = raised(failing.Local)
    assert type(local) is SolveError
    assert str(local) == "HomeMadeError: nobody knows me"
    assert idle(workers).alive


def test_unknown_names_are_refused_before_a_process_is_asked(
    tiny: Scenario, workers: Workers
) -> None:
    with pytest.raises(InputError, match="is not a known method"):
        IsolatedSolver(Site.of(tiny), "magic", workers=workers)


def test_many_setups_share_a_process(tiny: Scenario, workers: Workers) -> None:
    data = window(tiny, slice(3))
    for sides in range(8, 20):  # more than a process keeps, twice
        solvers = [
            IsolatedSolver(Site.of(tiny), polygon_sides=n, workers=workers) for n in (sides, 8)
        ]
        assert same(solvers[0].solve(data), solvers[1].solve(data))
    assert len(workers._idle) == 1


# Ends.


LATE = r"SolverLostError: The solver's process did not answer within \d+\.\d s and was killed\."
MEMORY = r"SolverLostError: The solver's process ran out of memory, 1\.0 GB\."


@pytest.mark.daily
@pytest.mark.parametrize(("factory", "words"), [
    pytest.param(failing.Sleeping, LATE, marks=pytest.mark.nightly),
    pytest.param(failing.Blocking, LATE, marks=pytest.mark.nightly),
    (failing.Crashing, r"SolverLostError: The solver's process died of signal 11 \(SIGSEGV\)\."),
    pytest.param(failing.Hungry, MEMORY, marks=pytest.mark.nightly),
    pytest.param(failing.HungryInC, MEMORY, marks=pytest.mark.nightly),
    pytest.param(failing.Leaving, r"SolverLostError: The solver's process ended with status 3\.",
        marks=pytest.mark.nightly),
])  # fmt: skip
def test_every_end_has_a_named_fallback_soon(
    tiny: Scenario, workers: Workers, factory: Callable[..., WindowSolver], words: str
) -> None:
    prices = np.array(tiny.price_gbp_per_kwh)
    prices[3] = BAD_PRICE
    day = Day(replace(tiny, price_gbp_per_kwh=prices), RunOptions())
    made: list[IsolatedSolver] = []

    def solver_of(site: Site) -> WindowSolver:
        limits = SHORT if words == LATE else LONG
        made.append(IsolatedSolver(site, limits=limits, factory=factory, workers=workers))
        return made[-1]

    def controller_of(site: Site) -> Decider:
        return MPCController(solver_of(site), tiny.grid, 1.0)

    guard = GuardedController(
        controller_of, solver_of, Site.of(tiny), GuardOptions(("critical", "high", "low"))
    )
    for t in range(3):
        day.step(guard, t)
    lost = idle(workers)
    begin = time.monotonic()
    day.step(guard, 3)
    spent_s = time.monotonic() - begin
    assert spent_s < made[0].deadline_s(window(tiny, slice(2))) + SOON_S
    assert gone(lost.process.pid)
    step = day.recorder.records[3].steps
    assert step["fallback"] == "previous_plan"
    assert re.match(words, step["fallback_reason"]), step["fallback_reason"]
    day.step(guard, 4)  # by the process that took its place
    assert day.recorder.records[4].steps["fallback"] == "none"


@pytest.mark.nightly
def test_a_crash_is_told_with_its_last_words(tiny: Scenario, workers: Workers) -> None:
    solver = IsolatedSolver(Site.of(tiny), limits=LONG, factory=failing.Counting, workers=workers)
    data = window(tiny, slice(3))
    solver.solve(data)
    before = solver.compilations
    solver.solve(data)
    assert solver.compilations == before + 1
    with pytest.raises(SolverLostError) as caught:
        solver.solve(bad(data))
    words = caught.value.__notes__[0]
    assert "Segmentation fault" in words
    assert "failing_solvers.py" in words  # where it was in Python
    assert "Extension modules" not in words
    solver.solve(data)
    assert solver.compilations == 1


def test_a_deadline_grows_with_the_site_and_with_what_has_to_be_compiled(
    tiny: Scenario, workers: Workers
) -> None:
    solver = IsolatedSolver(Site.of(tiny), limits=SHORT, workers=workers)
    data = window(tiny, slice(3))
    assert solver.deadline_s(data) == pytest.approx(1.0 + 1.0 + 4 * 1.5e-3)
    assert solver.deadline_s(data, compiled=False) == pytest.approx(
        solver.deadline_s(data) + 2.0 + 4 * 3 * 2e-3
    )


@pytest.mark.nightly
def test_a_process_that_dies_between_windows_is_replaced_in_silence(
    tiny: Scenario, workers: Workers
) -> None:
    solver = IsolatedSolver(Site.of(tiny), workers=workers)
    before = solver.solve(window(tiny, slice(3)))
    killed = idle(workers).process
    os.kill(killed.pid, signal.SIGKILL)
    os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
    assert same(solver.solve(window(tiny, slice(3))), before)
    assert idle(workers).process.pid != killed.pid
    assert gone(killed.pid)


@pytest.mark.nightly
def test_a_process_that_is_killed_or_stopped_in_a_window_is_named(
    tiny: Scenario, workers: Workers
) -> None:
    solver = IsolatedSolver(Site.of(tiny), limits=SHORT, factory=failing.Sleeping, workers=workers)
    solver.solve(window(tiny, slice(3)))
    pid = idle(workers).process.pid
    timer = threading.Timer(0.3, os.kill, (pid, signal.SIGKILL))
    timer.start()
    with pytest.raises(
        SolverLostError,
        match=r"was killed by signal 9 \(SIGKILL\), as the system "
        "does where memory runs out",
    ):
        solver.solve(bad(window(tiny, slice(3))))
    timer.join()
    solver.solve(window(tiny, slice(3)))
    pid = idle(workers).process.pid
    os.kill(pid, signal.SIGSTOP)  # takes nothing from its socket, and does not end
    with pytest.raises(SolverLostError, match="did not answer within"):
        solver.solve(window(tiny, slice(3)))
    assert gone(pid)


def test_a_process_that_is_stopped_while_it_starts_is_replaced_soon(
    tiny: Scenario, workers: Workers
) -> None:
    solver = IsolatedSolver(Site.of(tiny), limits=SHORT, workers=workers)
    workers.close()
    workers.start()
    os.kill(idle(workers).process.pid, signal.SIGSTOP)
    begin = time.monotonic()
    with pytest.raises(SolverLostError, match="was stopped while it started"):
        solver.solve(window(tiny, slice(3)))
    assert time.monotonic() - begin < START_S / 2.0
    solver.solve(window(tiny, slice(3)))


@pytest.mark.daily
def test_nothing_is_left_when_the_processes_are_closed(tiny: Scenario) -> None:
    files = set(os.listdir("/dev/fd"))
    pool = Workers()
    solver = IsolatedSolver(Site.of(tiny), workers=pool)
    pid = idle(pool).process.pid
    pool.close()
    assert gone(pid)
    assert set(os.listdir("/dev/fd")) == files
    assert solver.solve(window(tiny, slice(3))).status == "optimal"  # by another one
    pool.close()


def test_a_python_without_executable_says_what_to_do(
    tiny: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "")
    with pytest.raises(SolverLostError) as caught:
        IsolatedSolver(Site.of(tiny), workers=Workers())
    assert str(caught.value) == (
        "The solver's process could not be started: this Python does not know its own executable. "
        "Solve in the controller's own process, RunOptions(isolate=False) or --no-isolate."
    )


# Where it is used.


@pytest.mark.nightly
def test_two_threads_have_a_process_each(tiny: Scenario) -> None:
    pool = Workers()
    here = WindowSolver(Site.of(tiny))
    found: dict[tuple[int, int], bool] = {}
    windows = [window(tiny, slice(t0, t0 + 3)) for t0 in range(4)]
    expected = [here.solve(data) for data in windows]
    both = threading.Barrier(2)

    def work(thread: int) -> None:
        solver = IsolatedSolver(Site.of(tiny), workers=pool)
        both.wait()
        for turn in range(5):
            for t0, data in enumerate(windows):
                found[thread, 4 * turn + t0] = same(solver.solve(data), expected[t0])

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 40
    assert all(found.values())
    assert 1 <= len(pool._idle) <= 2
    # The kernel ends what it binds to a thread with the thread; these live on.
    assert all(worker.alive for worker in pool._idle)
    pool.close()


SOC = {"big": 0.5, "small": 0.5}


@pytest.mark.nightly
def test_a_live_controller_answers_while_its_solver_hangs(tiny: Scenario) -> None:
    controller = Controller.of(tiny, RunOptions(horizon_h=1.0, limits=SHORT))
    assert controller.options.isolate
    first = controller.step(Measurement(controller.times[0], SOC))
    assert first.solve["fallback"] == "none"
    pid = idle(shared_workers()).process.pid
    os.kill(pid, signal.SIGSTOP)
    second = controller.step(Measurement(controller.times[1], SOC))
    assert second.solve["fallback"] == second.solve["status"] == "previous_plan"
    assert re.match(LATE, second.solve["fallback_reason"])
    assert gone(pid)
    pids = shared_workers().pids
    alone = Controller.of(tiny, RunOptions(horizon_h=1.0, isolate=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Workers, "ask", None)
        assert alone.step(Measurement(alone.times[0], SOC)).solve["fallback"] == "none"
    assert shared_workers().pids == pids


def test_a_run_is_isolated_on_request_faults_included(tiny: Scenario) -> None:
    faults = FaultPlan(solver={2: SolverOutage("killed")})
    runs = [
        run_day(tiny, RunOptions(horizon_h=1.0, isolate=isolate), faults=faults)
        for isolate in (None, True)
    ]
    words = ["none", "none", "previous_plan", "none", "none", "none"]
    for run in runs:
        assert run.steps["fallback"].tolist() == words
        assert run.steps["fallback_reason"][2].startswith("SolverKilledError")
    # Power flows start from the last one, so that days differ in their last bits.
    assert runs[0].steps["objective"].to_numpy() == pytest.approx(
        runs[1].steps["objective"].to_numpy(), rel=1e-9, nan_ok=True
    )
    assert runs[1].options["isolate"] is True


def test_windows_without_dispatch_are_widened_in_the_other_process(tiny: Scenario) -> None:
    error = InfeasibleError("nothing")

    class Refusing(MPCController):
        def decide(self, observation: Observation) -> Decision:
            if observation.t0 == 0:
                raise error
            return super().decide(observation)

    def solver_of(site: Site) -> WindowSolver:
        return IsolatedSolver(site)

    guard = GuardedController(
        lambda site: Refusing(solver_of(site), tiny.grid, 1.0),
        solver_of,
        Site.of(tiny),
        GuardOptions(("critical", "high", "low")),
    )
    day = Day(tiny, RunOptions())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WindowSolver, "solve", None)
        patch.setattr(WindowSolver, "least_slack", None)
        day.step(guard, 0)
    assert day.recorder.records[0].steps["fallback"] == "voltage"


SCRIPT_HEAD = """
    import multiprocessing, os, signal, sys, threading
    from tests.support.failing_solvers import Blocking, Sleeping, bad
    from tests.support.small_windows import window
    from tests.support.tiny_day import tiny_scenario
    from vppres.model.site import Site
    from vppres.solve.isolated import IsolatedSolver, close_workers, shared_workers
    from vppres.solve.ladder import WindowSolver

    def process():
        return shared_workers()._idle[-1].process

    # Whoever runs the tests in the background lets them ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    tiny = tiny_scenario()
    data = window(tiny, slice(3))
    expected = WindowSolver(Site.of(tiny)).solve(data).objective
"""


def script(body: str, folder: Path) -> subprocess.Popen[str]:
    """A program without a guard of its main module, in an interpreter and a session of its own."""
    code = textwrap.dedent(SCRIPT_HEAD) + textwrap.dedent(body)
    return subprocess.Popen(
        [sys.executable, "-P", "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=folder,
        start_new_session=True,
    )


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("factory", "start"),
    [
        # A solver that holds the interpreter's lock: only the kernel can tell that the parent ended.
        ("Blocking", "work()"),
        # A process that a thread started lives on when the thread ends, but not when its parent does.
        ("Sleeping", "thread = threading.Thread(target=work); thread.start(); thread.join()"),
    ],
)
def test_nothing_outlives_a_parent_that_is_killed(factory: str, start: str, tmp_path: Path) -> None:
    body = f"""
    solvers = []
    def work():
        solvers.append(IsolatedSolver(Site.of(tiny), factory={factory}))
        assert solvers[0].solve(data).objective == expected
    {start}
    print(process().pid, flush=True)
    solvers[0].solve(bad(data))
    """
    with script(body, tmp_path) as parent:
        pid = int(parent.stdout.readline())
        time.sleep(0.5)
        assert Path(f"/proc/{pid}").exists()
        parent.kill()
    assert gone(pid)


@pytest.mark.nightly
def test_ctrl_c_is_the_parents_and_forks_have_processes_of_their_own(tmp_path: Path) -> None:
    # What lies in the working folder is not a module.
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported from the folder')")
    body = """
    solver = IsolatedSolver(Site.of(tiny), factory=Sleeping)
    assert solver.solve(data).objective == expected
    first = process().pid
    threading.Timer(0.5, os.killpg, (0, signal.SIGINT)).start()
    try:
        solver.solve(bad(data))
    except KeyboardInterrupt:
        print("interrupted", shared_workers()._idle)
    assert solver.solve(data).objective == expected
    assert process().pid != first
    second = process().pid
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.killpg(0, signal.SIGINT)
    assert solver.solve(data).objective == expected
    print("goes on", process().pid == second)

    def forked(queue):
        assert shared_workers()._idle == []
        queue.put((solver.solve(data).objective == expected, process().pid))
        close_workers()

    fork = multiprocessing.get_context("fork")
    queue = fork.SimpleQueue()
    child = fork.Process(target=forked, args=(queue,), daemon=True)
    child.start()
    right, pid = queue.get()
    child.join()
    print("fork", right, pid != second, child.exitcode)
    assert solver.solve(data).objective == expected
    print("parent", process().pid == second)
    print(second)
    """
    with script(body, tmp_path) as parent:
        out, _ = parent.communicate(timeout=120)
    lines = out.splitlines()
    assert lines[:-1] == ["interrupted []", "goes on True", "fork True True 0", "parent True"]
    assert parent.returncode == 0
    assert gone(int(lines[-1]))
