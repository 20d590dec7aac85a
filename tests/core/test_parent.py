"""Processes that are started for another end with it, whatever they do and however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from vppres.core import parent

ROOT = Path(__file__).parents[2]
SOON_S = 10.0
"""Far below the minute for which all that is started here would live, on a busy machine too."""

pytestmark = pytest.mark.skipif(os.name != "posix", reason="SIGKILL")


def gone(pid: int) -> bool:
    """Whether a process has ended soon; a zombie has, though nobody may have fetched it."""
    due = time.monotonic() + SOON_S
    while time.monotonic() < due:
        try:
            state = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2]
        except OSError:
            return True
        if state.split()[0] == "Z":
            return True
        time.sleep(0.02)
    return False


def killed_in(script: str, folder: Path, count: int = 1) -> list[int]:
    """Processes whose numbers a script wrote as names of files, after the script was killed."""
    running = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script), str(folder)],
        cwd=ROOT,
        start_new_session=True,
    )
    try:
        while len(found := [int(file.name) for file in folder.iterdir()]) < count:
            assert running.poll() is None, "the script ended"
            time.sleep(0.02)
    finally:
        os.kill(running.pid, signal.SIGKILL)
        running.wait()
    return found


HOLDING = """
    import ctypes, os, pathlib, sys

    def hold(folder):
        '''Keep the interpreter's lock, as a solver does.'''
        pathlib.Path(folder, str(os.getpid())).touch()
        ctypes.PyDLL(None).sleep(60)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's signal is Linux's")
@pytest.mark.parametrize("words", ["'holding', sys.argv[1]", "'--', '/bin/sleep', '60'"])
def test_a_child_that_never_looks_ends_with_its_parent(tmp_path: Path, words: str) -> None:
    (tmp_path / "holding.py").write_text(
        textwrap.dedent(HOLDING) + "\nif __name__ == '__main__':\n    hold(sys.argv[1])\n",
        encoding="utf-8",
    )
    folder = tmp_path / "pids"
    folder.mkdir()
    script = f"""
        import os, pathlib, subprocess, sys, time
        from vppres.core.parent import command

        path = os.pathsep.join([{str(tmp_path)!r}, {str(ROOT)!r}])
        child = subprocess.Popen(command({words}), env={{**os.environ, "PYTHONPATH": path}})
        name = pathlib.Path(f"/proc/{{child.pid}}/cmdline")
        while b"vppres.core.parent" in name.read_bytes() and {"sleep" in words}:
            time.sleep(0.01)
        pathlib.Path(sys.argv[1], str(child.pid)).touch()
        time.sleep(60)
    """
    (pid,) = killed_in(script, folder)
    assert gone(pid)


def test_a_child_of_a_thread_sees_the_end_by_itself(tmp_path: Path) -> None:
    """The thread ends before the process does, and the child must not end with the thread."""
    script = """
        import pathlib, subprocess, sys, threading, time
        from vppres.core.parent import command

        def start():
            words = command("--help")
            assert words[4] == "free"
            code = f"import time; from vppres.core.parent import end_with; " \\
                   f"end_with({words[3]}, False); time.sleep(60)"
            children.append(subprocess.Popen([sys.executable, "-c", code]))

        children = []
        thread = threading.Thread(target=start)
        thread.start()
        thread.join()
        time.sleep(1.0)
        assert children[0].poll() is None
        pathlib.Path(sys.argv[1], str(children[0].pid)).touch()
        time.sleep(60)
    """
    (pid,) = killed_in(script, tmp_path)
    assert gone(pid)


def test_workers_of_a_study_end_with_it_while_a_solver_holds_the_lock(tmp_path: Path) -> None:
    script = (
        textwrap.dedent(HOLDING)
        + """
from vppres.studies.side_by_side import Where, map_unordered

list(map_unordered(hold, [sys.argv[1]] * 2, Where(2)))
"""
    )
    pids = killed_in(script, tmp_path, count=2)
    assert [gone(pid) for pid in pids] == [True, True]


def test_the_end_is_seen_before_anything_is_loaded() -> None:
    """A process that was killed while its child loaded libraries left it behind for as long."""
    ended = os.getppid()  # as good as a parent that is gone: it is not the child's
    done = subprocess.run(
        [
            sys.executable,
            "-X",
            "importtime",
            "-m",
            "vppres.core.parent",
            str(ended),
            "bound",
            "vppres.solve.worker",
        ],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    loaded = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "vppres.core" in loaded
    assert loaded.isdisjoint({"numpy", "cvxpy", "matplotlib", "pandas", "joblib"})


def test_a_process_is_not_bound_to_itself() -> None:
    """One job alone is run by the process that asks."""
    parent.end_with(os.getpid(), bound=True)
    assert parent.me() == (os.getpid(), True)
