"""One evening against a service of its own: what a control room does and meets, minute by minute.

The evening reads a state of charge 13 minutes before a step and loses the grid 13 minutes after it;
a battery rejects its set-point, which is an alarm that the operator acknowledges before taking over
by hand; the service ends and starts again, and the grid comes back.
"""

from __future__ import annotations

import time as machine
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tests.support.live_service import readings, site
from tests.support.tiny_day import tiny_scenario
from vppres.day.options import RunOptions
from vppres.service.clock import written
from vppres.service.http.client import Client
from vppres.service.http.started import started
from vppres.service.operation.site import Service

STEP = pd.Timestamp("2026-11-21T18:00Z")
MOST_S = 20.0
"""From a change to the plan that knows it, in real time."""

Plan = dict[str, Any]


def minutes(after: int) -> pd.Timestamp:
    """Some minutes after the step's beginning."""
    return STEP + pd.Timedelta(minutes=after)


@dataclass
class ControlRoom:
    """What the operator and the devices ask of the service, whose clock is set."""

    client: Client

    def at(self, after: int) -> None:
        """Let it be some minutes after the step's beginning."""
        self.client.wanted("PUT", "/v1/clock", {"now": written(minutes(after))})

    def read(self, quantity: str, after: int, **values: float) -> None:
        """A reading of five minutes of each asset."""
        series = readings(minutes(after), quantity, values, lasts="PT5M")
        self.client.wanted("POST", "/v1/telemetry", {"series": series})

    def decided(self) -> Plan:
        """The step as it is decided at its beginning."""
        return sound(self.client.wanted("POST", "/v1/steps").body)

    def anew(self, change: Callable[[], object]) -> Plan:
        """The plan that knows of a change within the step."""
        before = self.client.wanted("GET", "/v1/plan").body["id"]
        begin = machine.monotonic()
        change()
        while True:
            plan = self.client.wanted("GET", "/v1/plan").body
            if plan["id"] != before and "unaware_of" not in plan:
                return sound(plan)
            assert machine.monotonic() < begin + MOST_S, "the plan was not made anew"
            machine.sleep(0.05)

    def rejected(self, count: int) -> list[Plan]:
        """Alarms of rejected set-points that stand, as many as there are soon after a plan."""
        begin = machine.monotonic()
        while True:
            every = self.client.wanted("GET", "/v1/alarms").body["alarms"]
            of_kind = [one for one in every if one["kind"] == "setpoint_rejected"]
            found = [one for one in of_kind if one["cleared_at"] is None]
            if len(found) == count:
                return found
            assert machine.monotonic() < begin + MOST_S, found
            machine.sleep(0.05)


def sound(plan: Plan) -> Plan:
    """A plan that was made, of which the gate held nothing back."""
    assert plan["status"] != "failed", plan["reason"]
    assert not [p for p in plan["setpoints"] if str(p["reason"]).startswith("default: more")]
    return plan


def off_in(plan: Plan) -> set[str]:
    """Customers that a plan leaves off."""
    return {one["asset"] for one in plan["setpoints"] if one.get("served") is False}


def until_manual(room: ControlRoom) -> None:
    """Up to the end of the service."""
    ask = room.client.wanted
    room.at(-13)
    room.read("soc", -13, big=0.62, small=0.62)
    room.at(0)
    assert room.decided()["status"] == "ok"
    room.at(13)
    dark = room.anew(lambda: room.read("grid_on", 13, grid=0.0))
    assert dark["status"] == "ok" and not dark["grid"]["available"]
    assert "hospital" not in off_in(dark)
    room.at(25)
    batteries = (one for one in dark["setpoints"] if one["kind"] == "batteries")
    busy = max(batteries, key=lambda one: abs(one["p_kw"]))
    status = f"/v1/setpoints/{busy['id']}/status"
    refused = room.anew(lambda: ask("POST", status, {"status": "rejected"}))
    assert refused["status"] == "ok"
    assert f"battery {busy['asset']} is out" in refused["estimated"]
    (alarm,) = room.rejected(1)
    assert alarm["subject"] == busy["asset"]
    ask("POST", f"/v1/alarms/{alarm['id']}/acknowledge")
    room.at(35)
    point = {"kind": "customers", "asset": "hospital", "served": False}
    mode = {"mode": "manual", "until": written(minutes(90)), "setpoints": [point]}
    manual = room.anew(lambda: ask("PUT", "/v1/mode", mode))
    assert manual["status"] == "manual" and "hospital" in off_in(manual)


def after_the_restart(room: ControlRoom) -> None:
    """From the start of the service on."""
    room.at(45)
    auto = room.anew(lambda: room.client.wanted("PUT", "/v1/mode", {"mode": "auto"}))
    assert auto["status"] == "ok" and not auto["grid"]["available"]
    assert [alarm["state"] for alarm in room.rejected(1)] == ["acknowledged"]
    room.at(60)
    room.read("soc", 56, big=0.4, small=0.4)
    assert room.decided()["status"] == "ok"
    assert room.rejected(0) == []  # the battery was heard
    room.at(80)
    light = room.anew(lambda: room.read("grid_on", 80, grid=1.0))
    assert light["status"] == "ok" and not off_in(light)


@pytest.mark.nightly
def test_an_evening_of_outage_refusal_and_restart(tmp_path: Path) -> None:
    day = site(tiny_scenario())
    dear = replace(day, price_gbp_per_kwh=np.full(24, 0.3))  # nothing is sold before the outage
    service = Service(dear, RunOptions(horizon_h=1.0, isolate=False), paced=True)
    for part in (until_manual, after_the_restart):
        with started(service, tmp_path) as own, closing(Client(own.url)) as client:
            part(ControlRoom(client))
