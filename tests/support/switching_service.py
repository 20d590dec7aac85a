"""A service of a feeder with two switches, and what an operator and devices send it.

Called as a process of its own it is killed between two operations:
``python -m tests.support.switching_service FOLDER seen|unseen``.
"""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.asgi import Answer, Caller
from tests.support.live_service import HERE, NOON, client, site
from tests.support.tiny_day import tiny_scenario
from vppres.scenario.scenario import Scenario
from vppres.scenario.switches import Switches
from vppres.service.clock import SetClock, written
from vppres.service.operation.site import Service


def switched(**columns: Any) -> Scenario:
    """The tiny feeder with a tie from 3 to 4, and a switch on the line from 2 to 3."""
    given = {"minutes_to_operate": [20.0, 10.0], "parallel_allowed": [True, False], **columns}
    switches = Switches(["t", "s"], [3, 2], [4, 3], ["tie", "sectionaliser"], [False, True],
                        r_ohm=[0.5, np.nan], x_ohm=[0.4, np.nan], **given)  # fmt: skip
    return replace(site(tiny_scenario()), switches=switches)


def read(http: Caller, clock: SetClock, **closed: int) -> None:
    """Telemetry of switches."""
    series = [
        {"source": "scada", "asset": name, "quantity": "closed", "start": written(clock.now()),
         "resolution": "PT1M", "values": [state]}
        for name, state in closed.items()
    ]  # fmt: skip
    answer = http.post("/v1/telemetry", {"series": series})
    assert answer.status == 200 and answer.json()["refused"] == [], answer.json()


def want(http: Caller, **closed: bool) -> Answer:
    return http.put("/v1/switching", {"closed": closed})


def confirm(http: Caller, switch: str) -> Answer:
    return http.post("/v1/switching/confirm", {"switch": switch})


def killed_between_two(folder: str, is_seen: bool) -> None:
    """Confirm the first operation, let it be seen or not, and end as by kill -9."""
    clock = SetClock(NOON)
    with client(Service(switched(), HERE, paced=True), folder, clock) as http:
        read(http, clock, t=0, s=1)
        want(http, t=True, s=False)
        assert confirm(http, "t").status == 200
        if is_seen:
            read(http, clock, t=1)
        os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    killed_between_two(sys.argv[1], sys.argv[2] == "seen")
