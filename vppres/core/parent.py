"""Processes that end with the one that started them, however that one ends.

``python -m vppres.core.parent PARENT BOUND MODULE ...`` runs a module, or after ``--`` a program,
as such a process. Nothing but the standard library is loaded before it is bound: loading the others
takes seconds of CPU time, and a parent may be killed in any of them.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys
import threading
import time

_PR_SET_PDEATHSIG = 1
_ASK_S = 0.5  # between two looks at the parent
_BOUND = "bound"
_PROGRAM = "--"


def command(*words: str) -> list[str]:
    """Command that starts a module, or a program after ``--``, as a child bound to this process.

    Examples
    --------
    >>> command("vppres.report.drawing")[1:3]
    ['-m', 'vppres.core.parent']
    """
    parent, bound = me()
    return [
        sys.executable,
        "-m",
        "vppres.core.parent",
        str(parent),
        _BOUND if bound else "free",
        *words,
    ]


def me() -> tuple[int, bool]:
    """Identity of this process and thread, which a process started here gives to :func:`end_with`.

    Returns
    -------
    int, bool
        Number of this process, and whether this is its main thread: the kernel ends a process
        with the thread that started it, which is what is meant only for that one.
    """
    return os.getpid(), threading.current_thread() is threading.main_thread()


def end_with(parent: int, bound: bool) -> None:
    """Let this process be killed when its parent ends, and at once if it has ended.

    Where the kernel does not do so, a thread looks twice a second; it has to wait while a solver
    holds the interpreter's lock.

    ``parent`` and ``bound`` come from :func:`me` in the parent; a process that gets its own number
    is left alone.
    """
    if parent == os.getpid():
        return
    if bound and sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    else:
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    if os.getppid() != parent:
        os._exit(0)


def _watch(parent: int) -> None:
    """Look at the parent until there is none."""
    while os.getppid() == parent:
        time.sleep(_ASK_S)
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))


def main() -> None:
    """Bind this process, then become what was asked for."""
    parent, bound, *words = sys.argv[1:]
    end_with(int(parent), bound == _BOUND)
    if words[0] == _PROGRAM:
        os.execv(words[1], words[1:])
    sys.argv = words
    runpy.run_module(words[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
