"""Explanations: made once, beside the steps, in a process that may be killed.

Of a plan that leaves a customer off it is made as soon as the plan is there; of others on request.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from vppres.core.errors import StorageError, VppresError
from vppres.core.parent import command
from vppres.service.access import Denied
from vppres.service.operation.runner import Runner
from vppres.service.replay.explanations import blacked_out, question, unsolved
from vppres.service.storage.records import DECIDED

WITHIN_S = 120.0
"""What an explanation may take, the start of its process included, on however busy a machine."""

MOST_KEPT = 48
WAIT_S = 2.0

UNDECIDED = "The step has no decision."
LATE = "The explanation took too long."
FAILED = "The step could not be explained; see the log of the service."


class Explainer:
    """Explains stored steps, each once."""

    def __init__(self, runner: Runner) -> None:
        self.runner = runner
        self._turn = threading.Lock()
        self._made: OrderedDict[str, dict[str, Any]] = OrderedDict()
        self._begun = ""

    def begin(self) -> None:
        """Explain the last plan beside the steps, once, if it leaves a customer off."""
        plan = self.runner.last
        if not plan or plan["id"] == self._begun:
            return
        self._begun = plan["id"]
        if any(one.get("served") is False for one in plan["setpoints"]):
            threading.Thread(target=self._beside, args=(plan,), daemon=True).start()

    def _beside(self, plan: Mapping[str, Any]) -> None:
        """Work beside the service; its failure is the answer to the request."""
        with suppress(Denied, StorageError):
            self.of(plan)

    def of(self, plan: Mapping[str, Any]) -> dict[str, Any]:
        """Why the devices of a step do what they do.

        Raises
        ------
        Denied
            While another step is being explained: there is one process for it.
        """
        name = plan["id"]
        found = self._made.get(name)
        if found is not None:
            return found
        if not self._turn.acquire(blocking=False):
            raise Denied(429, "A step is being explained. Ask again.", WAIT_S)
        try:
            head = {"plan": name, "start": plan["start"], "status": plan["status"]}
            found = {**head, **self._explained(plan)}
            if found["price_reason"] != LATE:  # the machine may have more time when asked again
                self._made[name] = found
            while len(self._made) > MOST_KEPT:
                self._made.popitem(last=False)
        finally:
            self._turn.release()
        return found

    def _explained(self, plan: Mapping[str, Any]) -> dict[str, Any]:
        if plan["status"] not in DECIDED:
            return unsolved(plan, UNDECIDED)
        if plan["solve"].get("dark_reason"):
            return blacked_out(plan, self.runner.scenario)
        try:
            asked = pickle.dumps(question(self.runner, plan), protocol=5)
        except StorageError:
            raise
        except VppresError:
            return unsolved(plan, FAILED)
        try:
            done = _asked(asked)
        except subprocess.TimeoutExpired:
            return unsolved(plan, LATE)
        if done.returncode == -signal.SIGXCPU:
            return unsolved(plan, LATE)
        if done.returncode:
            return unsolved(plan, FAILED)
        found: dict[str, Any] = json.loads(done.stdout)
        return {**found, "reasons": [_of_others(one, plan) for one in found["reasons"]]}


def _of_others(reason: dict[str, Any], plan: Mapping[str, Any]) -> dict[str, Any]:
    """A reason, or that of a customer that is off against the plan: no price explains it.

    It cannot be connected, or the island does not hold it.
    """
    if reason["kind"] != "customers":
        return reason
    name = reason["asset"]
    lost = {one["asset"]: one["reason"] for one in plan.get("lost", ())}
    shed = {one["asset"]: one["reason"] for one in plan.get("shed", ())}
    if name in lost:
        words = f"Not supplied: it cannot be connected ({lost[name]})."
        return {**reason, "driver": "lost", "binding": "", "words": words}
    if name in shed:
        words = f"Shed: planned as supplied, then disconnected ({shed[name]})."
        return {**reason, "driver": "mismatch", "binding": "power", "words": words}
    return reason


def _asked(question: bytes) -> subprocess.CompletedProcess[bytes]:
    """A fresh interpreter that finds the modules that this one finds, and nothing in its folder."""
    python, *rest = command("vppres.service.replay.explanations")
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    return subprocess.run(
        [python, "-P", *rest],
        input=question,
        stdout=subprocess.PIPE,
        timeout=WITHIN_S,
        env={**os.environ, "PYTHONPATH": path},
        start_new_session=True,  # Ctrl-C is for the service
        check=False,
    )


def only(found: Mapping[str, Any], asset: str) -> dict[str, Any]:
    """Part of an explanation about one device."""
    prices = [one for one in found["price"] or [] if one["asset"] == asset]
    return {
        **found,
        "reasons": [one for one in found["reasons"] if one["asset"] == asset],
        "price": prices or found["price"],
    }
