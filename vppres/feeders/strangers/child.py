"""The process in which a library reads what a stranger wrote.

Run by its path, without what the packages around it load: it gets a job as JSON on its input, loads
the engine that the job names, gives up what it does not need, and answers in JSON. It ends with the
process that asks.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

ENGINES = ("dss.engine", "dss.day", "matpower.binary")
"""Modules of the room around this one."""

MEMORY_BYTES = 2 * 2**30
"""Of addresses: libraries and a feeder of some thousand buses take less than half of it."""

AT = "at: "
"""Opens a line of the errors' stream that says where the engine is."""


def tell(place: str) -> None:
    """Say where the engine is, for those who ask after its end."""
    sys.stderr.write(f"{AT}{place}\n")


def main() -> None:
    """Read a job from the input, answer it on the output."""
    # Libraries may write to the output too; the answer has it alone.
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    job = json.load(sys.stdin)
    _without_content("vppres", Path(__file__).parents[2])
    _without_content("vppres.feeders", Path(__file__).parents[1])
    from vppres.core.parent import end_with

    end_with(*job["parent"])
    # OpenDSSDirect would take it for tables that are not used: half of the time to load.
    sys.modules["pandas"] = None  # type: ignore[assignment]
    assert job["engine"] in ENGINES
    engine = import_module(f"vppres.feeders.{job['engine']}")
    _confine(float(job["limit_s"]))
    answer = engine.answer(job)
    with os.fdopen(out, "w", encoding="utf-8") as stream:
        json.dump(answer, stream)


def _without_content(name: str, place: Path) -> None:
    """Stand for a package by its folder alone: what it loads itself is not needed here."""
    package = ModuleType(name)
    package.__path__ = [str(place)]
    sys.modules[name] = package


def _confine(limit_s: float) -> None:
    """No file to write, no more than so much memory and time; where the system has such limits."""
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    signal.setitimer(signal.ITIMER_REAL, limit_s)  # its signal ends the process, in C code too


if __name__ == "__main__":
    main()
