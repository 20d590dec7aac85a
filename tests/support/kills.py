"""Commands killed at random moments: the target is whole or the old one, and nothing stays behind.

Called as a process of its own, which has one thread, so that it may fork:
``python -m tests.support.kills FOLDER KILLS SEED``. It prints what must not happen as JSON. Processes are
found in ``/proc``, so that it needs Linux.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from uuid import uuid4

from vppres.cli.commands import app

MARK = "VPPRES_KILLED"  # in the environment of all that a killed command has started
PATIENCE_S = 20.0  # in which orphans must be gone; they look every half second
# What the command writes, by name, and what it writes into, in the study's folder.
COMMANDS = {
    "run": "run {day} --out {place}/target --horizon 0 --quiet",
    "sweep": "sweep {day} --param horizon --values 0,1 --jobs 2 --quiet --out {place}/target",
    "new": "new case33bw {place}/target --step-minutes 240 --outage 12:00..20:00",
    "report": "report {runs}/one --out {place}/target.html",
    "compare": "compare {runs}/one {runs}/two --out {place}/target.html",
}
WHOLE = {
    "run": "summary.json report.html steps.parquet scenario/scenario.toml",
    "sweep": "summary.json summary.csv sweep.html horizon=0/report.html horizon=1/report.html",
    "new": "scenario.toml notes.md scenario.schema.json system.csv",
}


def started(words: Sequence[str], mark: str) -> int:
    """The process number of a command, run in a copy of this process with all its modules."""
    child = os.fork()
    if child:
        return child
    os.environ[MARK] = mark
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nothing, stream)
    from vppres.cli.commands import main

    sys.argv = ["vppres", *words]
    try:
        main()
    except SystemExit as end:
        os._exit(end.code if isinstance(end.code, int) else 1)
    except BaseException:
        os._exit(1)
    os._exit(0)


def orphans(mark: str) -> list[int]:
    """Processes whose environment holds the mark."""
    found = []
    wanted = f"{MARK}={mark}".encode()
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and wanted in (entry / "environ").read_bytes():
                found.append(int(entry.name))
        except OSError:
            continue
    return found


def content(target: Path) -> str | None:
    """A digest of a file, or of all files of a folder; None where there is nothing."""
    if target.is_file():
        return sha256(target.read_bytes()).hexdigest()
    if not target.exists():
        return None
    files = sorted(file for file in target.rglob("*") if file.is_file())
    return sha256(b"".join(str(file).encode() + file.read_bytes() for file in files)).hexdigest()


class Study:
    """Kills of the five commands, each over nothing and over an older result."""

    def __init__(self, day: Path, home: Path, seed: int) -> None:
        self.home = home
        self.draw = random.Random(seed)
        self.faults: list[str] = []
        self.duration_s: dict[str, float] = {}
        self.names = {"day": str(day), "runs": str(home / "runs")}
        for name, horizon in (("one", "0"), ("two", "1")):
            out = str(home / "runs" / name)
            self._finish(("run", str(day), "--out", out, "--horizon", horizon, "--quiet"))
        for kind in COMMANDS:
            begin = time.monotonic()
            self._finish(self._words(kind, home / "first" / kind))
            self.duration_s[kind] = time.monotonic() - begin

    def kill(self, kind: str, number: signal.Signals, rerun: bool) -> None:
        """Kill one command at a random moment and look at what is left."""
        place = self.home / uuid4().hex
        target = self._target(kind, place)
        place.mkdir()
        if kind != "new" and self.draw.random() < 0.5:  # new replaces nothing
            first = self._target(kind, self.home / "first" / kind)
            (shutil.copytree if first.is_dir() else shutil.copy)(first, target)
        before = content(target)
        mark = uuid4().hex
        process = started(self._words(kind, place), mark)
        time.sleep(self.draw.uniform(0, self.duration_s[kind]))
        os.kill(process, number)
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        self._look(f"{kind} {number.name} {status}", kind, target, before, status)
        self._wait_for_orphans(kind, mark)
        hidden = [p.name for p in place.iterdir() if p.name.startswith(".")]
        if hidden and number == signal.SIGTERM and status == 128 + signal.SIGTERM:
            self.faults.append(f"{kind}: SIGTERM left {hidden}")
        if rerun and not (kind == "new" and target.exists()):
            self._rerun(kind, place)
        shutil.rmtree(place)

    def _look(self, case: str, kind: str, target: Path, before: str | None, status: int) -> None:
        after = content(target)
        if status not in (0, -signal.SIGKILL, -signal.SIGTERM, 128 + signal.SIGTERM):
            self.faults.append(f"{case}: ended by itself")
        if after != before and (after is None or not self._whole(kind, target)):
            self.faults.append(f"{case}: neither the old result nor a whole new one")

    def _wait_for_orphans(self, kind: str, mark: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while (left := orphans(mark)) and time.monotonic() < end:
            time.sleep(0.2)
        if left:
            self.faults.append(f"{kind}: {len(left)} processes stayed")

    def _rerun(self, kind: str, place: Path) -> None:
        self._finish(self._words(kind, place))
        hidden = [p.name for p in place.iterdir() if p.name.startswith(".")]
        if hidden or not self._whole(kind, self._target(kind, place)):
            self.faults.append(f"{kind}: the rerun left {hidden} or is not whole")

    def _finish(self, words: Sequence[str]) -> None:
        process = started(words, uuid4().hex)
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        if status != 0:
            self.faults.append(f"{' '.join(words)}: status {status}")

    def _words(self, kind: str, place: Path) -> list[str]:
        return [word.format(place=place, **self.names) for word in COMMANDS[kind].split()]

    def _target(self, kind: str, place: Path) -> Path:
        return place / ("target" if kind in WHOLE else "target.html")

    def _whole(self, kind: str, target: Path) -> bool:
        if kind not in WHOLE:
            return target.read_text(encoding="utf-8").rstrip().endswith("</html>")
        return all((target / name).is_file() for name in WHOLE[kind].split())


def study(day: Path, kills: int, seed: int) -> list[str]:
    """Kill commands one after the other; every fourth by SIGTERM, every third is run again.

    Returns what must not happen.
    """
    assert app.registered_commands  # loaded once, before the first copy of this process
    kinds = tuple(COMMANDS)
    with tempfile.TemporaryDirectory() as home:
        killing = Study(day.absolute(), Path(home), seed)
        for number in range(kills):
            how = signal.SIGTERM if number % 4 == 3 else signal.SIGKILL
            killing.kill(kinds[number % len(kinds)], how, rerun=number % 3 == 0)
        return killing.faults


if __name__ == "__main__":
    source, number, seed_of_moments = sys.argv[1:]
    sys.stdout.write(json.dumps(study(Path(source), int(number), int(seed_of_moments))))
