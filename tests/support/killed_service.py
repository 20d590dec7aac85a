"""A service that is killed at random moments and started again, until it has decided all steps.

Called as a process of its own, which has solved nothing and has one thread, so that it may fork:
``python -m tests.support.killed_service FOLDER STEPS KILLS SEED``. It prints what it found as JSON.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from random import Random
from typing import Any

from tests.support.asgi import Caller
from tests.support.long_days import repeated
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.kinds.customer.data import SwitchingRules
from vppres.service.access import Access
from vppres.service.clock import written
from vppres.service.http.app import make_app
from vppres.service.http.serve import opened
from vppres.service.operation.runner import Runner
from vppres.service.operation.site import Service
from vppres.service.storage.records import seconds

RULES = SwitchingRules(min_unserved_h=2.0, cold_load_factor=1.3, cold_load_h=2.0)


def service_of(n_steps: int) -> Service:
    """Hours from six in the evening on, each six with an outage of two; batteries hold it."""
    day = repeated(tiny_scenario(), n_steps, "2025-07-01T18:00Z")
    options = RunOptions(horizon_h=1.0, mode="physical", switching=RULES, isolate=False)
    return Service(day, options, rehearsal=True)


def telemetry(runner: Runner, t: int) -> dict[str, Any]:
    """Readings of devices before a step: they did as the step before had planned."""
    now = runner.scenario.grid.times[t]
    last = runner.store.step(now - runner.length)
    soc = {"big": 0.4, "small": 0.5} if not last else last["expected"]["soc"]
    reading = {"source": "devices", "quantity": "soc", "start": written(now), "resolution": "PT1H"}
    return {"series": [{**reading, "asset": a, "values": [v]} for a, v in soc.items()]}


def play(folder: Path, n_steps: int, done: int) -> None:
    """Decide what is left of the steps; say in a file what was answered."""
    with opened(service_of(n_steps), folder) as runner:
        http = Caller(make_app(runner, Access()))
        times = list(runner.scenario.grid.times)
        last = runner.last
        first = 0 if not last else [written(time) for time in times].index(last["start"]) + 1
        for t in range(first, n_steps):
            heard = http.post("/v1/telemetry", telemetry(runner, t))
            if heard.status == 200:
                os.write(done, f"heard {seconds(times[t])}\n".encode())
            answer = http.post("/v1/steps", {"time": written(times[t])})
            if answer.status == 200:
                os.write(done, f"{json.dumps(told(answer.json()))}\n".encode())


def told(plan: dict[str, Any]) -> dict[str, Any]:
    """Part of a plan that does not depend on when it was made."""
    return {"start": plan["start"], "status": plan["status"], "setpoints": plan["setpoints"]}


def killed(folder: Path, n_steps: int, kills: int, seed: int) -> tuple[int, list[str]]:
    """Play, and kill the player as often as asked; how often it was, and what it had answered."""
    random = Random(seed)
    folder.mkdir()
    said = folder / "said"
    happened = 0
    while True:
        child = os.fork()
        if child == 0:
            play(folder, n_steps, os.open(said, os.O_WRONLY | os.O_CREAT | os.O_APPEND))
            os._exit(0)
        if happened < kills:
            time.sleep(random.uniform(0.02, 2.0))
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if not os.WIFSIGNALED(status):
            return happened, said.read_text(encoding="utf-8").splitlines()
        happened += 1


def findings(folder: Path, n_steps: int, kills: int, seed: int) -> dict[str, Any]:
    """Steps that differ from those of a service that was never killed, and answers that were lost."""
    folder.mkdir(exist_ok=True)
    happened, answers = killed(folder / "killed", n_steps, kills, seed)
    killed(folder / "alone", n_steps, 0, seed)
    service = service_of(n_steps)
    times = service.scenario.grid.times
    with opened(service, folder / "killed") as one, opened(service, folder / "alone") as other:
        pairs = [(one.store.step(time), other.store.step(time)) for time in times]
        kept = {r.time for r in one.store.between(times[0], times[-1] + one.length, ["soc"])}
    plans = {plan["start"]: told(plan) for plan, _ in pairs if plan}
    heard = [int(line.split()[1]) for line in answers if line.startswith("heard")]
    said = [json.loads(line) for line in answers if not line.startswith("heard")]
    return {
        "kills": happened,
        "answers": len(answers),
        "different": [
            str(time)
            for time, (plan, alone) in zip(times, pairs, strict=True)
            if not plan or not alone or told(plan) != told(alone)
        ],
        "lost_readings": [at for at in heard if at not in kept],
        "lost_plans": [plan["start"] for plan in said if plans[plan["start"]] != plan],
        "shed": sum(not s.get("served", True) for p in plans.values() for s in p["setpoints"]),
    }


if __name__ == "__main__":
    place, steps, times_killed, number = sys.argv[1:]
    found = findings(Path(place), int(steps), int(times_killed), int(number))
    sys.stdout.write(json.dumps(found) + "\n")
