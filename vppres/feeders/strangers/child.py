"""The process in which a library reads what a stranger wrote.

Run by its path, without the package around it: it gets a job as JSON on its input, loads the engine
that the job names, gives up what it does not need, and answers in JSON. It ends
with the process that asks.
"""

from __future__ import annotations

import importlib.util
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

ENGINES = {
    "dss/commands": (),
    "dss/nodes": (),
    "dss/elements": ("dss/nodes",),
    "dss/engine": ("dss/commands", "dss/elements"),
    "matpower/binary": (),
    "dss/day": ("dss/engine",),
    "dss/by_phase": ("dss/engine",),
}
"""Engines of the room around this one, and others that each needs."""

MEMORY_BYTES = 2 * 2**30
"""Of addresses: libraries and a feeder of some thousand buses take less than half of it."""


def main() -> None:
    """Read a job from the input, answer it on the output."""
    # Libraries may write to the output too; the answer has it alone.
    out = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    job = json.load(sys.stdin)
    _loaded(Path(__file__).parents[2] / "core" / "parent.py").end_with(*job["parent"])
    # OpenDSSDirect would take it for tables that are not used: half of the time to load.
    sys.modules["pandas"] = None  # type: ignore[assignment]
    engine = _engine(job["engine"])
    _confine(float(job["limit_s"]))
    answer = engine.answer(job)
    with os.fdopen(out, "w", encoding="utf-8") as stream:
        json.dump(answer, stream)


def _engine(name: str) -> Any:
    """An engine by its name; another that it needs is among the loaded ones."""
    for needed in ENGINES[name]:
        sys.modules[needed] = _engine(needed)
    return _loaded(Path(__file__).parents[1] / f"{name}.py")


def _loaded(file: Path) -> Any:
    """A module by its file."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
