"""Work in a process of its own: an empty folder that is thrown away, a clock, no file to write."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from vppres.core.errors import InputError
from vppres.core.parent import me
from vppres.feeders.strangers.child import AT
from vppres.io.atomic import scratch_folder

TIME_LIMIT_S = 10.0
"""For a library to read a file; the published feeders take less than one."""

START_LIMIT_S = 60.0
"""For the process to load its libraries, which a busy machine does slowly."""

CURE = (
    "Leave out what stands there, or else what stands before it, until the file is read. Sizes "
    "that no equipment has end it too, such as a line of a million phases."
)
MOST_TOLD = 200

ALARM = int(getattr(signal, "SIGALRM", 0))
"""Signal by which the process's own clock ends it; Windows has only the clock of this side."""


def confined(
    engine: str, job: dict[str, Any], name: str, time_limit_s: float = TIME_LIMIT_S
) -> dict[str, Any]:
    """Answer of an engine.

    ``engine`` is one of :mod:`vppres.feeders.strangers.child`, ``job`` what JSON can hold; the time
    counts from the moment in which the engine is loaded.
    """
    child = Path(__file__).with_name("child.py")
    text = json.dumps({**job, "engine": engine, "limit_s": time_limit_s, "parent": me()})
    too_long = InputError.of(
        name,
        f"is not read within {time_limit_s:g} s",
        "Give the feeder alone, with sizes that equipment has.",
    )
    with scratch_folder() as folder:
        try:
            # -I: neither variables nor files of the user say what is loaded; -B: no cache written.
            done = subprocess.run(
                [sys.executable, "-I", "-B", str(child)],
                input=text,
                text=True,
                encoding="utf-8",
                cwd=folder,
                env=_environment(folder),
                capture_output=True,
                check=False,
                timeout=START_LIMIT_S + time_limit_s,
            )
        except subprocess.TimeoutExpired:
            raise too_long from None
    if ALARM and done.returncode == -ALARM:
        raise too_long
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        raise InputError.of(name, _ended(engine, done.returncode, done.stderr), CURE) from None
    assert isinstance(answer, dict)
    return answer


def _ended(engine: str, status: int, stderr: str) -> str:
    """How the process ended without an answer, at which place of the job, and its last words."""
    library = "OpenDSS itself" if engine.startswith("dss.") else "the library that reads it"
    how = f"{library} ends by signal {-status}" if status < 0 else f"its reading ends ({status})"
    lines = [line.strip() for line in stderr.splitlines()]
    places = [line.removeprefix(AT) for line in lines if line.startswith(AT)]
    words = [line for line in lines if line and not line.startswith(AT)]
    where = f" at '{places[-1]}'" if places else ""
    why = f": {words[-1][:MOST_TOLD]}" if words else ""
    return f"{how}{where}{why}"


def _environment(folder: Path) -> dict[str, str]:
    """Variables of the process: nothing of the user's, no program to find, one thread."""
    return {
        "HOME": str(folder),
        "TMPDIR": str(folder),
        "PATH": "",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "DSS_CAPI_ALLOW_DOSCMD": "0",
        "DSS_CAPI_ALLOW_CHANGE_DIR": "0",
        "DSS_CAPI_ALLOW_EDITOR": "0",
    }
